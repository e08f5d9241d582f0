"""The augmented extended Kalman filter, Eqs. (6)-(14), with the operator as its model.

z = [five states, probe temperature, five health coordinates zeta, three coloured-noise states,
five slow errors of the operator].
Health is a random walk in zeta; the probe is an exact first-order lag; the coloured part of the
sensor noise is AR(1) of unit variance, scaled by its present standard deviation. What the operator
gets wrong is wrong for minutes, since it depends on the operating point: white process noise cannot
say that, and a filter without these states is far too sure of itself. The operator gives the
forecast and, in the same pass, its Jacobian.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from data.batch import SAMPLE_PERIOD_S, Array
from methods.estimator import FLAG_FROZEN, FLAG_GATED, FLAG_UNINFORMED
from methods.kalman import bounded, gain, joseph, predict_covariance
from methods.safeguards import (
    FROZEN,
    INFLATING,
    INFLATION_UPDATES,
    N_HEALTH,
    N_OUTPUTS,
    OUTSIDE,
    REFRESH,
    UPDATES,
    WIDEST,
    Envelope,
    Safety,
    Settings,
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
from methods.stream import N_STATES, N_ZETA, ZETA_SCALE, fill, heads, heads_with_differences, heads_with_jacobian, push
from physics.compressor import M_REF_KG_S, PLANT
from physics.health import map_health

PROBE, ZETA, NOISE, ERROR, SIZE = 5, 6, 11, 14, 19
BIAS = ZETA + 4
LATE = 0.5
"""Of a tick: what was read no longer ago than this counts as read at the tick."""
TAU_PROBE_S = float(PLANT.theta()[PLANT.index("tau_T_s")])
TAU_PROBE_X = float(PLANT.theta()[PLANT.index("tau_T_x")])


class Model(NamedTuple):
    """What the filter needs besides the operator's weights."""

    state_mean: Array  # (5,)
    state_scale: Array  # (5,)
    increment: Array  # (5,)
    Q: Array  # (19, 19) process noise of one tick
    noise_keep: Array  # (3,) AR(1) factors of the coloured sensor noise
    error_keep: float  # AR(1) factor of the operator's slow errors
    zeta_low: Array  # (5,) bounds of the coordinates, far outside a machine's life
    zeta_high: Array  # (5,)
    settings: Settings
    envelope: Envelope


@njit(cache=True, error_model="numpy")
def probe_lag(mu):  # type: ignore[no-untyped-def]
    """Share of the gap to the gas that the probe closes in a tick, and its slope to the flow."""
    mu = max(mu, 0.05)
    tau = TAU_PROBE_S * mu**-TAU_PROBE_X
    keep = np.exp(-SAMPLE_PERIOD_S / tau)
    return 1.0 - keep, keep * SAMPLE_PERIOD_S / tau * TAU_PROBE_X / mu


@njit(cache=True, error_model="numpy")
def _condition(model, z):  # type: ignore[no-untyped-def]
    condition = np.empty(N_STATES + N_ZETA, np.float32)
    for i in range(N_STATES):
        condition[i] = (z[i] - model.state_mean[i]) / model.state_scale[i]
    for i in range(N_ZETA):
        condition[N_STATES + i] = z[ZETA + i] / ZETA_SCALE
    return condition


@njit(cache=True, error_model="numpy")
def _moved(model, z, scaled):  # type: ignore[no-untyped-def]
    """Eq. (6): states by the operator, probe by its lag, noise and slow error by their memory."""
    after = z.copy()
    share, _ = probe_lag(z[4])
    after[PROBE] = z[PROBE] + share * (z[2] - z[PROBE])
    for i in range(N_STATES):
        after[i] = z[i] + scaled[i] * model.increment[i] + z[ERROR + i]
        after[ERROR + i] = model.error_keep * z[ERROR + i]
    for i in range(3):
        after[NOISE + i] = model.noise_keep[i] * z[NOISE + i]
    return after


