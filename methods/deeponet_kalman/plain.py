"""DeepONet-Kalman written out plainly, one machine at a time: what its compiled form must equal.

The whole window goes through the torch operator at every tick, sensitivities come from automatic differentiation,
and the filter is dense matrices and NumPy's solver. What the safeguards decide, which has tests of its own, is shared.
"""

from __future__ import annotations

import numpy as np
import torch

from twinbench.data.batch import CHANNEL, SAMPLE_PERIOD_S, STATE, Array
from twinbench.methods.deeponet_kalman.augmented import SHIFTS, SLOW
from twinbench.methods.deeponet_kalman.causes import free_to_return, let_in, moved, note_way, stepped, suppose
from twinbench.methods.deeponet_kalman.cycle import KEEP, N_ASKED, N_CHANNELS, N_INPUTS, UNKNOWN_S
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.deeponet_kalman.model import BIAS, ERROR, FLOW, GAS, NOISE, PROBE, SIZE, ZETA
from twinbench.methods.deeponet_kalman.safeguards import (
    FROZEN,
    INFLATING,
    INFLATION_UPDATES,
    KNOWN,
    LEAST_VARIANCE,
    N_HEALTH,
    N_OUTPUTS,
    OUTSIDE,
    REFRESH,
    UPDATES,
    WIDEST,
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
from twinbench.methods.operator import N_STATES, N_ZETA, SLOW_TAU_S, Operator
from twinbench.methods.probe import probe_lag
from twinbench.methods.reporting import report
from twinbench.methods.training import load_weights
from twinbench.methods.weighing import BACK, LOG_PRIOR, N_CAUSES, log_likelihood
from twinbench.physics.compressor import M_REF_KG_S
from twinbench.physics.health import ZETA_SCALE, theta_and_slope

HEALTH = slice(ZETA, NOISE)


class PlainTwin:
    """One machine, whose every update returns what ``DeepONetKalman.step`` would.

    Args:
        dtype: of the operator. In double precision what differs is the compiled form's round-off alone.

    Attributes:
        rivals: of each cause that is weighed z (19,), P (19, 19) and safety, in the units of z.
    """

    def __init__(self, twin: DeepONetKalman, dtype: torch.dtype = torch.float64) -> None:
        self.dtype = dtype
        self.model, self.front_end, self.scaling = twin.model, twin.front_end, twin.scaling
        self.update_every: int = twin.config["update_every"]
        self.window: int = twin.config["window"]
        self.operator = Operator(window=self.window)
        load_weights(self.operator, twin.arrays)
        self.operator.to(dtype).requires_grad_(False)
        fresh = twin.init(1).memory[0]
        self.z, self.P = fresh["z"][0].copy(), fresh["P"][0].copy()
        self.memory = Memory(*(part[0] for part in self.front_end.init(1)))
        self.safety = fresh["safety"][0].copy()
        self.rivals: list[tuple[Array, Array, np.void]] = []
        self.score, self.left = LOG_PRIOR.copy(), 0
        self.ticks = 0
        self.mask = np.zeros(N_CHANNELS)  # of the last sample, which the window takes in when the next one is there

    def update(self, sample: Sample) -> tuple[State, Info]:
        """One tick of readings (1, 7)."""
        memory, safety, fitted = self.memory, self.safety, self.front_end.fitted
        lag_s = np.zeros(N_CHANNELS) if sample.lag_s is None else sample.lag_s[0]
        accepted, spike, confirmed = (np.zeros(N_CHANNELS, np.bool_) for _ in range(3))
        before = np.empty(N_CHANNELS)
        gate_one(memory, fitted, sample.measured[0], accepted, spike, confirmed, before, np.empty(HAMPEL_WINDOW))
        if self.ticks > 0:
            self.take_in(before, np.maximum(self.mask, confirmed))
        due = self.ticks % self.update_every == 0
        outputs = np.where(accepted[N_INPUTS:] & due, memory.filled[N_INPUTS:], np.nan)
        safety["unknown"] = max(safety["unknown"] - 1, 0)
        if (memory.age_s[:N_ASKED] > UNKNOWN_S).any():
            safety["unknown"] = self.window
        info = self._tick(outputs, lag_s[N_INPUTS:] / SAMPLE_PERIOD_S)
        flags = info.flags | FLAG_SPIKE * spike.any() | FLAG_MISSING * (~accepted & ~spike).any()
        self.mask = accepted.astype(float)
        self.ticks += 1
        state = report(self.z[None], self.P[None], KEEP, ())
        return state, info._replace(flags=flags, age_s=(memory.age_s + lag_s)[None])

    def _query(self, readings: Array) -> Array:
        return (query_of(readings) - self.scaling.mean) / self.scaling.scale

    def take_in(self, readings: Array, mask: Array) -> None:
        """Readings (7,) enter the window, and the whole window goes through the operator.

        Args:
            readings: (7,) in the channels' units, order CHANNELS, gaps filled.
            mask: (7,) dimensionless, 1 where accepted.
        """
        fitted = self.front_end.fitted
        value = np.clip((readings - fitted.mean) / fitted.scale, -STANDARDISED_LIMIT, STANDARDISED_LIMIT)
        temperature, keep = value[CHANNEL.T_dis_K], np.exp(-SAMPLE_PERIOD_S / np.array(SLOW_TAU_S))
        if self.ticks == 1:  # the window was always filled with the first sample
            self.values, self.masks = np.tile(value, (self.window + 1, 1)), np.tile(mask, (self.window, 1))
            self.slow = np.full(len(SLOW_TAU_S), temperature)
        else:
            self.values, self.masks = np.vstack([self.values[1:], value]), np.vstack([self.masks[1:], mask])
            self.slow = keep * self.slow + (1 - keep) * temperature
        query = np.clip(self._query(readings), -STANDARDISED_LIMIT, STANDARDISED_LIMIT)
        window = (self.values, self.masks, temperature - self.slow, query, np.float64(SAMPLE_PERIOD_S))
        self.latent = self.operator.latent(*(torch.as_tensor(part, dtype=self.dtype)[None] for part in window))

    def increments(self) -> tuple[Array, Array]:
        """Scaled increments (5,) and their Jacobian (5, 9) to the heads' condition."""
        m = self.model
        states = (self.z[:N_STATES] - m.state_mean) / m.state_scale
        one = np.concatenate([states, self.z[ZETA : ZETA + N_ZETA] / ZETA_SCALE])
        condition = torch.tensor(np.tile(one, (N_STATES, 1)), dtype=self.dtype, requires_grad=True)
        out = self.operator.heads(self.latent.expand(N_STATES, -1), condition)
        (jacobian,) = torch.autograd.grad(out.diagonal().sum(), condition)  # row i is the gradient of output i
        return out[0].detach().numpy().astype(float), jacobian.numpy().astype(float)

    def _tick(self, outputs: Array, lag: Array) -> Info:
        """Forecast and correct, a piece of the tick at a time where readings are late."""
        safety, m = self.safety, self.model
        away = distance(m.envelope, self._query(self.memory.filled))
        innovation, accepted = np.full(N_OUTPUTS, np.nan), np.zeros(N_OUTPUTS, np.bool_)
        S, nis, at = np.zeros((N_OUTPUTS, N_OUTPUTS)), np.nan, 0.0
        when = np.where(lag > LATE, 1.0 - lag, 1.0)
        outputs = np.where(when >= 0.0, outputs, np.nan)  # older than the last tick
        for to in sorted({*when[~np.isnan(outputs)], 1.0}):
            part = to - at if self.ticks > 0 else 0.0
            own, used, own_S, own_nis = self._piece(np.where(when == to, outputs, np.nan), away, part)
            there = ~np.isnan(own)
            told = there if to < 1.0 else there | np.isnan(innovation)
            S = np.where(np.outer(there, there) | (np.outer(told, told) & (to == 1.0)), own_S, S)
            innovation, accepted = np.where(there, own, innovation), np.where(there, ~np.isnan(used), accepted)
            nis = np.nansum([nis, own_nis]) if np.isfinite([nis, own_nis]).any() else np.nan
            at = to
        self.left = max(self.left - 1, 0)
        safety = self.safety
        gated = (safety["steps"]["out"] > 0) | (~accepted & ~np.isnan(innovation))
        uninformed = (np.diag(self.P)[HEALTH] > (KNOWN * m.prior_sd) ** 2).any()
        flags = FLAG_FROZEN * (safety["counts"][FROZEN] > 0) | FLAG_UNINFORMED * uninformed | FLAG_GATED * gated.any()
        return Info(innovation[None], S[None], np.array([nis]), accepted[None], np.array([flags]), np.empty((1, 7)))

    def _piece(self, now: Array, away: float, part: float) -> tuple[Array, Array, Array, float]:
        """A part of the tick and the readings (3,) at its end, alone or as one rival for each cause."""
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
                out = self.safety["steps"]["out"]
                self.score[k] += log_likelihood(seen[0], seen[-1], out, np.empty((3, 3)), np.empty(3))
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
        settings = self.model.settings
        self.left = max(round(settings.weighed_s / SAMPLE_PERIOD_S), 1)
        self.score, self.rivals = LOG_PRIOR.copy(), []
        for k in range(N_CAUSES):
            z, P, safety = self.z.copy(), self.P.copy(), self.safety.copy()
            if k == BACK and not moved(safety["steps"]["way"], safety["counts"][UPDATES], z, P, ZETA):
                self.score[k] = -np.inf
            safety["counts"][[OUTSIDE, FROZEN, INFLATING]] = 0
            suppose(k, safety["steps"], safety["counts"][UPDATES], z, P, ZETA, settings.leap)
            if k == BACK:
                P[SHIFTS[which], SHIFTS[which]] += (innovation / slope[SHIFTS[which]]) ** 2
                z[[GAS, PROBE]] += theta_and_slope(self.z[HEALTH])[0][-1] - theta_and_slope(z[HEALTH])[0][-1]
            self.rivals.append((z, P, safety))

    def _predict(self, away: float, part: float) -> None:
        """Eqs. (6) and (7) over a part of the tick."""
        m, safety, z = self.model, self.safety, self.z
        scaled, jacobian = self.increments()
        share, slope = probe_lag(z[FLOW])
        D = np.zeros((SIZE, SIZE))  # of what z moves by
        D[:N_STATES, :N_STATES] = m.increment[:, None] * jacobian[:, :N_STATES] / m.state_scale
        D[:N_STATES, ZETA : ZETA + N_ZETA] = (
            trust(m.settings, away) * m.increment[:, None] * jacobian[:, N_STATES:] / ZETA_SCALE
        )
        D[:N_STATES, ERROR:] = np.eye(N_STATES)
        D[PROBE, [GAS, FLOW, PROBE]] = share, slope * (z[GAS] - z[PROBE]), -share
        D[NOISE:ERROR, NOISE:ERROR] = np.diag(m.noise_keep - 1.0)
        D[ERROR:, ERROR:] = (m.error_keep - 1.0) * np.eye(N_STATES)
        F = np.eye(SIZE) + part * D
        Q = m.Q.copy()
        walk = [walk_factor(m.settings, push) for push in safety["push"]]
        Q[HEALTH, HEALTH] = np.diag(np.diag(m.Q)[HEALTH] * walk)
        Q[ERROR:, ERROR:] *= 1.0 + m.settings.extrapolation * away**2
        self.P = F @ self.P @ F.T + part * Q
        if safety["unknown"] > 0:
            self.P[:N_STATES, :N_STATES] += part * np.diag((WANDERING * m.increment) ** 2)
        moved = np.zeros(SIZE)
        moved[:N_STATES] = scaled * m.increment + z[ERROR:]
        moved[PROBE] = share * (z[GAS] - z[PROBE])
        moved[NOISE:ERROR] = (m.noise_keep - 1.0) * z[NOISE:ERROR]
        moved[ERROR:] = (m.error_keep - 1.0) * z[ERROR:]
        self.z = z + part * moved
        if m.settings.least_information > 0.0:
            carry_sensitivity(safety["sensitivity"], F, ZETA, np.empty_like(safety["sensitivity"]))

    def _observe(self, measured: Array) -> tuple[Array, Array, Array]:
        """Innovation (3,), H (3, 19) and R (3, 3), which Eq. (13) widens."""
        m, safety, z = self.model, self.safety, self.z
        white, coloured = (part[0] for part in output_sd(self.memory.filled[None]))
        bias_K, slope = (part[-1] for part in theta_and_slope(z[HEALTH]))
        H = np.zeros((N_OUTPUTS, SIZE))
        H[0, STATE.p_exh_bar] = H[1, PROBE] = 1.0
        H[1, BIAS], H[2, FLOW] = slope, M_REF_KG_S
        H[:, NOISE:ERROR] = np.diag(coloured)
        R = np.maximum(white**2, LEAST_VARIANCE)
        updates = safety["counts"][UPDATES]
        R *= [noise_factor(m.settings, safety["mismatch"], R[c], updates, c) for c in range(N_OUTPUTS)]
        expected = np.array([z[STATE.p_exh_bar], z[PROBE] + bias_K, M_REF_KG_S * z[FLOW]]) + coloured * z[NOISE:ERROR]
        return measured - expected, H, np.diag(R)

    def _gain(self, innovation: Array, H: Array, R: Array) -> tuple[Array, Array, float]:
        """K (19, 3) with zeros for what is missing, S (3, 3), NIS."""
        S, K = H @ self.P @ H.T + R, np.zeros((SIZE, N_OUTPUTS))
        there = np.flatnonzero(~np.isnan(innovation))
        if not len(there):
            return K, S, np.nan
        own = S[np.ix_(there, there)]
        K[:, there] = np.linalg.solve(own, H[there] @ self.P).T
        return K, S, float(innovation[there] @ np.linalg.solve(own, innovation[there]))

    def _foresee(self, measured: Array) -> tuple[Array, Array, Array, Array]:
        """Innovation (3,), H (3, 19), R (3, 3) and S (3, 3) of readings (3,), before anything is judged."""
        counts, settings = self.safety["counts"], self.model.settings
        if counts[INFLATING] > 0:
            if counts[INFLATING] == INFLATION_UPDATES:
                free_to_return(self.safety["steps"]["way"], self.z, self.P, ZETA)
            counts[INFLATING] -= 1
            scale_health(self.P, ZETA, np.full(N_HEALTH, settings.inflation ** (1.0 / INFLATION_UPDATES)))
        innovation, H, R = self._observe(measured)
        return innovation, H, R, H @ self.P @ H.T + R

    def _correct(
        self, measured: Array, seen: tuple[Array, Array, Array, Array], alone: bool
    ) -> tuple[Array, Array, Array, float]:
        """Eqs. (9)-(14) with readings (3,) and what ``_foresee`` says of them: innovation, that used, S, NIS."""
        m, safety, counts = self.model, self.safety, self.safety["counts"]
        settings = m.settings
        innovation, H, R, S = seen
        let_in(safety["steps"], innovation, S, H, np.array(SHIFTS), self.P)
        measured = np.where(safety["steps"]["out"] > 0, np.nan, measured)
        innovation = np.where(safety["steps"]["out"] > 0, np.nan, innovation)
        K, S, nis = self._gain(innovation, H, R)
        present = int((~np.isnan(innovation)).sum())
        if alone and settings.rollback and safety["unknown"] == 0 and watch(counts, nis, present):
            self.z[HEALTH] = safety["valid"][0]
            scale_health(self.P, ZETA, safety["valid"][1] / np.sqrt(np.diag(self.P)[HEALTH]))
            innovation, H, R = self._observe(measured)
            K, S, nis = self._gain(innovation, H, R)
        used = innovation.copy()
        left_out(settings, counts, used, S)
        if (~np.isnan(used)).sum() < present:
            K, S, nis = self._gain(used, H, R)
        limit = INNOVATION_CLIP_SD * np.sqrt(np.diag(S))
        bounded = np.clip(used, -limit, limit)
        if counts[FROZEN] == 0 and counts[INFLATING] == 0:
            note_mismatch(safety["mismatch"], bounded, S - R)
        bounded = np.nan_to_num(bounded)
        self._hold_back(K, S, bounded)
        self.z = self.z + K @ bounded
        rest = np.eye(SIZE) - K @ H
        self.P = rest @ self.P @ rest.T + K @ R @ K.T
        self.P = 0.5 * (self.P + self.P.T)
        bound_health(self.P, ZETA, WIDEST, np.empty(SIZE))
        self.z[FLOW] = max(self.z[FLOW], 0.05)
        self.z[HEALTH] = np.clip(self.z[HEALTH], m.zeta_low, m.zeta_high)
        self._remember(H, used)
        return innovation, used, S, nis

    def _hold_back(self, K: Array, S: Array, bounded: Array) -> None:
        """Of K, in place, the rows of what is not to be corrected or only along some directions."""
        safety = self.safety
        if safety["unknown"] > 0:
            K[list(SLOW)] = 0.0
        elif safety["counts"][FROZEN] > 0:
            K[HEALTH] = 0.0
        else:
            rows = K[HEALTH].copy()
            note_push(safety["push"], rows @ bounded, np.diag(rows @ S @ rows.T).copy())
            if self.model.settings.least_information > 0.0:
                K[HEALTH] = safety["observable"] @ rows

    def _remember(self, H: Array, used: Array) -> None:
        """What the update told about health, and whether its posterior is one to return to."""
        safety, counts, settings = self.safety, self.safety["counts"], self.model.settings
        if settings.least_information > 0.0:
            white, coloured = (part[0] for part in output_sd(self.memory.filled[None]))
            keep = self.model.noise_keep
            accuracy = white**2 + coloured**2 * (1.0 + keep) / (1.0 - keep)
            gather(safety["information"], safety["sensitivity"], H, ZETA, accuracy, used, np.empty(N_HEALTH))
            if counts[UPDATES] % REFRESH == 0:
                room = np.empty((N_HEALTH, 2 * N_HEALTH), complex)
                informed(safety["information"], settings.least_information, safety["observable"], room)
        note_way(safety["steps"]["way"], counts[UPDATES], self.z[HEALTH])
        counts[UPDATES] += 1
        if counts[OUTSIDE] == 0 and counts[FROZEN] == 0 and counts[INFLATING] == 0:
            safety["valid"][0] = self.z[HEALTH]
            safety["valid"][1] = np.sqrt(np.diag(self.P)[HEALTH])
