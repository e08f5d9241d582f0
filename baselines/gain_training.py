"""Training of a network that says a filter's gain: through the filter, a stretch of ticks at a time.

The filter runs on from stretch to stretch, and gradients end where a stretch begins. Model and outputs are linearised
where the filter is, so gradients pass through their slopes and no equation need be written again. The loss is the
negative log-likelihood of the true states and health under what the filter says (Mortada et al., 2025).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from numba import njit
from torch import Tensor, nn

from twinbench.baselines.augmented_model import bound, linearise, measure
from twinbench.baselines.learned_gain import GAIN_SPAN, NOISE_SPAN, SD_LIMIT, Rules, correct, seen, width
from twinbench.baselines.sequences import Schedule
from twinbench.data.batch import Array
from twinbench.machines.machine import Machine
from twinbench.methods.kalman import INNOVATION_CLIP_SD, gain
from twinbench.methods.noise import input_sd, output_sd, sheet_of
from twinbench.methods.training import adamw

BACK_TICKS = 64
"""Ticks of back-propagation through the filter. A correction shows in the loss at once, so that longer ones cost more
and teach little."""
JUDGED_EVERY = 8
"""Ticks between those at which the likelihood is taken: it changes little from tick to tick."""
GIVEN_UP = 100.0
"""Squared deviations per entry, from which on a machine teaches nothing and begins another sequence: ten standard
deviations in each. Early in training some filters lose their machine; of the trained ones none was seen to."""
COV_JITTER = 1e-9
"""Added to covariances in units of those before the first sample, where their likelihood is taken."""


class GainNetwork(nn.Module):
    """A recurrent cell at every tick; of its state the gain, and the scales of process and measurement noise.

    Attributes:
        reach: (n, ny) dimensionless root mean square of the usual gain.
    """

    def __init__(self, hidden: int, mean: Array, reach: Array, channels: int) -> None:
        """At first it says the mean of the Kalman filter's gain (n, ny), whatever it reads.

        Args:
            hidden: width of the cell.
            mean: (n, ny) dimensionless.
            reach: (n, ny) dimensionless root mean square of the same, which what it says is a multiple of.
            channels: of the machine.
        """
        super().__init__()
        size, outputs = mean.shape
        self.reach: Tensor
        self.register_buffer("reach", torch.from_numpy(reach))
        self.cell = nn.GRUCell(width(size, outputs, channels), hidden)
        self.head = nn.Linear(hidden, mean.size + size + outputs)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)
        share = np.divide(mean, reach, out=np.zeros_like(mean), where=reach > 0.0)
        with torch.no_grad():
            self.head.bias[: mean.size] = torch.from_numpy(GAIN_SPAN * np.arctanh(share / GAIN_SPAN)).ravel()

    def forward(self, read: Tensor, h: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Gain (B, n, ny) and logarithms of the noise's scales (B, n + ny), float64, and the cell's state.

        Args:
            read: (B, F) dimensionless, what ``seen`` gives.
            h: (B, hidden) dimensionless.
        """
        h = self.cell(read, h)
        said = self.head(h).double()
        cut = self.reach.numel()
        multiple = GAIN_SPAN * torch.tanh(said[:, :cut] / GAIN_SPAN).unflatten(1, self.reach.shape)
        return multiple * self.reach, NOISE_SPAN * torch.tanh(said[:, cut:] / NOISE_SPAN), h


class Carried(NamedTuple):
    """What goes from tick to tick, B machines.

    Attributes:
        z: (B, n) mean in the units of z.
        P: (B, n, n) its covariance, in those units squared.
        h: (B, hidden) dimensionless, the network's.
        noise: (B, n + ny) dimensionless logarithms of the noise's scales, as said a tick before.
    """

    z: Tensor
    P: Tensor
    h: Tensor
    noise: Tensor


class Equations(NamedTuple):
    """The model as compiled code takes it."""

    rhs: Any
    output: Any
    rules: Rules


def told_of(machine: Machine, filled: Array, accepted: np.ndarray) -> tuple[Array, ...]:
    """Of stretches: inputs before and at each tick, their sd (B, L, nu), outputs, white and coloured sd (B, L, ny).

    Args:
        machine: whose.
        filled: (B, 1 + L, nu + ny) readings in the channels' units, one more tick before the first.
        accepted: (B, 1 + L, nu + ny) bool, were they taken?
    """
    nu = len(machine.inputs)
    before, now = (np.ascontiguousarray(part[..., :nu]) for part in (filled[:, :-1], filled[:, 1:]))
    at = filled[:, 1:]
    flat = at.reshape(-1, at.shape[-1])
    measured = np.where(accepted[:, 1:], at, np.nan)[..., nu:].copy()
    sds = (part.reshape(*at.shape[:2], -1) for part in (input_sd(machine, flat), *output_sd(sheet_of(machine), flat)))
    u_sd, white, coloured = sds
    return before, now, u_sd, measured, white, coloured


