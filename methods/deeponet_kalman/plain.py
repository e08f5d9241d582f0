"""DeepONet-Kalman written out plainly, one machine at a time: what its compiled form must equal.

The whole window goes through the torch operator at every tick, sensitivities come from automatic differentiation,
and the filter is dense matrices and NumPy's solver. What the safeguards decide, which has tests of its own, is shared.
"""

from __future__ import annotations

import numpy as np
import torch

from twinbench.machines.coordinates import ZETA_SCALE, Array
from twinbench.methods.deeponet_kalman.cycle import UNKNOWN_S, keep_of
from twinbench.methods.deeponet_kalman.forecast import lagged
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.deeponet_kalman.safeguards import (
    KNOWN,
    LEAST_VARIANCE,
    REFRESH,
    UPDATES,
    bound_health,
    carry_sensitivity,
    distance,
    gather,
    informed,
    left_out,
    noise_factor,
    note_mismatch,
    note_push,
    trust,
    walk_factor,
)
from twinbench.methods.deeponet_kalman.stream import STANDARDISED_LIMIT
from twinbench.methods.deeponet_kalman.tick import LATE, WANDERING
from twinbench.methods.deeponet_kalman.windows import query_of
from twinbench.methods.estimator import (
    FLAG_GATED,
    FLAG_MISSING,
    FLAG_SPIKE,
    FLAG_UNINFORMED,
    Info,
    Sample,
    State,
)
from twinbench.methods.frontend import HAMPEL_WINDOW, Memory, gate_one
from twinbench.methods.kalman import INNOVATION_CLIP_SD
from twinbench.methods.mixing import FAILS_FROM, Failing, log_likelihood
from twinbench.methods.noise import output_sd
from twinbench.methods.operator import SLOW_TAU_S, Operator, slow_channels
from twinbench.methods.reporting import report
from twinbench.methods.training import load_weights


