"""A simulator whose variables are written in whole numbers is fitted like any other."""

from __future__ import annotations

import numpy as np

from twinbench import Simulator, Variable
from twinbench.data.recording import Recording
from twinbench.mismatch import diagnose

TANK = Simulator(
    name="tank",
    states=(Variable("level", "m", 0, 20, 5, 2),),
    inputs=(),
    outputs=(Variable("read", "m", 0, 20, 5, 2),),
    parameters=(Variable("k", "1/s", 0, 2, 1, 1),),
    rhs=lambda x, u, theta: np.array([-theta[0] * x[0]]),
    output=lambda x, u, theta: np.array([x[0]]),
    initial=lambda u0, y0, theta: np.array([y0[0]]),
)


def test_whole_numbers_are_numbers():
    time_s = np.arange(60) * 0.1
    noise = np.random.default_rng(0).normal(0.0, 0.01, (60, 1))
    read = 9.0 * np.exp(-0.5 * time_s)[:, None] + noise
    one, other = (Recording(name, time_s, ("read",), read) for name in ("one", "other"))
    verdict = diagnose(TANK, [one], [other], catalogue=())
    assert abs(verdict.values["k"] - 0.5) < 0.01