@njit(cache=True, error_model="numpy")
def _prior(rhs, rules, z, before, u_sd, out):  # type: ignore[no-untyped-def]
    for b in range(z.shape[0]):
        out[0][b], out[1][b], out[2][b] = linearise(rhs, rules.model, z[b], before[b], u_sd[b])


@njit(cache=True, error_model="numpy")
def _look(output, rules, z, now, measured, white, coloured, out):  # type: ignore[no-untyped-def]
    for b in range(z.shape[0]):
        out[0][b], out[1][b], out[2][b] = measure(output, rules.model, z[b], now[b], measured[b], white[b], coloured[b])


@njit(cache=True, error_model="numpy")
def _seen(rules, values, innovation, S, P, out):  # type: ignore[no-untyped-def]
    for b in range(values.shape[0]):
        out[b] = seen(rules, values[b], innovation[b], S[b], P[b])


@njit(cache=True, error_model="numpy")
def _held(rules, z):  # type: ignore[no-untyped-def]
    for b in range(z.shape[0]):
        bound(rules.model, z[b])


@njit(cache=True, error_model="numpy")
def usual_gain(rhs, output, rules, z, P, told):  # type: ignore[no-untyped-def]
    """Of the Kalman filter's own gain, dimensionless, over sequences and ticks: mean and root mean square, (n, ny).

    Args:
        z: (B, n) before the first tick.
        P: (B, n, n) its covariance.
        told: what ``told_of`` gives of B sequences.
    """
    before, now, u_sd, measured, white, coloured = told
    ny = measured.shape[2]
    mean, square, count = np.zeros((z.shape[1], ny)), np.zeros((z.shape[1], ny)), np.zeros(ny)
    for b in range(z.shape[0]):
        at, cov = z[b].copy(), P[b].copy()
        for k in range(now.shape[1]):
            at, F, Q = linearise(rhs, rules.model, at, before[b, k], u_sd[b, k])
            cov = F @ cov @ F.T + Q
            innovation, H, R = measure(output, rules.model, at, now[b, k], measured[b, k], white[b, k], coloured[b, k])
            K, S, _ = gain(cov, innovation, H, R)
            G = np.zeros(K.shape)
            for i in range(ny):
                if not np.isnan(innovation[i]):
                    count[i] += 1.0
                    for j in range(at.size):
                        G[j, i] = K[j, i] * np.sqrt(S[i, i] / cov[j, j])
            mean += G
            square += G**2
            at, cov = correct(rules, at, cov, innovation, H, R, S, G)
    count = np.maximum(count, 1.0)
    return mean / count, np.sqrt(square / count)


def tick(network: GainNetwork, equations: Equations, at: Carried, told: tuple[Array, ...], values: Array) -> Carried:
    """One tick in torch, the numbers of the compiled filter's.

    Args:
        told: (B, nu) of inputs and (B, ny) of outputs, in the channels' units: one tick of what ``told_of`` gives.
        values: (B, nu + ny) standardised readings.
    """
    before, now, u_sd, measured, white, coloured = told
    rhs, output, rules = equations
    (B, n), ny = at.z.shape, measured.shape[1]
    made = np.empty((B, n)), np.empty((B, n, n)), np.empty((B, n, n))
    _prior(rhs, rules, made_of(at.z), before, u_sd, made)
    prior, F, Q = (torch.from_numpy(a) for a in made)
    z = prior + _times(F, at.z - at.z.detach())
    q, r = torch.exp(at.noise[:, :n]), torch.exp(at.noise[:, n:])
    P = F @ at.P @ F.mT + Q * torch.sqrt(q[:, :, None] * q[:, None])
    made = np.empty((B, ny)), np.empty((B, ny, n)), np.empty((B, ny, ny))
    _look(output, rules, made_of(z), now, measured, white, coloured, made)
    missing = torch.from_numpy(np.isnan(made[0]))
    H, R = torch.from_numpy(made[1]), torch.from_numpy(made[2]) * r[:, :, None]
    innovation = torch.from_numpy(np.nan_to_num(made[0])) - _times(H, z - z.detach())
    S = H @ P @ H.mT + R
    read = np.empty((B, width(n, ny, values.shape[1])))
    _seen(rules, values, made[0], made_of(S), made_of(P), read)
    said, noise, h = network(torch.from_numpy(read).to(at.h.dtype), at.h)
    sd, limit = (torch.sqrt(torch.diagonal(part, dim1=1, dim2=2)) for part in (P, S))
    K = torch.where(missing[:, None], 0.0, said * sd[:, :, None] / limit[:, None])
    top = INNOVATION_CLIP_SD * limit
    z = z + _times(K, torch.where(missing, 0.0, torch.clamp(innovation, -top, top)))
    A = torch.eye(n, dtype=torch.float64) - K @ H
    P = A @ P @ A.mT + K @ R @ K.mT
    spread = torch.sqrt(torch.diagonal(P, dim1=1, dim2=2))
    share = torch.clamp(SD_LIMIT * torch.from_numpy(rules.unit) / spread, max=1.0).detach()
    P = P * share[:, :, None] * share[:, None]
    held = made_of(z).copy()
    _held(rules, held)
    return Carried(z + (torch.from_numpy(held) - z.detach()), 0.5 * (P + P.mT), h, noise)


