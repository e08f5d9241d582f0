"""Names that do the same to all readings are one thing, whichever shapes they were tried with."""

from __future__ import annotations

import math

import numpy as np

from twinbench.data.recording import Recording
from twinbench.mismatch.asked import Asked
from twinbench.mismatch.model import whole_catalogue
from twinbench.mismatch.naming.weighed import weighed
from twinbench.physics.simulator import Simulator, Variable

PERIOD_S, STEP_S, SUBSTEPS = 37.0, 1.0, 10


def rhs(x, u, theta):
    return np.array([(u[0] - x[0]) / theta[0], (x[0] - x[1]) / theta[1]])


def output(x, u, theta):
    return np.array([x[1]])


def initial(u0, y0, theta):
    return np.array([u0[0], y0[0]])


def _lag(name: str, nominal_s: float) -> Variable:
    return Variable(name, "s", 1.0, 100.0, nominal_s, 0.1 * nominal_s)


IN_A_ROW = Simulator(
    "two_lags",
    states=(Variable("first", "V", -20.0, 20.0, 0.0, 3.0), Variable("second", "V", -20.0, 20.0, 0.0, 3.0)),
    inputs=(Variable("drive", "V", -20.0, 20.0, 0.0, 3.0),),
    outputs=(Variable("reading", "V", -20.0, 20.0, 0.0, 3.0),),
    parameters=(_lag("first_s", 8.0), _lag("second_s", 12.0)),
    rhs=rhs,
    output=output,
    initial=initial,
)  # fmt: skip


def recorded(seed: int) -> Recording:
    """Steps of the drive, a sine that acts on the second lag, noise."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, 600.0, STEP_S)
    drive = np.repeat(rng.uniform(-5.0, 5.0, len(time_s) // 30 + 1), 30)[: len(time_s)]
    x, readings, h = np.array([drive[0], 0.0]), [], STEP_S / SUBSTEPS
    for t, u in zip(time_s, drive, strict=True):
        readings.append(x[1])
        for i in range(SUBSTEPS):
            sine = 0.1 * math.sin(2.0 * math.pi * (t + i * h) / PERIOD_S)
            x = x + h * (rhs(x, [u], (8.0, 12.0)) + np.array([0.0, sine]))
    return Recording(
        f"run {seed}",
        time_s,
        ("drive", "reading"),
        np.stack([drive, np.array(readings) + 0.02 * rng.normal(size=len(time_s))], axis=1),
    )


def test_a_sine_before_a_lag_and_one_behind_it_are_one_thing_although_their_phases_differ() -> None:
    runs = [recorded(seed) for seed in (1, 2)]
    found = weighed(Asked(IN_A_ROW, runs, [], whole_catalogue(IN_A_ROW, (), STEP_S))).answer.found
    assert [f.name.split("@")[0] for f in found] == ["periodic"]
    assert found[0].alike == {"periodic@first", "periodic@second"}
    assert sum(found[0].weights[name] for name in found[0].alike) > 0.99
