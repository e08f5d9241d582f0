"""How wrong a model is for minutes: the part of its error that does not average out.

A reduced-order model errs by an amount that depends on the operating point, and so errs the same way for as long as the
machine runs there. White process noise cannot say that: a filter that has only white noise is sure of its model's error
after a minute, and puts it down to health. A slow error per state, AR(1), can.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twinbench.data.batch import Array, Batch
from twinbench.machines.machine import Machine
from twinbench.physics.integrate import Varying, advance
from twinbench.physics.simulator import Simulator

MEAN_OVER_S = 60.0
"""Errors are averaged over so long: what is left is slow. Half or twice as much changes the sizes by some per cent."""
EVERY_S = 1.0
"""Between the ticks that are looked at."""
ERROR_TAU_S = 600.0
"""Memory of the slow errors: a machine stays at an operating point for some minutes. Longer makes it harder for health
to take up what the model gets wrong, and slower for the errors to follow a change of load."""


def error_keep(machine: Machine) -> float:
    """AR(1) factor of the slow errors from tick to tick."""
    return float(np.exp(-machine.sample_period_s / ERROR_TAU_S))


Beyond = Callable[[Array, Array, Array], Array]
"""Of states (M, nx), inputs (M, nu), health (M, nh) in their units: what is added to a tick's first n states (M, n)."""


def slow_error_sd(simulator: Simulator, batch: Batch, substeps: int = 1, beyond: Beyond | None = None) -> Array:
    """Root mean square (n,) of the one-minute means of a model's error in a tick, in the estimated states' units.

    Args:
        simulator: the model; its states are the plant's.
        batch: recordings with truth, which the model was not fitted to.
        substeps: RK4 steps in a tick.
        beyond: what the model has beside the simulator.
    """
    assert batch.truth is not None
    machine, truth, n = batch.machine, batch.truth, len(batch.machine.estimated)
    every = max(1, round(EVERY_S / machine.sample_period_s))
    per_minute = max(1, round(MEAN_OVER_S / (every * machine.sample_period_s)))
    ticks = np.arange(0, truth.states.shape[1] - 1, every)
    means = []
    for b in range(len(batch)):
        health = Varying(machine.health_names, truth.health[b, ticks])
        x, u = truth.states[b, ticks, : len(simulator.states)], truth.inputs[b, ticks]
        after = advance(simulator, x, u, machine.sample_period_s, substeps, health)
        error = truth.states[b, ticks + 1, :n] - after[:, :n]
        if beyond is not None:
            error -= beyond(x, u, health.values)
        minutes = np.array_split(error, max(1, len(error) // per_minute))
        means += [minute.mean(axis=0) for minute in minutes]
    return np.sqrt(np.mean(np.square(means), axis=0))
