"""How wrong a model is for minutes: the part of its error that does not average out.

A reduced-order model errs by an amount that depends on the operating point, and so errs the same way for as long as the
machine runs there. White process noise cannot say that: a filter that has only white noise is sure of its model's error
after a minute, and puts it down to health. A slow error per state, AR(1), can.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twinbench.data.batch import HEALTH, INPUTS, SAMPLE_PERIOD_S, STATES, Array, Batch
from twinbench.physics.integrate import Varying, advance
from twinbench.physics.simulator import Simulator

MEAN_OVER_S = 60.0
"""Errors are averaged over so long: what is left is slow. Half or twice as much changes the sizes by some per cent."""
EVERY_S = 1.0
"""Between the ticks that are looked at."""
ERROR_TAU_S = 600.0
"""Memory of the slow errors: a machine stays at an operating point for some minutes. Longer makes it harder for health
to take up what the model gets wrong, and slower for the errors to follow a change of load."""


def error_keep() -> float:
    """AR(1) factor of the slow errors from tick to tick."""
    return float(np.exp(-SAMPLE_PERIOD_S / ERROR_TAU_S))


Beyond = Callable[[Array, Array, Array], Array]
"""Of states (M, nx), inputs (M, 4) and health (M, 5) in their units: what is added to a tick's states (M, 5)."""


def slow_error_sd(simulator: Simulator, batch: Batch, substeps: int = 1, beyond: Beyond | None = None) -> Array:
    """Root mean square (5,) of the one-minute means of a model's error in a tick, in the states' units, order STATES.

    Args:
        simulator: the model; its states are the plant's.
        batch: recordings with truth, which the model was not fitted to.
        substeps: RK4 steps in a tick.
        beyond: what the model has beside the simulator.
    """
    assert batch.truth is not None
    truth, n = batch.truth, len(STATES)
    every, per_minute = round(EVERY_S / SAMPLE_PERIOD_S), round(MEAN_OVER_S / EVERY_S)
    ticks = np.arange(0, truth.states.shape[1] - 1, every)
    means = []
    for b in range(len(batch)):
        health = Varying(HEALTH, truth.health[b, ticks])
        x, u = truth.states[b, ticks, : len(simulator.states)], truth.inputs[b, ticks, : len(INPUTS)]
        after = advance(simulator, x, u, SAMPLE_PERIOD_S, substeps, health)
        error = truth.states[b, ticks + 1, :n] - after[:, :n]
        if beyond is not None:
            error -= beyond(x, u, health.values)
        minutes = np.array_split(error, max(1, len(error) // per_minute))
        means += [minute.mean(axis=0) for minute in minutes]
    return np.sqrt(np.mean(np.square(means), axis=0))
