"""An oven that loses heat through its wall, which its simulator lacks; what the engine says of it, and the page."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np

from helpers.documents import BY_NO_COMMAND
from helpers.plain import diagnosed
from twinbench.data.recording import Recording
from twinbench.mismatch import Verdict
from twinbench.mismatch.faults import faults
from twinbench.mismatch.report import write as mismatch_report
from twinbench.physics.compose import with_mechanism
from twinbench.physics.integrate import simulate
from twinbench.physics.simulator import Simulator, Term, Variable


def rhs(x: np.ndarray, u: np.ndarray, theta: np.ndarray) -> np.ndarray:
    return np.array([(u[0] - x[0]) / theta[0]])


def output(x: np.ndarray, u: np.ndarray, theta: np.ndarray) -> np.ndarray:
    return np.array([x[0]])


def initial(u0: np.ndarray, y0: np.ndarray, theta: np.ndarray) -> np.ndarray:
    return np.array([y0[0]])


def loss(x: np.ndarray, u: np.ndarray, theta: np.ndarray) -> float:
    return theta[-1] * (20.0 - x[0])  # type: ignore[no-any-return]


OVEN = Simulator(
    name="oven",
    says="an oven that follows its heater",
    states=(Variable("T_C", "degC", 0.0, 400.0, 150.0, 20.0, "temperature"),),
    inputs=(Variable("heater_C", "degC", 0.0, 400.0, 150.0, 40.0, "temperature of the heater"),),
    outputs=(Variable("probe_C", "degC", 0.0, 400.0, 150.0, 20.0, "temperature by the probe"),),
    parameters=(Variable("tau_s", "s", 5.0, 100.0, 20.0, 2.0, "time constant"),),
    rhs=rhs,
    output=output,
    initial=initial,
)
LOSS = Term(
    "wall_loss<1>",
    "heat goes through the wall & out",
    "balance:T_C",
    (Variable("wall_1_s", "1/s", 0.0, 0.1, 0.01, 0.01, "loss"),),
    term=loss,
    formula="{wall_1_s} (20 degC - T_C)",
)
CATALOGUE = (LOSS, *(m for m in faults(OVEN, 0.5) if m.name.startswith(("sensor_bias", "sensor_drift", "input_gain"))))


def record(simulator: Simulator, name: str, seed: int, samples: int = 360) -> Recording:
    rng = np.random.default_rng(seed)
    heater = np.repeat(rng.uniform(60.0, 300.0, samples // 30), 30)
    _, y = simulate(simulator, heater[None, :, None], np.array([150.0]), dt_s=0.5, substeps=4)
    values = np.stack([heater, y[0, :, 0] + rng.normal(0.0, 0.3, samples)], axis=-1)
    return Recording(name, 0.5 * np.arange(samples), ("heater_C", "probe_C"), values)


def oven_diagnosed(simulator: Simulator) -> Verdict:
    learnt = [record(simulator, "monday", 1), record(simulator, "tuesday", 2)]
    return diagnosed(OVEN, learnt, [record(simulator, "sunday", 3)], CATALOGUE)


@cache
def loss_found() -> Verdict:
    """Of the oven that loses heat; once for a process. Nobody may change it."""
    return oven_diagnosed(with_mechanism(OVEN, dataclasses.replace(LOSS, name="loss")))


def write(verdict: Verdict, out: Path) -> None:
    mismatch_report.write_findings({**verdict.to_dict(), **BY_NO_COMMAND}, "", out)
    mismatch_report.write_page(verdict, out)


def page(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")
