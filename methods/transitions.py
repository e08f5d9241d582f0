"""Counterfactual transitions: the same history and state under other states and other health.

The measurement window of a recording reveals the machine's health, so a network trained on the
recording alone learns to ignore the parameters it is given, and its sensitivities vanish. Here the
plant answers what would have happened next from a perturbed state with other parameters, while the
window stays as it was. Part of the offline training data, and so open to every estimator.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from twinbench.data.batch import HEALTH, SAMPLE_PERIOD_S, STATES, Array, Batch
from twinbench.physics.compressor import PLANT
from twinbench.physics.health import HIGH, LOW, SPAN
from twinbench.physics.integrate import advance

STATE_SPREAD = np.array([0.006, 0.06, 6.0, 8.0, 0.04])
"""sd of the state perturbations: bar, bar, K, K, 1."""
HEALTH_LOW = np.array([0.86, 0.88, 0.008, 0.60, -7.0])
HEALTH_HIGH = np.array([1.03, 1.03, 0.060, 1.06, 7.0])
"""Range that the counterfactual health parameters cover, a little beyond the machine's life."""
STIR_EDGES, STIR_SHARES = (0.1, 0.5), (0.5, 0.25, 0.25)
"""Classes of transient severity, by the largest change of an input within the window in units of its spread, and the
share of windows that each gets: of the recordings, steps and ramps are a sixth, the steep ones a fiftieth."""


class Transitions(NamedTuple):
    """M transitions over ``dt_s``: where in which sequence, from what, under what, to what.

    Attributes:
        sequence: (M,) integers, positions in the batch.
        sample: (M,) integers, positions in the sequence; the window ends here.
        x: (M, 5) perturbed states in their units, order STATES.
        theta: (M, 5) counterfactual health in its units, order HEALTH.
        dt_s: (M,) seconds.
        x_next: (M, 5) what the plant makes of it, in the states' units.
    """

    sequence: np.ndarray
    sample: np.ndarray
    x: Array
    theta: Array
    dt_s: Array
    x_next: Array

    @property
    def increment(self) -> Array:
        """(M, 5) change of state over dt_s."""
        return self.x_next - self.x


def draw_transitions(
    train: Batch,
    count: int,
    rng: np.random.Generator,
    history: int = 64,
    dt_s: tuple[float, ...] = (SAMPLE_PERIOD_S,),
    each: int = 1,
    perturbed: bool = True,
    stratified: bool = False,
) -> Transitions:
    """Draw transitions from simulated sequences; the plant's hidden states and true inputs are kept.

    Args:
        train: sequences with truth.
        history: samples that must precede each drawn one.
        count: how many; ``each`` of them share a window.
        dt_s: horizons, drawn with equal chance.
        perturbed: False gives the recording's own transitions (the negative control).
        stratified: windows by transient severity, as the paper has it; else uniformly.
    """
    truth = train.truth
    if truth is None:
        raise ValueError("transitions need sequences with truth, these have none")
    batch, samples = train.measured.shape[:2]
    windows = -(-count // each)
    if stratified:
        drawn = _by_severity(truth.inputs, history, windows, rng)
    else:
        drawn = rng.integers(batch, size=windows), rng.integers(history, samples - 1, size=windows)
    sequence, sample = (np.repeat(which, each)[:count] for which in drawn)
    x = truth.states[sequence, sample].copy()
    theta = truth.health[sequence, sample].copy()
    if perturbed:
        near = rng.random(count)[:, None] < 0.4
        x[:, : len(STATES)] += np.where(near, 0.15, 1.0) * STATE_SPREAD * rng.normal(size=(count, len(STATES)))
        x[:, 4] = np.maximum(x[:, 4], 0.1)
        size = np.where(near, 0.15, 1.0) * 0.35 * SPAN * rng.normal(size=(count, len(HEALTH)))
        anywhere = rng.uniform(HEALTH_LOW, HEALTH_HIGH, size=(count, len(HEALTH)))
        theta = np.where(rng.random(count)[:, None] < 0.5, anywhere, theta + size)
        theta = np.clip(theta, np.maximum(LOW, HEALTH_LOW), np.minimum(HIGH, HEALTH_HIGH))
    horizons = rng.choice(np.array(dt_s), size=count)
    n = len(STATES)
    x_next = _plant(x, truth.inputs[sequence, sample], theta, horizons)
    return Transitions(sequence, sample, x[:, :n], theta, horizons, x_next)


def _by_severity(inputs: Array, history: int, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Sequence and sample of ``count`` windows over inputs (B, N, nu), STIR_SHARES of each class."""
    ends = {"size": history + 1, "axis": 1, "origin": history // 2}
    change = maximum_filter1d(inputs, **ends) - minimum_filter1d(inputs, **ends)
    severity = (change / inputs.std(axis=(0, 1)).clip(1e-9)).max(axis=-1)[:, history:-1]
    group = np.digitize(severity, STIR_EDGES).ravel()
    weight = np.array(STIR_SHARES) / np.bincount(group, minlength=len(STIR_SHARES)).clip(1)
    drawn = rng.choice(group.size, size=count, p=weight[group] / weight[group].sum())
    sequence, sample = np.unravel_index(drawn, severity.shape)
    return sequence, sample + history


def _plant(x: Array, u: Array, theta: Array, dt_s: Array) -> Array:
    """The five states (M, 5) after dt_s (M,), from all of the plant's (M, nx)."""
    after = np.empty((len(x), len(STATES)))
    for horizon in np.unique(dt_s):
        rows = dt_s == horizon
        substeps = max(1, round(2 * horizon / SAMPLE_PERIOD_S))
        after[rows] = advance(PLANT, x[rows], u[rows], horizon, substeps, HEALTH, theta[rows])[:, : len(STATES)]
    return after


def plant_sensitivities(train: Batch, transitions: Transitions, step: float = 1e-3) -> tuple[Array, Array]:
    """Central differences of the plant at transitions, for audits.

    Returns:
        F (M, 5, 5) = d x_next / d x, and G (M, 5, 5) = d x_next / d theta in physical units.
    """
    truth = train.truth
    if truth is None:
        raise ValueError("sensitivities need sequences with truth, these have none")
    hidden = truth.states[transitions.sequence, transitions.sample, len(STATES) :]
    u = truth.inputs[transitions.sequence, transitions.sample]
    dt_s = float(transitions.dt_s[0])

    def plant(x: Array, theta: Array) -> Array:
        full = np.concatenate([x, hidden], axis=1)
        return advance(PLANT, full, u, dt_s, 2, HEALTH, theta)[:, : len(STATES)]

    F = np.empty((len(u), len(STATES), len(STATES)))
    G = np.empty((len(u), len(STATES), len(HEALTH)))
    for jacobian, spread, moved in ((F, STATE_SPREAD, 0), (G, SPAN, 1)):
        for j, size in enumerate(step * spread):
            ends = []
            for sign in (1.0, -1.0):
                arguments = [transitions.x.copy(), transitions.theta.copy()]
                arguments[moved][:, j] += sign * size
                ends.append(plant(*arguments))
            jacobian[:, :, j] = (ends[0] - ends[1]) / (2.0 * size)
    return F, G