@njit(cache=True, error_model="numpy")
def predict(w, model, base, z, P, away, push, part):  # type: ignore[no-untyped-def]
    """One tick ahead, Eqs. (6) and (7): z (19,), P (19, 19) and the Jacobian F (19, 19).

    Args:
        away: distance of the query from the training envelope.
        push: (5,) direction of late corrections, which widens the walk of health by Eq. (14).
        part: of the tick, 1 for all of it; less goes along the straight line there.
    """
    settings = model.settings
    if settings.difference > 0.0:
        scaled, jacobian = heads_with_differences(w, base, _condition(model, z), settings.difference)
    else:
        scaled, jacobian = heads_with_jacobian(w, base, _condition(model, z))
    trusted = trust(settings, away)
    F = np.eye(SIZE)
    for i in range(N_STATES):
        for j in range(N_STATES):
            F[i, j] += jacobian[i, j] * model.increment[i] / model.state_scale[j]
        for j in range(N_ZETA):
            F[i, ZETA + j] = trusted * jacobian[i, N_STATES + j] * model.increment[i] / ZETA_SCALE
        F[i, ERROR + i] = 1.0
        F[ERROR + i, ERROR + i] = model.error_keep
    share, slope = probe_lag(z[4])
    F[PROBE, PROBE] = 1.0 - share
    F[PROBE, 2] = share
    F[PROBE, 4] = slope * (z[2] - z[PROBE])
    for i in range(3):
        F[NOISE + i, NOISE + i] = model.noise_keep[i]
    Q = model.Q.copy()
    for i in range(N_HEALTH):
        Q[ZETA + i, ZETA + i] *= walk_factor(settings, push[i])
    for i in range(N_STATES):
        Q[ERROR + i, ERROR + i] *= 1.0 + settings.extrapolation * away * away
    after = _moved(model, z, scaled)
    if part < 1.0:
        after = z + part * (after - z)
        F = np.eye(SIZE) + part * (F - np.eye(SIZE))
        Q *= part
    return after, predict_covariance(P, F, Q), F


@njit(cache=True, error_model="numpy")
def predict_mean(w, model, base, z):  # type: ignore[no-untyped-def]
    """The forecast of ``predict`` alone, for open loop."""
    return _moved(model, z, heads(w, base, _condition(model, z)))


@njit(cache=True, error_model="numpy")
def readings(z, bias_K):  # type: ignore[no-untyped-def]
    """Noise-free readings (3,), order OUTPUTS."""
    return np.array([z[1], z[PROBE] + bias_K, M_REF_KG_S * z[4]])


@njit(cache=True, error_model="numpy")
def _observe(model, safety, z, measured, white_sd, coloured_sd):  # type: ignore[no-untyped-def]
    """Innovation (3,), NaN where missing, H (3, 19), and R (3, 3): the data sheet's, widened by Eq. (13)."""
    theta, slope = np.empty((1, N_HEALTH)), np.empty((1, N_HEALTH))
    map_health(z[ZETA:NOISE].copy().reshape(1, N_HEALTH), theta, slope)
    H = np.zeros((N_OUTPUTS, SIZE))
    H[0, 1] = 1.0
    H[1, PROBE] = 1.0
    H[1, BIAS] = slope[0, 4]
    H[2, 4] = M_REF_KG_S
    R = np.zeros((N_OUTPUTS, N_OUTPUTS))
    innovation = measured - readings(z, theta[0, 4])
    for i in range(N_OUTPUTS):
        H[i, NOISE + i] = coloured_sd[i]
        R[i, i] = white_sd[i] ** 2
        R[i, i] *= noise_factor(model.settings, safety.mismatch, R[i, i], safety.counts[UPDATES], i)
        innovation[i] -= coloured_sd[i] * z[NOISE + i]
    return innovation, H, R


@njit(cache=True, error_model="numpy")
def _bounded_states(model, z):  # type: ignore[no-untyped-def]
    """Flow positive, health within its coordinates, in place."""
    z[4] = max(z[4], 0.05)
    for i in range(N_HEALTH):
        z[ZETA + i] = min(max(z[ZETA + i], model.zeta_low[i]), model.zeta_high[i])


@njit(cache=True, error_model="numpy")
def _roll_back(safety, z, P):  # type: ignore[no-untyped-def]
    """Health and its sd as in the last valid posterior, in place."""
    factor = np.empty(N_HEALTH)
    for i in range(N_HEALTH):
        z[ZETA + i] = safety.valid[0, i]
        factor[i] = safety.valid[1, i] / np.sqrt(P[ZETA + i, ZETA + i])
    scale_health(P, ZETA, factor)


@njit(cache=True, error_model="numpy")
def _health_gain(model, safety, K, S, r):  # type: ignore[no-untyped-def]
    """Hold back, in place, the rows of K that correct health, and note where the correction pushes."""
    if safety.counts[FROZEN] > 0:
        K[ZETA:NOISE] = 0.0
        return
    rows = K[ZETA:NOISE].copy()
    note_push(safety.push, rows @ r, np.diag(rows @ S @ rows.T))
    if model.settings.least_information > 0.0:
        K[ZETA:NOISE] = safety.observable @ rows