class PlainTwin:
    """One machine, whose every update returns what ``DeepONetKalman.step`` would.

    Args:
        dtype: of the operator. In double precision what differs is the compiled form's round-off alone.

    Attributes:
        z: (N,) mean of the modes' mixture, in the units of z.
        P: (N, N) its covariance, in those units squared.
        mu: (M,) dimensionless probabilities of the modes.
        zs: (M, N) their means.
        Ps: (M, N, N) their covariances.
        stays: (M,) dimensionless probabilities that they go on from the tick before.
        offset: (M, 2) by how much the output that fails reads too high, in its unit, and the variance of that.
    """

    def __init__(self, twin: DeepONetKalman, dtype: torch.dtype = torch.float64) -> None:
        self.dtype, self.machine, self.parts = dtype, twin.machine, twin.parts
        self.health = slice(self.parts.zeta, self.parts.noise)
        self.model, self.front_end, self.scaling = twin.model, twin.front_end, twin.scaling
        self.update_every: int = twin.config["update_every"]
        self.window: int = twin.config["window"]
        self.operator = Operator(twin.machine, window=self.window)
        load_weights(self.operator, twin.arrays)
        self.operator.to(dtype).requires_grad_(False)
        fresh = twin.init(1).memory[0]
        self.z, self.P = fresh["z"][0].copy(), fresh["P"][0].copy()
        self.memory = Memory(*(part[0] for part in self.front_end.init(1)))
        self.safety = fresh["safety"][0].copy()
        modes = (fresh["modes"][name][0].copy() for name in ("mu", "stays", "z", "P", "offset"))
        self.mu, self.stays, self.zs, self.Ps, self.offset = modes
        self.ticks = 0
        self.mask = np.zeros(self.parts.channels)  # of the last sample, which the window takes in with the next one

    def update(self, sample: Sample) -> tuple[State, Info]:
        """One tick of readings (1, C)."""
        memory, safety, fitted = self.memory, self.safety, self.front_end.fitted
        channels, inputs = self.parts.channels, self.parts.inputs
        lag_s = np.zeros(channels) if sample.lag_s is None else sample.lag_s[0]
        accepted, spike, confirmed = (np.zeros(channels, np.bool_) for _ in range(3))
        before = np.empty(channels)
        gate_one(memory, fitted, sample.measured[0], accepted, spike, confirmed, before, np.empty(HAMPEL_WINDOW))
        if self.ticks > 0:
            self.take_in(before, np.maximum(self.mask, confirmed))
        due = self.ticks % self.update_every == 0
        outputs = np.where(accepted[inputs:] & due, memory.filled[inputs:], np.nan)
        safety["unknown"] = max(safety["unknown"] - 1, 0)
        if (memory.age_s[self.scaling.asked] > UNKNOWN_S).any():
            safety["unknown"] = self.window
        info = self._tick(outputs, lag_s[inputs:] / self.model.period_s)
        flags = info.flags | FLAG_SPIKE * spike.any() | FLAG_MISSING * (~accepted & ~spike).any()
        self.mask = accepted.astype(float)
        self.ticks += 1
        state = report(self.model.health, self.z[None], self.P[None], keep_of(self.parts), ())
        return state, info._replace(flags=flags, age_s=(memory.age_s + lag_s)[None])

    def _query(self, readings: Array) -> Array:
        return (query_of(self.machine, readings) - self.scaling.mean) / self.scaling.scale

    def take_in(self, readings: Array, mask: Array) -> None:
        """Readings (C,) enter the window, and the whole window goes through the operator.

        Args:
            readings: (C,) in the channels' units, inputs first, gaps filled.
            mask: (C,) dimensionless, 1 where accepted.
        """
        fitted = self.front_end.fitted
        value = np.clip((readings - fitted.mean) / fitted.scale, -STANDARDISED_LIMIT, STANDARDISED_LIMIT)
        slow = value[slow_channels(self.machine)]
        keep = np.tile(np.exp(-self.model.period_s / np.array(SLOW_TAU_S)), len(slow) // len(SLOW_TAU_S))
        if self.ticks == 1:  # the window was always filled with the first sample
            self.values, self.masks = np.tile(value, (self.window + 1, 1)), np.tile(mask, (self.window, 1))
            self.slow = slow
        else:
            self.values, self.masks = np.vstack([self.values[1:], value]), np.vstack([self.masks[1:], mask])
            self.slow = keep * self.slow + (1 - keep) * slow
        query = np.clip(self._query(readings), -STANDARDISED_LIMIT, STANDARDISED_LIMIT)
        window = (self.values, self.masks, slow - self.slow, query, np.float64(self.model.period_s))
        self.latent = self.operator.latent(*(torch.as_tensor(part, dtype=self.dtype)[None] for part in window))

    def increments(self) -> tuple[Array, Array]:
        """Scaled increments (n,) and their Jacobian (n, n + na) to the heads' condition."""
        m, n = self.model, self.parts.states
        states = (self.z[:n] - m.state_mean) / m.state_scale
        one = np.concatenate([states, self.z[self.health][m.acting] / ZETA_SCALE])
        condition = torch.tensor(np.tile(one, (n, 1)), dtype=self.dtype, requires_grad=True)
        out = self.operator.heads(self.latent.expand(n, -1), condition)
        (jacobian,) = torch.autograd.grad(out.diagonal().sum(), condition)  # row i is the gradient of output i
        return out[0].detach().numpy().astype(float), jacobian.numpy().astype(float)

    def _tick(self, measured: Array, lag: Array) -> Info:
        """Forecast and correct, a piece of the tick at a time where readings are late."""
        m, outputs = self.model, self.parts.outputs
        away = distance(m.envelope, self._query(self.memory.filled))
        innovation, accepted = np.full(outputs, np.nan), np.zeros(outputs, np.bool_)
        S, nis, at = np.zeros((outputs, outputs)), np.nan, 0.0
        when = np.where(lag > LATE, 1.0 - lag, 1.0)
        measured = np.where(when >= 0.0, measured, np.nan)  # older than the last tick
        if self.ticks > 0:
            self._mix()
        for to in sorted({*when[~np.isnan(measured)], 1.0}):
            if self.ticks > 0 and to > at:
                self._predict(away, to - at)
            own, used, own_S, own_nis = self._correct(np.where(when == to, measured, np.nan))
            there = ~np.isnan(own)
            told = there if to < 1.0 else there | np.isnan(innovation)
            S = np.where(np.outer(there, there) | (np.outer(told, told) & (to == 1.0)), own_S, S)
            innovation, accepted = np.where(there, own, innovation), np.where(there, ~np.isnan(used), accepted)
            nis = np.nansum([nis, own_nis]) if np.isfinite([nis, own_nis]).any() else np.nan
            at = to
        gated = (self.mu @ m.modes.out > FAILS_FROM) | (~accepted & ~np.isnan(innovation))
        uninformed = (np.diag(self.P)[self.health] > (KNOWN * m.prior_sd) ** 2).any()
        flags = FLAG_UNINFORMED * uninformed | FLAG_GATED * gated.any()
        age_s = np.empty((1, self.parts.channels))
        return Info(innovation[None], S[None], np.array([nis]), accepted[None], np.array([flags]), age_s)

    def _mix(self) -> None:
        """Each mode starts from a mixture of all."""
        joint = self.mu[:, None] * self.model.modes.turn
        self.mu = joint.sum(axis=0)
        self.stays = np.diagonal(joint) / self.mu
        mixtures = [self._merged(weight) for weight in (joint / self.mu).T]
        self.zs, self.Ps = (np.array(part) for part in zip(*mixtures, strict=True))

    def _merged(self, weight: Array) -> tuple[Array, Array]:
        """Mean (N,) and covariance (N, N) of the modes, each with its weight (M,)."""
        mean = weight @ self.zs
        off = self.zs - mean
        return mean, np.einsum("k,kij->ij", weight, self.Ps + off[:, :, None] * off[:, None, :])

    def _predict(self, away: float, part: float) -> None:
        """Eqs. (6) and (7) over a part of the tick."""
        m, safety, z = self.model, self.safety, self.z
        scaled, jacobian = self.increments()
        size, n, zeta, error = self.parts.size, self.parts.states, self.parts.zeta, self.parts.error
        noise = slice(self.parts.noise, error)
        D, moves = np.zeros((size, size)), np.zeros(size)  # what z moves by, and its Jacobian
        D[:n, :n] = m.increment[:, None] * jacobian[:, :n] / m.state_scale
        D[:n, zeta + m.acting] = trust(m.settings, away) * m.increment[:, None] * jacobian[:, n:] / ZETA_SCALE
        D[:n, error:] = np.eye(n)
        for k, (of, by) in enumerate(zip(m.lags.of, m.lags.by, strict=True)):
            share, slope = lagged(m.lags, z, k)
            gap = z[of] - z[n + k]
            D[n + k, n + k] = -share
            D[n + k, of] += share
            D[n + k, by] += slope * gap  # no slope where nothing quickens it
            moves[n + k] = share * gap
        D[noise, noise] = np.diag(m.noise_keep - 1.0)
        D[error:, error:] = (m.error_keep - 1.0) * np.eye(n)
        F = np.eye(size) + part * D
        Q = m.Q.copy()
        Q[error:, error:] *= 1.0 + m.settings.extrapolation * away**2
        if safety["unknown"] > 0:
            Q[:n, :n] += np.diag((WANDERING * m.increment) ** 2)
        moves[:n] = scaled * m.increment + z[error:]
        moves[noise] = (m.noise_keep - 1.0) * z[noise]
        moves[error:] = (m.error_keep - 1.0) * z[error:]
        self.zs = z + part * moves + (self.zs - z) @ F.T
        self.z = z + part * moves
        factor = np.array([walk_factor(m.settings, m.memories.push, push) for push in safety["push"]])
        for k, walk in enumerate(m.modes.walk):
            own = Q.copy()
            own[self.health, self.health] += np.diag(walk * factor)
            self.Ps[k] = F @ self.Ps[k] @ F.T + part * own
        _, self.P = self._merged(self.mu)
        if m.settings.least_information > 0.0:
            carry_sensitivity(safety["sensitivity"], F, zeta, np.empty_like(safety["sensitivity"]))

    def _observe(self, measured: Array) -> tuple[Array, Array, Array]:
        """Innovation (ny,), H (ny, N) and R (ny, ny), which Eq. (13) widens."""
        m, safety, z = self.model, self.safety, self.z
        outputs, noise = self.parts.outputs, slice(self.parts.noise, self.parts.error)
        white, coloured = (part[0] for part in output_sd(m.sheet, self.memory.filled[None]))
        theta, slope = m.health.theta_and_slope(z[self.health])
        H = np.zeros((outputs, self.parts.size))
        H[range(outputs), m.readings.source] = m.readings.gain
        H[:, noise] = np.diag(coloured)
        expected = m.readings.gain * z[m.readings.source] + coloured * z[noise]
        for c in np.flatnonzero(m.readings.bias >= 0):
            bias = m.readings.bias[c]
            H[c, self.parts.zeta + bias] = slope[bias]
            expected[c] += theta[bias]
        R = np.maximum(white**2, LEAST_VARIANCE)
        updates = safety["counts"][UPDATES]
        keep, mismatch = m.memories.mismatch, safety["mismatch"]
        R *= [noise_factor(m.settings, keep, mismatch, R[c], updates, c) for c in range(outputs)]
        return measured - expected, H, np.diag(R)

    def _correct(self, measured: Array) -> tuple[Array, Array, Array, float]:
        """Eqs. (8)-(13) with readings (ny,), mode by mode: the mixture's innovation, that used, S, NIS."""
        m, safety, centre = self.model, self.safety, self.z
        innovation, H, R = self._observe(measured)
        S = H @ self.P @ H.T + R
        used = innovation.copy()
        left_out(m.settings, safety["counts"], used, S)
        bounded = _bounded(used, S)
        note_mismatch(m.memories.mismatch, safety["mismatch"], bounded, S - R)
        if safety["unknown"] == 0:
            rows = _gain(self.P, used, H, S)[self.health]
            pushes = rows @ np.nan_to_num(bounded)
            note_push(m.memories.push, safety["push"], pushes, np.diag(rows @ S @ rows.T).copy())
        noise_var = np.diagonal(R) + np.diagonal(H[:, self.parts.noise : self.parts.error]) ** 2
        score = np.zeros(len(self.mu))
        for k, out in enumerate(m.modes.out):
            own, own_S = used - H @ (self.zs[k] - centre), H @ self.Ps[k] @ H.T + R
            if safety["unknown"] == 0:
                failing = Failing(self.offset[k], noise_var, m.modes.wander)
                stays, room = m.modes.lasts[k] * self.stays[k], (np.empty_like(own_S), np.empty_like(own))
                score[k] = log_likelihood(own, own_S, out, stays, failing, *room)
            self._correct_one(k, np.where(out > 0, np.nan, own), H, R, own_S)
        self.mu = self.mu * np.exp(score - score.max())
        self.mu /= self.mu.sum()
        self.z, self.P = self._merged(self.mu)
        used = np.where(self.mu @ m.modes.out > FAILS_FROM, np.nan, used)
        self._remember(H, used)
        there = np.flatnonzero(~np.isnan(used))
        own = S[np.ix_(there, there)]
        nis = float(used[there] @ np.linalg.solve(own, used[there])) if len(there) else np.nan
        return innovation, used, S, nis

    def _correct_one(self, k: int, innovation: Array, H: Array, R: Array, S: Array) -> None:
        """Mode k, with its own innovation (ny,) and S (ny, ny)."""
        m, P = self.model, self.Ps[k]
        K = _gain(P, innovation, H, S)
        if self.safety["unknown"] > 0:
            K[m.slow] = 0.0
        elif m.settings.least_information > 0.0:
            K[self.health] = self.safety["observable"] @ K[self.health]
        z, rest = self.zs[k] + K @ np.nan_to_num(_bounded(innovation, S)), np.eye(len(K)) - K @ H
        P = rest @ P @ rest.T + K @ R @ K.T
        P = 0.5 * (P + P.T)
        bound_health(P, self.parts.zeta, m.widest, np.empty(len(K)))
        states = slice(0, self.parts.states)
        z[states] = np.maximum(z[states], m.state_low)
        z[self.health] = np.clip(z[self.health], m.zeta_low, m.zeta_high)
        self.zs[k], self.Ps[k] = z, P

    def _remember(self, H: Array, used: Array) -> None:
        """What the outputs that were used (ny,) told about health."""
        safety, counts, m = self.safety, self.safety["counts"], self.model
        least, zeta = m.settings.least_information, self.parts.zeta
        if least > 0.0:
            white, coloured = (part[0] for part in output_sd(m.sheet, self.memory.filled[None]))
            accuracy = white**2 + coloured**2 * (1.0 + m.noise_keep) / (1.0 - m.noise_keep)
            keep, row = m.memories.observed, np.empty(self.parts.health)
            gather(keep, safety["information"], safety["sensitivity"], H, zeta, accuracy, used, row)
            if counts[UPDATES] % REFRESH == 0:
                room = np.empty((self.parts.health, 2 * self.parts.health), complex)
                informed(safety["information"], least, safety["observable"], room)
        counts[UPDATES] += 1


def _gain(P: Array, innovation: Array, H: Array, S: Array) -> Array:
    """K (N, ny) of P (N, N), with zeros for the innovations (ny,) that are missing."""
    K, there = np.zeros(H.T.shape), np.flatnonzero(~np.isnan(innovation))
    if len(there):
        K[:, there] = np.linalg.solve(S[np.ix_(there, there)], H[there] @ P).T
    return K


def _bounded(innovation: Array, S: Array) -> Array:
    """Innovations (ny,) within the bound; NaN where missing."""
    limit = INNOVATION_CLIP_SD * np.sqrt(np.diag(S))
    return np.clip(innovation, -limit, limit)
