"""Counterfactual transitions: the same history and state under other states and other health.

The measurement window of a recording reveals the machine's health, so a network trained on the
recording alone learns to ignore the parameters it is given, and its sensitivities vanish. Here the
plant answers what would have happened next from a perturbed state with other parameters, while the
window stays as it was. Part of the offline training data, and so open to every estimator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from twinbench.data.batch import Array, Batch
from twinbench.machines.machine import Machine
from twinbench.physics.integrate import Varying, advance

STIR_EDGES, STIR_SHARES = (0.1, 0.5), (0.5, 0.25, 0.25)
"""Classes of transient severity, by the largest change of an input within the window in units of its spread, and the
share of windows that each gets: of the recordings, steps and ramps are a sixth, the steep ones a fiftieth."""


class Transitions(NamedTuple):
    """M transitions over ``dt_s``: where in which sequence, from what, under what, to what.

    Attributes:
        sequence: (M,) integers, positions in the batch.
        sample: (M,) integers, positions in the sequence; the window ends here.
        x: (M, n) perturbed estimated states in their units.
        theta: (M, nh) counterfactual health in its units.
        dt_s: (M,) seconds.
        x_next: (M, n) what the plant makes of it, in the states' units.
    """

    sequence: np.ndarray
    sample: np.ndarray
    x: Array
    theta: Array
    dt_s: Array
    x_next: Array

    @property
    def increment(self) -> Array:
        """(M, n) change of state over dt_s."""
        return self.x_next - self.x


@dataclass(frozen=True)
class Sampling:
    """How transitions are drawn.

    Attributes:
        history: samples that must precede each drawn one.
        dt_s: horizons, drawn with equal chance; a tick if left out.
        each: so many transitions share a window.
        perturbed: False gives the recording's own transitions (the negative control).
        stratified: windows by transient severity, as the paper has it; else uniformly.
    """

    history: int = 64
    dt_s: tuple[float, ...] = ()
    each: int = 1
    perturbed: bool = True
    stratified: bool = False


def draw_transitions(train: Batch, count: int, rng: np.random.Generator, how: Sampling = Sampling()) -> Transitions:
    """Draw so many transitions from sequences with truth; the plant's hidden states and true inputs are kept."""
    truth = train.truth
    if truth is None:
        raise ValueError("transitions need sequences with truth, these have none")
    batch, samples = train.measured.shape[:2]
    windows = -(-count // how.each)
    if how.stratified:
        drawn = _by_severity(truth.inputs, how.history, windows, rng)
    else:
        drawn = rng.integers(batch, size=windows), rng.integers(how.history, samples - 1, size=windows)
    sequence, sample = (np.repeat(which, how.each)[:count] for which in drawn)
    machine, n, nh = train.machine, len(train.machine.estimated), len(train.machine.health)
    x = truth.states[sequence, sample].copy()
    theta = truth.health[sequence, sample].copy()
    if how.perturbed:
        near = rng.random(count)[:, None] < 0.4
        x[:, :n] += np.where(near, 0.15, 1.0) * machine.states_spread * rng.normal(size=(count, n))
        for name, least in machine.least.items():
            i = machine.estimated.index(name)
            x[:, i] = np.maximum(x[:, i], 2.0 * least)
        size = np.where(near, 0.15, 1.0) * 0.35 * machine.span * rng.normal(size=(count, nh))
        ends = machine.counterfactual
        anywhere = rng.uniform(*ends, size=(count, nh))
        theta = np.where(rng.random(count)[:, None] < 0.5, anywhere, theta + size)
        theta = np.clip(theta, *ends)
    horizons = rng.choice(np.array(how.dt_s or (machine.sample_period_s,)), size=count)
    x_next = _plant(machine, x, truth.inputs[sequence, sample], theta, horizons)
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


def _plant(machine: Machine, x: Array, u: Array, theta: Array, dt_s: Array) -> Array:
    """The estimated states (M, n) after dt_s (M,), from all of the plant's (M, nx)."""
    n = len(machine.estimated)
    after = np.empty((len(x), n))
    for horizon in np.unique(dt_s):
        rows = dt_s == horizon
        substeps = max(1, round(2 * horizon / machine.sample_period_s))
        varying = Varying(machine.health_names, theta[rows])
        after[rows] = advance(machine.plant, x[rows], u[rows], horizon, substeps, varying)[:, :n]
    return after


def plant_sensitivities(train: Batch, transitions: Transitions, step: float = 1e-3) -> tuple[Array, Array]:
    """Central differences of the plant at transitions, for audits.

    Returns:
        F (M, n, n) = d x_next / d x, and G (M, n, nh) = d x_next / d theta in physical units.
    """
    truth, machine = train.truth, train.machine
    if truth is None:
        raise ValueError("sensitivities need sequences with truth, these have none")
    n, nh = len(machine.estimated), len(machine.health)
    hidden = truth.states[transitions.sequence, transitions.sample, n:]
    u = truth.inputs[transitions.sequence, transitions.sample]
    dt_s = float(transitions.dt_s[0])

    def plant(x: Array, theta: Array) -> Array:
        full = np.concatenate([x, hidden], axis=1)
        return advance(machine.plant, full, u, dt_s, 2, Varying(machine.health_names, theta))[:, :n]

    F, G = np.empty((len(u), n, n)), np.empty((len(u), n, nh))
    for jacobian, spread, moved in ((F, machine.states_spread, 0), (G, machine.span, 1)):
        for j, size in enumerate(step * spread):
            ends = []
            for sign in (1.0, -1.0):
                arguments = [transitions.x.copy(), transitions.theta.copy()]
                arguments[moved][:, j] += sign * size
                ends.append(plant(*arguments))
            jacobian[:, :, j] = (ends[0] - ends[1]) / (2.0 * size)
    return F, G