def made_of(tensor: Tensor) -> Array:
    """Its numbers, apart from what they came from.

    Args:
        tensor: of any shape, in any unit.
    """
    return np.ascontiguousarray(tensor.detach().numpy())


def _times(A: Tensor, v: Tensor) -> Tensor:
    return (A @ v[..., None])[..., 0]


class Lessons(NamedTuple):
    """What a gain is learnt from, B sequences of N ticks.

    Attributes:
        machine: whose.
        filled: (B, N, nu + ny) readings after the gate, in the channels' units.
        accepted: (B, N, nu + ny) bool.
        values: (B, N, nu + ny) float32, the same standardised.
        truth: (B, N, J) float32, what is judged, in the units of z.
        judged: (J,) positions of that in z.
    """

    machine: Machine
    filled: Array
    accepted: np.ndarray
    values: np.ndarray
    truth: Array
    judged: np.ndarray


def likelihood(at: Carried, truth: Tensor, judged: np.ndarray, unit: Array) -> tuple[Tensor, Tensor]:
    """Of the truth (B, J), per entry: negative log-likelihood (B,) but for a constant, and squared deviations (B,).

    Args:
        at: what was estimated.
        truth: (B, J) in the units of z.
        judged: (J,) positions of that in z.
        unit: (n,) what each of z is measured by, in its unit.
    """
    scale = torch.from_numpy(unit[judged])
    error = (at.z[:, judged] - truth) / scale
    cov = at.P[:, judged][:, :, judged] / (scale[:, None] * scale) + COV_JITTER * torch.eye(len(judged))
    L = torch.linalg.cholesky(cov)
    whitened = torch.linalg.solve_triangular(L, error[..., None], upper=False)[..., 0]
    log_sd = torch.log(torch.diagonal(L, dim1=1, dim2=2)).mean(dim=1)
    off = whitened.square().mean(dim=1)
    return log_sd + 0.5 * off, off


def fit_gain(
    network: GainNetwork,
    equations: Equations,
    start: Carried,
    lessons: Lessons,
    rng: np.random.Generator,
    schedule: Schedule,
) -> list[float]:
    """Walk some sequences at a time, a stretch in each iteration, from the beginning or anywhere to the end.

    Args:
        start: of as many machines as the schedule's batch, before the first sample.
    """
    batch, ticks = schedule.batch, lessons.filled.shape[1]
    steps = min(BACK_TICKS, ticks - 1)
    sequence, k = rng.integers(len(lessons.filled), size=batch), rng.integers(1, ticks - steps + 1, size=batch)
    carried, lost = start, np.zeros(batch, np.bool_)

    def one(_: int) -> Tensor:
        nonlocal carried, lost
        over = lost | (k + steps > ticks)
        sequence[over], k[over] = rng.integers(len(lessons.filled), size=over.sum()), 1
        fresh = torch.from_numpy(over)
        at = Carried(
            *(
                torch.where(fresh.reshape(-1, *[1] * (old.ndim - 1)), new, old.detach())
                for new, old in zip(start, carried, strict=True)
            )
        )
        rows, span = sequence[:, None], k[:, None] + np.arange(-1, steps)
        told = told_of(lessons.machine, lessons.filled[rows, span], lessons.accepted[rows, span])
        total, count = torch.zeros((), dtype=torch.float64), 1
        for i in range(steps):
            values = lessons.values[sequence, k + i].astype(np.float64)
            at = tick(network, equations, at, tuple(np.ascontiguousarray(part[:, i]) for part in told), values)
            if i % JUDGED_EVERY == JUDGED_EVERY - 1:
                truth = torch.from_numpy(lessons.truth[sequence, k + i]).double()
                said, off = likelihood(at, truth, lessons.judged, equations.rules.unit)
                lost = (off > GIVEN_UP).numpy()
                total = total + said[off <= GIVEN_UP].sum()
                count += int((~lost).sum())
        carried = at
        k[:] += steps
        return total / count

    return adamw(network, one, schedule.iterations, schedule.learning_rate)
