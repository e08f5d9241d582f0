"""Offline training of the operator, Eq. (4), on counterfactual transitions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from twinbench.data.batch import SAMPLE_PERIOD_S, STATE, STATES, Array, Batch
from twinbench.methods.deeponet_kalman.augmentation import augmented
from twinbench.methods.deeponet_kalman.windows import WindowBatch, WindowSource
from twinbench.methods.operator import N_STATES, N_ZETA, Operator
from twinbench.methods.training import adamw
from twinbench.methods.transitions import Sampling, Transitions, draw_transitions, plant_sensitivities
from twinbench.physics.health import ZETA_SCALE, to_zeta

HORIZONS_S = (0.05, 0.05, 0.05, 0.05, 0.05, 0.05, 0.025, 0.1)
"""Query times of the training transitions: mostly one tick, some shorter and longer."""
FEASIBLE_RATIOS = (1.0, 6.5)
SMOOTHNESS_STEP = 1.1
REFINED_WINDOWS = 8192
"""Windows of the batch on which the heads are refined."""


@dataclass(frozen=True)
class Scales:
    """How states enter the heads and increments leave them.

    Attributes:
        state_mean: (5,) means of the training states in their units, order STATES.
        state_scale: (5,) their spreads in the same units.
        increment: (5,) spread of the states' change in a tick, in the same units.
    """

    state_mean: Array
    state_scale: Array
    increment: Array

    @staticmethod
    def fit(transitions: Transitions) -> Scales:
        """Spreads of the counterfactual states and one-tick increments."""
        tick = transitions.dt_s == SAMPLE_PERIOD_S
        return Scales(transitions.x.mean(axis=0), transitions.x.std(axis=0), transitions.increment[tick].std(axis=0))

    def condition(self, x: Array, zeta: Array) -> np.ndarray:
        """What the heads are conditioned on, (..., 9) float32, from x (..., 5) and zeta (..., 4 or 5).

        Args:
            x: (..., 5) states in their units, order STATES.
            zeta: (..., 4) or (..., 5) dimensionless coordinates of health.
        """
        standard = (x - self.state_mean) / self.state_scale
        return np.concatenate([standard, zeta[..., :N_ZETA] / ZETA_SCALE], axis=-1).astype(np.float32)


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


def feasibility(x_next: Tensor, suction: Tensor) -> Tensor:
    """Penalty of Eq. (4) on what no compressor does, mean over the batch.

    Negative flow, gas leaving colder than it entered, a pressure ratio outside the simulated range.

    Args:
        x_next: (B, 5) states after the tick in physical units, order STATES.
        suction: (B, 2) suction pressure in bar and temperature in K.
    """
    flow = torch.relu(-x_next[:, STATE.flow_memory])
    cold = torch.relu(suction[:, 1] - x_next[:, STATE.T_gas_K]) / 10.0
    ratio = x_next[:, STATE.p_exh_bar] / suction[:, 0]
    beyond = torch.relu(ratio - FEASIBLE_RATIOS[1]) + torch.relu(FEASIBLE_RATIOS[0] - ratio)
    return (flow.square() + cold.square() + beyond.square()).mean()


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

        zeta = to_zeta(transitions.theta) * conditioned
        self.source, self.transitions = source, transitions
        self.each = int(np.argmax(np.diff(transitions.sample * 100_000 + transitions.sequence) != 0)) + 1
        self.groups = np.arange(len(transitions.sample) // self.each)
        self.condition = tensor(scales.condition(transitions.x, zeta))
        self.target = tensor(transitions.increment / scales.increment)
        self.state, self.time_s = tensor(transitions.x), tensor(transitions.dt_s)
        self.increment = tensor(scales.increment)
        self.q_mean, self.q_scale = tensor(source.query_mean), tensor(source.query_scale)

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
            operator.heads.from_condition.weight[:, N_STATES:] = 0.0

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
        suction = query[:, [3, 2]] * examples.q_scale[[3, 2]] + examples.q_mean[[3, 2]]
        state = examples.state[rows]
        infeasible = feasibility(state + predicted * examples.increment, suction)
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
    """Increments (M, 5) in physical units at given transitions."""
    out = []
    for start in range(0, len(transitions.sample), 4096):
        part = Transitions(*(a[start : start + 4096] for a in transitions))
        window: WindowBatch = source.at(part.sequence, part.sample)
        time_s = torch.from_numpy(part.dt_s.astype(np.float32))
        latent = operator.latent(*window, time_s)
        condition = torch.from_numpy(scales.condition(part.x, to_zeta(part.theta)))
        out.append(operator(latent, condition, time_s).numpy() * scales.increment)
    return np.concatenate(out)


def _along_the_recordings(
    operator: Operator, source: WindowSource, validation: Batch, scales: Scales, stride: int = 6
) -> Array:
    """One-tick errors (minutes, samples in a minute, 5) at the true states and health."""
    truth = validation.truth
    if truth is None:
        raise ValueError("the audit needs validation sequences with truth, these have none")
    per_minute = int(60.0 / SAMPLE_PERIOD_S) // stride
    ticks = np.arange(source.window, validation.measured.shape[1] - 1, stride)
    ticks = ticks[: max(1, len(ticks) // per_minute) * per_minute]
    sequence = np.repeat(np.arange(len(validation)), len(ticks))
    sample = np.tile(ticks, len(validation))
    n = len(STATES)
    own = Transitions(
        sequence,
        sample,
        truth.states[sequence, sample, :n],
        truth.health[sequence, sample],
        np.full(len(sample), SAMPLE_PERIOD_S),
        truth.states[sequence, sample + 1, :n],
    )
    error = predict(operator, source, own, scales) - own.increment
    return error.reshape(-1, min(per_minute, len(ticks)), n)


@dataclass(frozen=True)
class Audit:
    """Is the operator fit to be a filter's model? ``method.check_audit`` asks each checkpoint before it is used.

    Attributes:
        residual_cov: (5, 5) covariance of the quick part of the one-tick error on the validation recordings themselves,
            in the states' units squared.
        slow_sd: (5,) sd of its one-minute means, the part that does not average out, in the recordings' second halves,
            in the states' units.
        first_sd: (5,) the same at their beginning, where the running means have not yet seen what the metal has, in the
            states' units.
        G_cosine: (4,) dimensionless agreement of the direction of each health column of G with the plant's, over the
            sensitivities of all states in units of the increments; 1 is perfect.
        G_size: (4,) dimensionless, the size of each over the plant's, likewise.
        F_cosine: (5,) dimensionless, the same as G_cosine for the state columns of F - I.
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
    quick = (residual - slow).reshape(-1, len(STATES))
    probe = draw_transitions(validation, count // 4, rng, Sampling(source.window))
    F, G = plant_sensitivities(validation, probe)
    step = 0.02
    J_x, J_theta = np.empty_like(F), np.empty_like(G)
    spreads = (0.05 * scales.state_scale, step * np.array([0.12, 0.10, 0.037, 0.35, 6.0]))
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

    G_cosine, G_size = agreement(J_theta[..., :N_ZETA], G[..., :N_ZETA])
    F_cosine, _ = agreement(J_x, F - np.eye(len(STATES)))
    slow = slow.reshape(len(validation), -1, len(STATES))
    minutes = slow.shape[1]
    parts = slow[:, minutes // 2 :], slow[:, : 1 + minutes // 20]
    settled, first = (np.sqrt((part**2).mean(axis=(0, 1))) for part in parts)
    return Audit(np.cov(quick.T), settled, np.maximum(settled, first), G_cosine, G_size, F_cosine)
