"""Offline training of the operator, Eq. (4), on counterfactual transitions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from twinbench.data.batch import Array, Batch
from twinbench.machines.coordinates import ZETA_SCALE
from twinbench.machines.machine import Machine
from twinbench.methods.deeponet_kalman.augmentation import augmented
from twinbench.methods.deeponet_kalman.windows import WindowBatch, WindowSource
from twinbench.methods.operator import Operator, acting
from twinbench.methods.training import adamw
from twinbench.methods.transitions import Sampling, Transitions, draw_transitions, plant_sensitivities

HORIZONS = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 2.0)
"""Query times of the training transitions, in ticks: mostly one, some shorter and longer."""
SMOOTHNESS_STEP = 1.1
REFINED_WINDOWS = 8192
"""Windows of the batch on which the heads are refined."""


@dataclass(frozen=True)
class Scales:
    """How states enter the heads and increments leave them.

    Attributes:
        machine: whose.
        state_mean: (n,) means of the training states in their units.
        state_scale: (n,) their spreads in the same units.
        increment: (n,) spread of the states' change in a tick, in the same units.
    """

    machine: Machine
    state_mean: Array
    state_scale: Array
    increment: Array

    @staticmethod
    def fit(machine: Machine, transitions: Transitions) -> Scales:
        """Spreads of the counterfactual states and one-tick increments."""
        moved = transitions.increment[transitions.dt_s == machine.sample_period_s].std(axis=0)
        return Scales(machine, transitions.x.mean(axis=0), transitions.x.std(axis=0), moved)

    def condition(self, x: Array, theta: Array, seen: float = 1.0) -> np.ndarray:
        """What the heads are conditioned on, (..., n + na) float32, from x (..., n) and theta (..., nh).

        Args:
            x: (..., n) states in their units.
            theta: (..., nh) health in the parameters' units.
            seen: 0 hides health.
        """
        zeta = seen * self.machine.coordinates.to_zeta(theta)[..., acting(self.machine)]
        return np.concatenate([(x - self.state_mean) / self.state_scale, zeta / ZETA_SCALE], axis=-1).astype(np.float32)


@dataclass(frozen=True)
class Recipe:
    """How the operator is trained: Eq. (4) with state error 1, and what may be left out to see its worth.

    Attributes:
        iterations, windows, learning_rate: of AdamW, whose weight decay is the ridge of Eq. (4).
        smoothness, feasibility: weights of the derivative and feasibility terms.
        conditioned: do the heads see the health parameters?
        augmented: is noise drawn anew for every window?
        refinement: iterations of L-BFGS on the heads, afterwards.
    """

    iterations: int
    windows: int
    learning_rate: float
    smoothness: float = 1e-3
    feasibility: float = 0.1
    conditioned: bool = True
    augmented: bool = False
    refinement: int = 0


def feasibility(x_next: Tensor, low: Tensor, high: Tensor, scale: Tensor) -> Tensor:
    """Penalty of Eq. (4) on states that no such machine has, beyond the bounds of its states; mean over the batch.

    Args:
        x_next: (B, n) states after the tick in their units.
        low: (n,) lowest values, in the same units.
        high: (n,) highest values, likewise.
        scale: (n,) typical changes, likewise.
    """
    beyond = torch.relu(low - x_next) + torch.relu(x_next - high)
    return (beyond / scale).square().sum(dim=1).mean()


class _Examples:
    """Transitions as tensors, ready to be drawn by window."""

    def __init__(
        self,
        source: WindowSource,
        transitions: Transitions,
        scales: Scales,
        conditioned: bool,
    ) -> None:
        def tensor(values: Array) -> Tensor:
            return torch.from_numpy(values.astype(np.float32))

        self.source, self.transitions = source, transitions
        self.each = int(np.argmax(np.diff(transitions.sample * 100_000 + transitions.sequence) != 0)) + 1
        self.groups = np.arange(len(transitions.sample) // self.each)
        self.condition = tensor(scales.condition(transitions.x, transitions.theta, float(conditioned)))
        self.target = tensor(transitions.increment / scales.increment)
        self.state, self.time_s = tensor(transitions.x), tensor(transitions.dt_s)
        self.increment = tensor(scales.increment)
        machine, n = scales.machine, len(scales.machine.estimated)
        low, high = (tensor(bound[:n]) for bound in machine.state_bounds)
        self.bounds = low, high, tensor(machine.scales[:n])

    def rows(self, group: np.ndarray) -> np.ndarray:
        """Transitions of given windows."""
        return np.asarray((group[:, None] * self.each + np.arange(self.each)).ravel())

    def windows(self, group: np.ndarray) -> WindowBatch:
        """The windows themselves."""
        return self.source.at(self.transitions.sequence[group * self.each], self.transitions.sample[group * self.each])


def fit_operator(
    operator: Operator,
    source: WindowSource,
    transitions: Transitions,
    scales: Scales,
    rng: np.random.Generator,
    recipe: Recipe,
) -> list[float]:
    """Minimise Eq. (4); every iteration draws windows with all their transitions."""
    examples = _Examples(source, transitions, scales, recipe.conditioned)
    if not recipe.conditioned:
        with torch.no_grad():
            operator.heads.from_condition.weight[:, len(scales.increment) :] = 0.0

    def loss(_: int) -> Tensor:
        group = rng.choice(examples.groups, size=recipe.windows)
        rows, window = examples.rows(group), examples.windows(group)
        if recipe.augmented:
            window = augmented(window, source, rng)
        branch = operator.branch(window.values, window.masks, window.slow).repeat_interleave(examples.each, dim=0)
        query = window.query.repeat_interleave(examples.each, dim=0)
        dt, condition = examples.time_s[rows], examples.condition[rows]
        latent = branch * operator.trunk(query, dt)
        predicted = operator(latent, condition, dt)
        # Huber: a suction step that the front end holds back for a sample is nobody's fault.
        value = 2.0 * functional.huber_loss(predicted, examples.target[rows])
        few = slice(0, len(rows), 8)
        later = SMOOTHNESS_STEP * dt[few]
        again = operator(branch[few] * operator.trunk(query[few], later), condition[few], later)
        rate = again / SMOOTHNESS_STEP - predicted[few]
        value = value + recipe.smoothness * rate.square().mean()
        infeasible = feasibility(examples.state[rows] + predicted * examples.increment, *examples.bounds)
        value = value + recipe.feasibility * infeasible
        return value

    losses = adamw(operator, loss, recipe.iterations, recipe.learning_rate)
    if recipe.refinement:
        losses += refine_heads(operator, examples, rng, recipe.refinement)
    return losses


def refine_heads(operator: Operator, examples: _Examples, rng: np.random.Generator, iterations: int) -> list[float]:
    """L-BFGS on the heads alone, on one large batch whose latents are computed once."""
    group = rng.choice(examples.groups, size=min(REFINED_WINDOWS, len(examples.groups)), replace=False)
    rows = examples.rows(group)
    with torch.no_grad():
        parts = []
        for some in np.array_split(group, max(1, len(group) // 1024)):
            window = examples.windows(some)
            branch = operator.branch(window.values, window.masks, window.slow).repeat_interleave(examples.each, dim=0)
            query = window.query.repeat_interleave(examples.each, dim=0)
            parts.append(branch * operator.trunk(query, examples.time_s[examples.rows(some)]))
        latent = torch.cat(parts)
    condition, target, dt = examples.condition[rows], examples.target[rows], examples.time_s[rows]
    optimiser = torch.optim.LBFGS(operator.heads.parameters(), max_iter=iterations, line_search_fn="strong_wolfe")
    losses: list[float] = []

    def closure() -> Tensor:
        optimiser.zero_grad(set_to_none=True)
        value = 2.0 * functional.huber_loss(operator(latent, condition, dt), target)
        value.backward()  # type: ignore[no-untyped-call]
        losses.append(float(value.detach()))
        return value

    optimiser.step(closure)  # type: ignore[no-untyped-call]
    return losses


@torch.no_grad()
def predict(operator: Operator, source: WindowSource, transitions: Transitions, scales: Scales) -> Array:
    """Increments (M, n) in physical units at given transitions."""
    out = []
    for start in range(0, len(transitions.sample), 4096):
        part = Transitions(*(a[start : start + 4096] for a in transitions))
        window: WindowBatch = source.at(part.sequence, part.sample)
        time_s = torch.from_numpy(part.dt_s.astype(np.float32))
        latent = operator.latent(*window, time_s)
        condition = torch.from_numpy(scales.condition(part.x, part.theta))
        out.append(operator(latent, condition, time_s).numpy() * scales.increment)
    return np.concatenate(out)


def _along_the_recordings(
    operator: Operator, source: WindowSource, validation: Batch, scales: Scales, stride: int = 6
) -> Array:
    """One-tick errors (minutes, samples in a minute, n) at the true states and health."""
    truth = validation.truth
    if truth is None:
        raise ValueError("the audit needs validation sequences with truth, these have none")
    machine, n = validation.machine, len(validation.machine.estimated)
    per_minute = max(int(60.0 / machine.sample_period_s) // stride, 1)
    ticks = np.arange(source.window, validation.measured.shape[1] - 1, stride)
    ticks = ticks[: max(1, len(ticks) // per_minute) * per_minute]
    sequence = np.repeat(np.arange(len(validation)), len(ticks))
    sample = np.tile(ticks, len(validation))
    own = Transitions(
        sequence,
        sample,
        truth.states[sequence, sample, :n],
        truth.health[sequence, sample],
        np.full(len(sample), machine.sample_period_s),
        truth.states[sequence, sample + 1, :n],
    )
    error = predict(operator, source, own, scales) - own.increment
    return error.reshape(-1, min(per_minute, len(ticks)), n)


@dataclass(frozen=True)
class Audit:
    """Is the operator fit to be a filter's model? ``method.check_audit`` asks each checkpoint before it is used.

    Attributes:
        residual_cov: (n, n) covariance of the quick part of the one-tick error on the validation recordings themselves,
            in the states' units squared.
        slow_sd: (n,) sd of its one-minute means, the part that does not average out, in the recordings' second halves,
            in the states' units.
        first_sd: (n,) the same at their beginning, where the running means have not yet seen what the metal has, in the
            states' units.
        G_cosine: (na,) dimensionless agreement of the direction of each acting column of G with the plant's, over the
            sensitivities of all states in units of the increments; 1 is perfect.
        G_size: (na,) dimensionless, the size of each over the plant's, likewise.
        F_cosine: (n,) dimensionless, the same as G_cosine for the state columns of F - I.
    """

    residual_cov: Array
    slow_sd: Array
    first_sd: Array
    G_cosine: Array
    G_size: Array
    F_cosine: Array


def audit(
    operator: Operator,
    source: WindowSource,
    validation: Batch,
    scales: Scales,
    rng: np.random.Generator,
    count: int = 4000,
) -> Audit:
    """Compare residuals and sensitivities with the plant on the validation sequences."""
    residual = _along_the_recordings(operator, source, validation, scales)
    slow = residual.mean(axis=1, keepdims=True)
    machine, n = validation.machine, len(validation.machine.estimated)
    quick = (residual - slow).reshape(-1, n)
    probe = draw_transitions(validation, count // 4, rng, Sampling(source.window))
    F, G = plant_sensitivities(validation, probe)
    step = 0.02
    J_x, J_theta = np.empty_like(F), np.empty_like(G)
    spreads = (0.05 * scales.state_scale, step * machine.span)
    for jacobian, sizes, which in ((J_x, spreads[0], "x"), (J_theta, spreads[1], "theta")):
        for j, size in enumerate(sizes):
            ends = []
            for sign in (1.0, -1.0):
                moved = getattr(probe, which).copy()
                moved[:, j] += sign * size
                ends.append(predict(operator, source, probe._replace(**{which: moved}), scales))
            jacobian[:, :, j] = (ends[0] - ends[1]) / (2 * size)
    per_state = 1.0 / scales.increment[:, None]

    def agreement(ours: Array, plants: Array) -> tuple[Array, Array]:
        a, b = ours * per_state, plants * per_state
        inner = (a * b).sum(axis=(0, 1))
        size_a, size_b = (np.sqrt((m * m).sum(axis=(0, 1))) for m in (a, b))
        return inner / (size_a * size_b + 1e-30), size_a / (size_b + 1e-30)

    G_cosine, G_size = agreement(J_theta[..., acting(machine)], G[..., acting(machine)])
    F_cosine, _ = agreement(J_x, F - np.eye(n))
    slow = slow.reshape(len(validation), -1, n)
    minutes = slow.shape[1]
    parts = slow[:, minutes // 2 :], slow[:, : 1 + minutes // 20]
    settled, first = (np.sqrt((part**2).mean(axis=(0, 1))) for part in parts)
    return Audit(np.atleast_2d(np.cov(quick.T)), settled, np.maximum(settled, first), G_cosine, G_size, F_cosine)
