"""A simulator of two tanks in one file, a leak in another, and how the tests write them, whole or spoilt."""

from __future__ import annotations

from pathlib import Path

TANK = """
import numpy as np
from twinbench.physics.simulator import Simulator, Variable

def rhs(x, u, theta):
    return np.array([u[0] - theta[0] * x[0], x[0] - x[1]])

def output(x, u, theta):
    return np.array([x[1]])

def initial(u0, y0, theta):
    return np.array([y0[0], y0[0]])

STATES = (Variable("a", "m", 0.0, 2.0, 0.5), Variable("b", "m", 0.0, 2.0, 0.5))
TANK = Simulator(
    "tank", STATES, (Variable("flow", "m/s", 0.0, 10.0, 3.0),), (Variable("h", "m", 0.0, 2.0, 0.5),),
    (Variable("k", "1/s", 0.0, 1.0, 0.05),), output, initial, rhs,
)
"""
LEAK = """
from twinbench.physics.simulator import Amplitude, Mechanism, Series, Term, Variable

def leak(x, u, theta):
    return -theta[-1] * x[0]

LEAK = Term(
    name="leak", says="it leaks", port="balance:a", parameters=(Variable("c", "1/s", 0.0, 1.0, 0.1),), term=leak
)
"""


def write(folder: Path, text: str, name: str = "tank.py") -> str:
    (folder / name).write_text(text)
    return str(folder / name)