@njit(cache=True, error_model="numpy")
def _remember(model, safety, z, P, H, used, white_sd, coloured_sd):  # type: ignore[no-untyped-def]
    """After an update: what it told about health, and whether its posterior is one to return to."""
    counts, settings = safety.counts, model.settings
    if settings.least_information > 0.0:
        memory = (1.0 + model.noise_keep) / (1.0 - model.noise_keep)
        accuracy = white_sd**2 + coloured_sd**2 * memory
        gather(safety.information, safety.sensitivity, H, ZETA, accuracy, ~np.isnan(used))
        if counts[UPDATES] % REFRESH == 0:
            fill(safety.observable.ravel(), informed(safety.information, settings.least_information).ravel())
    counts[UPDATES] += 1
    if counts[OUTSIDE] == 0 and counts[FROZEN] == 0 and counts[INFLATING] == 0:
        for i in range(N_HEALTH):
            safety.valid[0, i] = z[ZETA + i]
            safety.valid[1, i] = np.sqrt(P[ZETA + i, ZETA + i])


@njit(cache=True, error_model="numpy")
def correct(model, safety, z, P, measured, white_sd, coloured_sd, clip):  # type: ignore[no-untyped-def]
    """Eqs. (8)-(14) with the outputs ``measured`` (3,), NaN where missing; ``safety`` moves on in place.

    Returns z, P, innovation (3,), the same without the channels that the gate left out, S (3, 3), NIS.
    """
    settings, counts = model.settings, safety.counts
    z, P = z.copy(), P.copy()
    if counts[INFLATING] > 0:
        counts[INFLATING] -= 1
        scale_health(P, ZETA, np.full(N_HEALTH, settings.inflation ** (1.0 / INFLATION_UPDATES)))
    innovation, H, R = _observe(model, safety, z, measured, white_sd, coloured_sd)
    K, S, nis = gain(P, innovation, H, R)
    if settings.rollback and watch(counts, nis, np.sum(~np.isnan(innovation))):
        _roll_back(safety, z, P)
        innovation, H, R = _observe(model, safety, z, measured, white_sd, coloured_sd)
        K, S, nis = gain(P, innovation, H, R)
    used = innovation.copy()
    left_out(settings, counts, used, S)
    if np.isnan(used).sum() > np.isnan(innovation).sum():
        K, S, nis = gain(P, used, H, R)
    r = bounded(used, S, clip)
    if counts[FROZEN] == 0 and counts[INFLATING] == 0:
        note_mismatch(safety.mismatch, np.where(np.isnan(used), used, r), S - R)
    _health_gain(model, safety, K, S, r)
    z, P = z + K @ r, joseph(P, K, H, R)
    bound_health(P, ZETA, WIDEST)
    _bounded_states(model, z)
    _remember(model, safety, z, P, H, used, white_sd, coloured_sd)
    return z, P, innovation, used, S, nis


@njit(cache=True, error_model="numpy", no_cpython_wrapper=True)  # type: ignore[call-overload]
def _push(w, stream, b, sample, mask, query):  # type: ignore[no-untyped-def]
    """Let machine b's window take in one sample."""
    push(
        w,
        stream.ticks[b : b + 1],
        stream.values[b],
        stream.columns[b],
        stream.first[b],
        stream.tokens[b],
        stream.scores[b],
        stream.slow[b],
        stream.base[b],
        sample,
        mask,
        query,
    )


@njit(cache=True, error_model="numpy")
def _next_readings(left, lag, now):  # type: ignore[no-untyped-def]
    """Move what is read next from ``left`` (3,) to ``now`` (3,). Returns when in the tick; the rest is at 1."""
    to = 1.0
    for c in range(N_OUTPUTS):
        if not np.isnan(left[c]) and LATE < lag[c] <= 1.0:
            to = min(to, 1.0 - lag[c])
    for c in range(N_OUTPUTS):
        due = 1.0 - lag[c] == to if lag[c] > LATE else to == 1.0
        now[c] = left[c] if due else np.nan
        if due:
            left[c] = np.nan
    return to


