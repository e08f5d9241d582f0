"""Offline training of the operator, Eq. (4), on counterfactual transitions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from data.batch import SAMPLE_PERIOD_S, STATES, Array, Batch
from methods.operator import N_ZETA, WINDOW, Operator
from methods.stream import ZETA_SCALE
from methods.training import adamw
from methods.transitions import Transitions, draw_transitions, plant_sensitivities
from methods.windows import WindowBatch, WindowSource
from physics.health import to_zeta

HORIZONS_S = (0.05, 0.05, 0.05, 0.05, 0.05, 0.05, 0.025, 0.1)
"""Query times of the training transitions: mostly one tick, some shorter and longer."""
RATIO_LIMITS = (1.0, 6.5)
SMOOTHNESS_STEP = 1.1


@dataclass(frozen=True)
class Scales:
    """How states enter the heads and increments leave them, each (5,)."""

    state_mean: Array
    state_scale: Array
    increment: Array

    @staticmethod
    def fit(transitions: Transitions) -> Scales:
        """Spreads of the counterfactual states and one-tick increments."""
        tick = transitions.dt_s == SAMPLE_PERIOD_S
        return Scales(
            transitions.x.mean(axis=0), transitions.x.std(axis=0), transitions.increment[tick].std(axis=0)
        )

    def condition(self, x: Array, zeta: Array) -> np.ndarray:
        """What the heads are conditioned on, (..., 9) float32, from x (..., 5) and zeta (..., 4 or 5)."""
        standard = (x - self.state_mean) / self.state_scale
        return np.concatenate([standard, zeta[..., :N_ZETA] / ZETA_SCALE], axis=-1).astype(np.float32)


@dataclass(frozen=True)
class LossWeights:
    """Eq. (4): state error 1, derivative smoothness, feasibility; the ridge is AdamW's weight decay."""

    smoothness: float = 1e-3
    feasibility: float = 0.1


def feasibility(x: Tensor, x_next: Tensor, suction: Tensor) -> Tensor:
    """Penalty of Eq. (4) on what no compressor does, mean over the batch.

    Negative flow, gas leaving colder than it entered, a pressure ratio outside the simulated range.

    Args:
        x, x_next: (B, 5) states in physical units.
        suction: (B, 2) suction pressure in bar and temperature in K.
    """
    flow = torch.relu(-x_next[:, 4])
    cold = torch.relu(suction[:, 1] - x_next[:, 2]) / 10.0
    ratio = x_next[:, 1] / suction[:, 0]
    beyond = torch.relu(ratio - RATIO_LIMITS[1]) + torch.relu(RATIO_LIMITS[0] - ratio)
    return (flow.square() + cold.square() + beyond.square()).mean()


def fit_operator(
    operator: Operator,
    source: WindowSource,
    transitions: Transitions,
    scales: Scales,
    rng: np.random.Generator,
    iterations: int,
    windows: int,
    learning_rate: float,
    weights: LossWeights,
) -> list[float]:
    """Minimise Eq. (4) by AdamW; every iteration draws ``windows`` windows with all their transitions."""
    count = len(transitions.sample)
    each = int(np.argmax(np.diff(transitions.sample * 100_000 + transitions.sequence) != 0)) + 1
    groups = np.arange(count // each)
    condition = torch.from_numpy(scales.condition(transitions.x, to_zeta(transitions.theta)))
    target = torch.from_numpy((transitions.increment / scales.increment).astype(np.float32))
    state = torch.from_numpy(transitions.x.astype(np.float32))
    horizon = torch.from_numpy(transitions.dt_s.astype(np.float32))
    increment = torch.from_numpy(scales.increment.astype(np.float32))
    q_mean = torch.from_numpy(source.query_mean.astype(np.float32))
    q_scale = torch.from_numpy(source.query_scale.astype(np.float32))

    def loss(_: int) -> Tensor:
        group = rng.choice(groups, size=windows)
        rows = (group[:, None] * each + np.arange(each)).ravel()
        window = source.at(transitions.sequence[group * each], transitions.sample[group * each])
        branch = operator.branch(window.values, window.masks, window.slow).repeat_interleave(each, dim=0)
        query = window.query.repeat_interleave(each, dim=0)
        dt = horizon[rows]
        predicted = operator(branch * operator.trunk(query, dt), condition[rows], dt)
        # Huber: a suction step that the front end holds back for a sample is nobody's fault.
        error = 2.0 * functional.huber_loss(predicted, target[rows])
        few = slice(0, len(rows), 8)
        later = SMOOTHNESS_STEP * dt[few]
        again = operator(branch[few] * operator.trunk(query[few], later), condition[rows][few], later)
        rate = again / SMOOTHNESS_STEP - predicted[few]
        suction = query[:, [3, 2]] * q_scale[[3, 2]] + q_mean[[3, 2]]
        infeasible = feasibility(state[rows], state[rows] + predicted * increment, suction)
        return error + weights.smoothness * rate.square().mean() + weights.feasibility * infeasible

    return adamw(operator, loss, iterations, learning_rate)


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
    ticks = np.arange(WINDOW, validation.measured.shape[1] - 1, stride)
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
    """Is the operator fit to be a filter's model? Each checkpoint is asked before it is used.

    Attributes:
        residual_cov: (5, 5) covariance of the quick part of the one-tick error on the validation
            recordings themselves.
        slow_sd: (5,) sd of its one-minute means, the part that does not average out.
        G_cosine, G_size: (4,) agreement of each health column of G with the plant's, over the
            sensitivities of all states in units of the increments; 1 and 1 is perfect.
        F_cosine: (5,) the same for the state columns of F - I.
    """

    residual_cov: Array
    slow_sd: Array
    G_cosine: Array
    G_size: Array
    F_cosine: Array

    @property
    def passed(self) -> bool:
        """The checkpoint rule: signs right and sizes within a third, for every health parameter."""
        return bool((self.G_cosine > 0.9).all() and (np.abs(np.log(self.G_size)) < np.log(1.5)).all())


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
    probe = draw_transitions(validation, count // 4, rng)
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
    return Audit(np.cov(quick.T), np.sqrt((slow**2).mean(axis=(0, 1))), G_cosine, G_size, F_cosine)
