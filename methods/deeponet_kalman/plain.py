"""DeepONet-Kalman written out plainly, one machine at a time: what its compiled form must equal.

The whole window goes through the torch operator at every tick, sensitivities come from automatic differentiation,
and the filter is dense matrices and NumPy's solver. What the safeguards decide, which has tests of its own, is shared.
"""

from __future__ import annotations

import numpy as np
import torch

from twinbench.machines.coordinates import ZETA_SCALE, Array
from twinbench.methods.deeponet_kalman.causes import free_to_return, let_in, moved, note_way, stepped, suppose
from twinbench.methods.deeponet_kalman.cycle import UNKNOWN_S, keep_of
from twinbench.methods.deeponet_kalman.forecast import lagged
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.deeponet_kalman.safeguards import (
    FROZEN,
    INFLATING,
    INFLATION_UPDATES,
    KNOWN,
    LEAST_VARIANCE,
    OUTSIDE,
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
    scale_health,
    trust,
    walk_factor,
    watch,
)
from twinbench.methods.deeponet_kalman.stream import STANDARDISED_LIMIT
from twinbench.methods.deeponet_kalman.tick import LATE, WANDERING
from twinbench.methods.deeponet_kalman.windows import query_of
from twinbench.methods.estimator import (
    FLAG_FROZEN,
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
from twinbench.methods.noise import output_sd
from twinbench.methods.operator import SLOW_TAU_S, Operator, slow_channels
from twinbench.methods.reporting import report
from twinbench.methods.training import load_weights
from twinbench.methods.weighing import log_likelihood


class PlainTwin:
    """One machine, whose every update returns what ``DeepONetKalman.step`` would.

    Args:
        dtype: of the operator. In double precision what differs is the compiled form's round-off alone.

    Attributes:
        rivals: of each cause that is weighed z (N,), P (N, N) and safety, in the units of z.
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
        self.rivals: list[tuple[Array, Array, np.void]] = []
        self.score, self.left = self.model.causes.log_prior.copy(), 0
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
        for to in sorted({*when[~np.isnan(measured)], 1.0}):
            part = to - at if self.ticks > 0 else 0.0
            own, used, own_S, own_nis = self._piece(np.where(when == to, measured, np.nan), away, part)
            there = ~np.isnan(own)
            told = there if to < 1.0 else there | np.isnan(innovation)
            S = np.where(np.outer(there, there) | (np.outer(told, told) & (to == 1.0)), own_S, S)
            innovation, accepted = np.where(there, own, innovation), np.where(there, ~np.isnan(used), accepted)
            nis = np.nansum([nis, own_nis]) if np.isfinite([nis, own_nis]).any() else np.nan
            at = to
        self.left = max(self.left - 1, 0)
        safety = self.safety
        gated = (safety["steps"]["out"] > 0) | (~accepted & ~np.isnan(innovation))
        uninformed = (np.diag(self.P)[self.health] > (KNOWN * m.prior_sd) ** 2).any()
        flags = FLAG_FROZEN * (safety["counts"][FROZEN] > 0) | FLAG_UNINFORMED * uninformed | FLAG_GATED * gated.any()
        age_s = np.empty((1, self.parts.channels))
        return Info(innovation[None], S[None], np.array([nis]), accepted[None], np.array([flags]), age_s)

    def _piece(self, now: Array, away: float, part: float) -> tuple[Array, Array, Array, float]:
        """A part of the tick and the readings (ny,) at its end, alone or as one rival for each cause."""
        if self.left == 0:
            if part > 0.0:
                self._predict(away, part)
            seen = self._foresee(now)
            innovation, H, _, S = seen
            which = -1
            if self.model.settings.steps:
                which = stepped(self.safety["steps"], self.safety["unknown"], innovation, S)
            if which < 0:
                return self._correct(now, seen, True)
            self._begin(which, innovation[which], H[which])
            part = 0.0
        shown, unknown = int(np.argmax(self.score)), self.safety["unknown"]
        told = []
        for k, rival in enumerate(self.rivals):
            self.z, self.P, self.safety = rival
            self.safety["unknown"] = unknown
            if part > 0.0:
                self._predict(away, part)
            seen = self._foresee(now)
            if unknown == 0:
                out, room = self.safety["steps"]["out"], np.empty_like(seen[-1])
                self.score[k] += log_likelihood(seen[0], seen[-1], out, room, np.empty_like(seen[0]))
            told.append(self._correct(now, seen, False))
            self.rivals[k] = self.z, self.P, self.safety
        self.safety = self.rivals[int(np.argmax(self.score))][2].copy()
        weight = np.exp(self.score - self.score.max())
        weight /= weight.sum()
        self.z = np.sum([w * z for w, (z, _, _) in zip(weight, self.rivals, strict=True)], axis=0)
        self.P = np.sum(
            [w * (P + np.outer(z - self.z, z - self.z)) for w, (z, P, _) in zip(weight, self.rivals, strict=True)],
            axis=0,
        )
        return told[shown]

    def _begin(self, which: int, innovation: float, slope: Array) -> None:
        """A copy of the filter for every cause why output ``which`` stepped."""
        m, zeta, entry = self.model, self.parts.zeta, self.model.readings.shifts[which]
        causes, waits, leap = m.causes, m.waits, m.settings.leap
        self.left = max(round(m.settings.weighed_s / m.period_s), 1)
        self.score, self.rivals = causes.log_prior.copy(), []
        for k in range(causes.count):
            z, P, safety = self.z.copy(), self.P.copy(), self.safety.copy()
            if k == causes.back and not moved(waits, safety["steps"]["way"], safety["counts"][UPDATES], z, P, zeta):
                self.score[k] = -np.inf
            safety["counts"][[OUTSIDE, FROZEN, INFLATING]] = 0
            suppose(causes, waits, k, safety["steps"], safety["counts"][UPDATES], z, P, zeta, leap)
            if k == causes.back:
                P[entry, entry] += (innovation / slope[entry]) ** 2
                self._explain_without(z)
            self.rivals.append((z, P, safety))

    def _explain_without(self, z: Array) -> None:
        """What the biases of z (N,) do not explain any more is the machine's: its states move, in place."""
        m, n = self.model, self.parts.states
        less = m.health.to_theta(self.z[self.health]) - m.health.to_theta(z[self.health])
        for gain, source, bias in zip(m.readings.gain, m.readings.source, m.readings.bias, strict=True):
            if bias >= 0:
                z[[source, m.lags.of[source - n]] if source >= n else [source]] += less[bias] / gain

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
        walk = [walk_factor(m.settings, m.memories.push, push) for push in safety["push"]]
        Q[self.health, self.health] = np.diag(np.diag(m.Q)[self.health] * walk)
        Q[error:, error:] *= 1.0 + m.settings.extrapolation * away**2
        self.P = F @ self.P @ F.T + part * Q
        if safety["unknown"] > 0:
            self.P[:n, :n] += part * np.diag((WANDERING * m.increment) ** 2)
        moves[:n] = scaled * m.increment + z[error:]
        moves[noise] = (m.noise_keep - 1.0) * z[noise]
        moves[error:] = (m.error_keep - 1.0) * z[error:]
        self.z = z + part * moves
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

    def _gain(self, innovation: Array, H: Array, R: Array) -> tuple[Array, Array, float]:
        """K (N, ny) with zeros for what is missing, S (ny, ny), NIS."""
        S, K = H @ self.P @ H.T + R, np.zeros(H.T.shape)
        there = np.flatnonzero(~np.isnan(innovation))
        if not len(there):
            return K, S, np.nan
        own = S[np.ix_(there, there)]
        K[:, there] = np.linalg.solve(own, H[there] @ self.P).T
        return K, S, float(innovation[there] @ np.linalg.solve(own, innovation[there]))

    def _foresee(self, measured: Array) -> tuple[Array, Array, Array, Array]:
        """Innovation (ny,), H (ny, N), R (ny, ny) and S (ny, ny) of readings (ny,), before anything is judged."""
        counts, settings = self.safety["counts"], self.model.settings
        if counts[INFLATING] > 0:
            if counts[INFLATING] == INFLATION_UPDATES:
                free_to_return(self.safety["steps"]["way"], self.z, self.P, self.parts.zeta)
            counts[INFLATING] -= 1
            more = np.full(self.parts.health, settings.inflation ** (1.0 / INFLATION_UPDATES))
            scale_health(self.P, self.parts.zeta, more)
        innovation, H, R = self._observe(measured)
        return innovation, H, R, H @ self.P @ H.T + R

    def _correct(
        self, measured: Array, seen: tuple[Array, Array, Array, Array], alone: bool
    ) -> tuple[Array, Array, Array, float]:
        """Eqs. (9)-(14) with readings (ny,) and what ``_foresee`` says of them: innovation, that used, S, NIS."""
        m, safety, counts = self.model, self.safety, self.safety["counts"]
        settings = m.settings
        innovation, H, R, S = seen
        let_in(m.waits, safety["steps"], innovation, S, H, m.readings.shifts, self.P)
        measured = np.where(safety["steps"]["out"] > 0, np.nan, measured)
        innovation = np.where(safety["steps"]["out"] > 0, np.nan, innovation)
        K, S, nis = self._gain(innovation, H, R)
        present = int((~np.isnan(innovation)).sum())
        if alone and settings.rollback and safety["unknown"] == 0 and watch(m.gate, counts, nis, present):
            self.z[self.health] = safety["valid"][0]
            scale_health(self.P, self.parts.zeta, safety["valid"][1] / np.sqrt(np.diag(self.P)[self.health]))
            innovation, H, R = self._observe(measured)
            K, S, nis = self._gain(innovation, H, R)
        used = innovation.copy()
        left_out(settings, counts, used, S)
        if (~np.isnan(used)).sum() < present:
            K, S, nis = self._gain(used, H, R)
        limit = INNOVATION_CLIP_SD * np.sqrt(np.diag(S))
        bounded = np.clip(used, -limit, limit)
        if counts[FROZEN] == 0 and counts[INFLATING] == 0:
            note_mismatch(m.memories.mismatch, safety["mismatch"], bounded, S - R)
        bounded = np.nan_to_num(bounded)
        self._hold_back(K, S, bounded)
        self.z = self.z + K @ bounded
        rest = np.eye(len(K)) - K @ H
        self.P = rest @ self.P @ rest.T + K @ R @ K.T
        self.P = 0.5 * (self.P + self.P.T)
        bound_health(self.P, self.parts.zeta, m.widest, np.empty(len(K)))
        states = slice(0, self.parts.states)
        self.z[states] = np.maximum(self.z[states], m.state_low)
        self.z[self.health] = np.clip(self.z[self.health], m.zeta_low, m.zeta_high)
        self._remember(H, used)
        return innovation, used, S, nis

    def _hold_back(self, K: Array, S: Array, bounded: Array) -> None:
        """Of K, in place, the rows of what is not to be corrected or only along some directions."""
        safety = self.safety
        if safety["unknown"] > 0:
            K[self.model.slow] = 0.0
        elif safety["counts"][FROZEN] > 0:
            K[self.health] = 0.0
        else:
            rows = K[self.health].copy()
            note_push(self.model.memories.push, safety["push"], rows @ bounded, np.diag(rows @ S @ rows.T).copy())
            if self.model.settings.least_information > 0.0:
                K[self.health] = safety["observable"] @ rows

    def _remember(self, H: Array, used: Array) -> None:
        """What the update told about health, and whether its posterior is one to return to."""
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
        note_way(m.waits, safety["steps"]["way"], counts[UPDATES], self.z[self.health])
        counts[UPDATES] += 1
        if counts[OUTSIDE] == 0 and counts[FROZEN] == 0 and counts[INFLATING] == 0:
            safety["valid"][0] = self.z[self.health]
            safety["valid"][1] = np.sqrt(np.diag(self.P)[self.health])
