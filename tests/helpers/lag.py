"""A simulator of one state in a file: what a user writes, and can be spoilt in every place."""

from __future__ import annotations

LAG = """
import numpy as np
from twinbench.physics.simulator import Simulator, Variable

def rhs(x, u, theta):
    return np.array([(u[0] - x[0]) / theta[0]])

def output(x, u, theta):
    return np.array([x[0]])

def initial(u0, y0, theta):
    return np.array([y0[0]])

LAG = Simulator(
    "lag", (Variable("T", "K", 0.0, 1e3, 300.0),), (Variable("T_in", "K", 0.0, 1e3, 300.0),),
    (Variable("T_out", "K", 0.0, 1e3, 300.0),), (Variable("tau_s", "s", 1e-3, 1e3, 20.0),), output, initial, rhs,
)
"""
