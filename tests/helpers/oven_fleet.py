"""Ovens whose simulator leaves out a draught, and a loss that some have: a fleet that is asked in a moment."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

OVEN = """
import numpy as np
from twinbench import Simulator, Variable

def rhs(x, u, theta):
    return np.array([(u[0] - x[0]) / theta[0]])

def output(x, u, theta):
    return np.array([x[0], u[0] - x[0]])

def initial(u0, y0, theta):
    return np.array([y0[0]])

OVEN = Simulator(
    name="oven", says="an oven",
    states=(Variable("T_C", "degC", 0.0, 400.0, 150.0, 20.0),),
    inputs=(Variable("heater_C", "degC", 0.0, 400.0, 150.0, 40.0),),
    outputs=(
        Variable("probe_C", "degC", 0.0, 400.0, 150.0, 20.0),
        Variable("gap_K", "K", -400.0, 400.0, 0.0, 20.0),
    ),
    parameters=(Variable("tau_s", "s", 5.0, 100.0, 20.0, 2.0),),
    rhs=rhs, output=output, initial=initial,
)
"""
DRAUGHT, LOSS, PERIOD_S = 1.0, 0.01, 0.5
TRIED = ("sensor*", "input*", "periodic*", "radiation*", "backlash*", "dead*", "time_constant*", "second*")
"""What is left out, so that it takes a moment."""


def table(seed: int, draught: float, loss: float, gap: bool = False, samples: int = 240) -> pd.DataFrame:
    """A recording of an oven by fine Euler steps."""
    rng = np.random.default_rng(seed)
    heater = np.repeat(rng.uniform(60.0, 300.0, samples // 15), 15)
    x, read, parts = 150.0, np.empty(samples), 10
    for k in range(samples):
        read[k] = x
        for _ in range(parts):
            x += PERIOD_S / parts * ((heater[k] - x) / 20.0 - draught + loss * (20.0 - x))
    probe = read + rng.normal(0.0, 0.3, samples)
    columns = {"time_s": PERIOD_S * np.arange(samples), "heater_C": heater, "probe_C": probe}
    return pd.DataFrame(columns | ({"gap_K": heater - probe} if gap else {}))


LEFT_OUT = [part for name in TRIED for part in ("--leave-out", name)]


def write_ovens(folder: Path, losses: tuple[float, ...]) -> list[str]:
    """``oven.py``, and a folder of three days for each oven; returns what a command is given, the simulator first."""
    (folder / "oven.py").write_text(OVEN)
    for k, loss in enumerate(losses):
        (folder / f"oven{k}").mkdir()
        for day in range(3):
            recording = table(10 * k + day, DRAUGHT * (1.0 + 0.03 * k), loss)
            recording.to_csv(folder / f"oven{k}" / f"day{day}.csv", index=False, float_format="%.6g")
    return ["oven.py", *(f"oven{k}" for k in range(len(losses)))]
