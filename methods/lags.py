"""What follows by a first-order lag, probes and actuators, which every filter of a machine has to know."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine

LEAST = 1e-6
"""Lowest value of the state with which a lag gets faster, unless the machine's record has a higher one: a power of it
stays finite."""


class Lags(NamedTuple):
    """The lags of a machine, as compiled code takes them: k of them, in the machine's order.

    Attributes:
        column: (k,) dimensionless, where each stands among the plant's states.
        state: (k,) dimensionless, position of the estimated state that it follows; -1 where it follows an input.
        input: (k,) dimensionless, position of the input that it follows; -1 where it follows a state.
        tau_s: (k,) seconds, time constants of the plant, at one of ``with_state``.
        with_state: (k,) dimensionless, position of the estimated state with which it gets faster; -1: with none.
        exponent: (k,) dimensionless: the time constant is ``tau_s * state ** -exponent``.
        least: (k,) the lowest value of that state that counts, in its unit.
        period_s: from tick to tick.
    """

    column: np.ndarray
    state: np.ndarray
    input: np.ndarray
    tau_s: Array
    with_state: np.ndarray
    exponent: Array
    least: Array
    period_s: float


def lags_of(machine: Machine) -> Lags:
    """The lags of a machine."""
    theta, states = machine.plant.theta(), [v.name for v in machine.plant.states]

    def parameter(name: str) -> float:
        return float(theta[machine.plant.index(name)]) if name else 0.0

    def places(names: list[str], among: tuple[str, ...]) -> np.ndarray:
        return np.array([among.index(name) if name in among else -1 for name in names], dtype=np.int64)

    lags = machine.lags
    return Lags(
        column=np.array([states.index(lag.state) for lag in lags], dtype=np.int64),
        state=places([lag.follows for lag in lags], machine.estimated),
        input=places([lag.follows for lag in lags], machine.inputs),
        tau_s=np.array([parameter(lag.tau_s) for lag in lags]),
        with_state=places([lag.faster_with for lag in lags], machine.estimated),
        exponent=np.array([parameter(lag.exponent) for lag in lags]),
        least=np.array([max(machine.least.get(lag.faster_with, 0.0), LEAST) for lag in lags]),
        period_s=machine.sample_period_s,
    )


@njit(cache=True, error_model="numpy")
def lag_share(lags, i, x):  # type: ignore[no-untyped-def]
    """Share of its gap that the i-th lag closes in a tick at states x (n,), its slope to the state ``with_state``."""
    k = lags.with_state[i]
    if k < 0:
        return 1.0 - np.exp(-lags.period_s / lags.tau_s[i]), 0.0
    value = max(x[k], lags.least[i])
    tau = lags.tau_s[i] * value ** -lags.exponent[i]
    keep = np.exp(-lags.period_s / tau)
    return 1.0 - keep, keep * lags.period_s / tau * lags.exponent[i] / value
