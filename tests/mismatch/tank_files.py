"""A tank in one file, as a user writes it, with a recording of it and a mechanism of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

TANK = """
import numpy as np
from twinbench.physics.simulator import Simulator, Variable


def rhs(x, u, theta):
    return np.array([theta[1] * u[0] - theta[0] * np.sqrt(max(x[0], 0.0))])


def output(x, u, theta):
    return np.array([x[0]])


def initial(u0, y0, theta):
    return np.array([y0[0]])


TANK = Simulator(
    "tank",
    states=(Variable("level_m", "m", 0.0, 2.0, 0.5),),
    inputs=(Variable("pump_V", "V", 0.0, 10.0, 3.0),),
    outputs=(Variable("h_m", "m", 0.0, 2.0, 0.5),),
    parameters=(Variable("k", "m**0.5/s", 0.0, 1.0, 0.05), Variable("g", "m/s/V", 0.0, 1.0, 0.01)),
    rhs=rhs, output=output, initial=initial,
)
"""
SPILL = """
from twinbench.physics.simulator import Term, Variable


def term(x, u, theta):
    return -theta[-2] * max(0.0, x[0] - theta[-1])


SPILL = Term(
    "spill", "the tank spills over its rim", "balance:level_m",
    (Variable("spill_1_s", "1/s", 0.0, 10.0, 0.3), Variable("rim_m", "m", 0.0, 2.0, 0.6)),
    term=term,
)
"""


def write_python(folder: Path, text: str, name: str = "tank.py") -> str:
    """The file's path, as a spec."""
    (folder / name).write_text(text)
    return str(folder / name)


def tank_table(samples: int = 60) -> pd.DataFrame:
    """(samples, 3): time_s at 2 Hz, pump_V and h_m, both moving."""
    time_s = 0.5 * np.arange(samples)
    return pd.DataFrame(
        {"time_s": time_s, "pump_V": 3.0 + np.sin(time_s / 5.0), "h_m": 0.5 + 0.1 * np.sin(time_s / 9.0)}
    )


def write_recording(folder: Path, frame: pd.DataFrame, name: str = "day.csv") -> Path:
    frame.to_csv(folder / name, index=False)
    return folder / name