@njit(cache=True, error_model="numpy")
def _report(innovation, S, accepted, surprise, used, spread, last):  # type: ignore[no-untyped-def]
    """Put one of a tick's corrections into its diagnostics, in place; the last one speaks for what is missing, too."""
    before = ~np.isnan(innovation)
    for i in range(N_OUTPUTS):
        for j in range(N_OUTPUTS):
            both = not np.isnan(surprise[i]) and not np.isnan(surprise[j])
            if both or (last and not before[i] and not before[j]):
                S[i, j] = spread[i, j]
    for c in range(N_OUTPUTS):
        if not np.isnan(surprise[c]):
            innovation[c] = surprise[c]
            accepted[c] = not np.isnan(used[c])


@njit(cache=True, error_model="numpy")
def tick(w, model, stream, safety, z, P, sample, mask, query, measured, lag, white_sd, coloured_sd, clip, info):  # type: ignore[no-untyped-def]
    """One tick of B machines, in place on ``stream``, ``safety``, ``z``, ``P`` and ``info``.

    Args:
        sample, mask, query: (B, 7), (B, 7), (B, 5) float32, what the operator's window takes in.
        measured: (B, 3) outputs, NaN where missing or rejected.
        lag: (B, 3) how long before the tick they were read, in ticks. Up to LATE is at the tick; what is later
            gets a correction of its own at its time; what is older than the last tick is left out.
        white_sd, coloured_sd: (B, 3) present sd of the output noise.
        info: innovation (B, 3), S (B, 3, 3), NIS (B,), accepted (B, 3), flags (B,).
    """
    innovation, S, nis, accepted, flags = info
    now = np.empty(N_OUTPUTS)
    for b in range(z.shape[0]):
        mean, cov = z[b], P[b]
        own = Safety(
            safety.sensitivity[b], safety.information[b], safety.observable[b], safety.mismatch[b],
            safety.push[b], safety.valid[b], safety.counts[b],
        )  # fmt: skip
        away = distance(model.envelope, query[b])
        innovation[b], S[b], nis[b], accepted[b] = np.nan, 0.0, np.nan, False
        left, at = measured[b].copy(), 0.0
        while at < 1.0:
            to = _next_readings(left, lag[b], now)
            if stream.ticks[b] > 0 and to > at:
                mean, cov, F = predict(w.heads, model, stream.base[b], mean, cov, away, own.push, to - at)
                if model.settings.least_information > 0.0:
                    carry_sensitivity(own.sensitivity, F, ZETA)
            mean, cov, surprise, used, spread, surprised = correct(
                model, own, mean, cov, now, white_sd[b], coloured_sd[b], clip
            )
            _report(innovation[b], S[b], accepted[b], surprise, used, spread, to == 1.0)
            if not np.isnan(surprised):
                nis[b] = surprised if np.isnan(nis[b]) else nis[b] + surprised
            at = to
        fill(z[b], mean)
        fill(P[b].ravel(), cov.ravel())
        flags[b] = FLAG_FROZEN if own.counts[FROZEN] > 0 else 0
        if model.settings.least_information > 0.0 and np.trace(own.observable) < N_HEALTH - 0.5:
            flags[b] |= FLAG_UNINFORMED
        for c in range(N_OUTPUTS):
            if not accepted[b, c] and not np.isnan(innovation[b, c]):
                flags[b] |= FLAG_GATED
        _push(w.encoder, stream, b, sample[b], mask[b], query[b])


@njit(cache=True, error_model="numpy")
def roll_out(w, model, scaling, stream, z, inputs, bias_K, out):  # type: ignore[no-untyped-def]
    """Open loop over inputs (B, L, 4): the window takes in the model's own readings, none measured.

    Args:
        scaling: mean (7,), scale (7,), query mean (5,), query scale (5,).
        bias_K: (B,).
        out: (B, L, 3) readings, written in place.
    """
    mean, scale, query_mean, query_scale = scaling
    sample = np.empty(7, np.float32)
    query = np.empty(5, np.float32)
    mask = np.ones(7, np.float32)
    for b in range(z.shape[0]):
        state = z[b].copy()
        for k in range(inputs.shape[1]):
            state = predict_mean(w.heads, model, stream.base[b], state)
            state[4] = max(state[4], 0.05)
            u = inputs[b, k]
            y = readings(state, bias_K[b])
            fill(out[b, k], y)
            for c in range(4):
                sample[c] = (u[c] - mean[c]) / scale[c]
            for c in range(3):
                sample[4 + c] = (y[c] - mean[4 + c]) / scale[4 + c]
            raw = (u[2], y[0] / u[0], u[1], u[0], u[3])
            for c in range(5):
                query[c] = (raw[c] - query_mean[c]) / query_scale[c]
            _push(w.encoder, stream, b, sample, mask, query)
