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

import numpy as np
from numba import njit

from twinbench.data.batch import STATE
from twinbench.methods.deeponet_kalman.forecast import predict
from twinbench.methods.deeponet_kalman.model import BIAS, ERROR, FLOW, GAS, NOISE, PROBE, SIZE, ZETA
from twinbench.methods.deeponet_kalman.safeguards import (
    FROZEN,
    INFLATING,
    INFLATION_UPDATES,
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
    watch,
)
from twinbench.methods.deeponet_kalman.steps import follow_steps, free_to_return, note_way
from twinbench.methods.deeponet_kalman.stream import fill
from twinbench.methods.estimator import FLAG_FROZEN, FLAG_GATED, FLAG_UNINFORMED
from twinbench.methods.kalman import bound_into, gain_into, joseph_into
from twinbench.methods.operator import N_STATES
from twinbench.physics.compressor import M_REF_KG_S
from twinbench.physics.health import map_one

SHIFTS = (STATE.p_exh_bar, BIAS, FLOW)
"""Entries of z that a shift of each output is put down to: pressure, bias, flow."""
SLOW = (STATE.T_wall_K, *range(ZETA, NOISE), *range(ERROR, SIZE))
"""Entries of z that change over minutes: the wall, health, the slow errors. They stay while the query is not known."""
WANDERING = 3.0
"""What the states move by in a tick meanwhile, in training increments."""
LATE = 0.5
"""Of a tick: what was read no longer ago than this counts as read at the tick."""


@njit(cache=True, error_model="numpy")
def readings(z, bias_K, out):  # type: ignore[no-untyped-def]
    """Noise-free readings into ``out`` (3,), order OUTPUTS."""
    out[0], out[1], out[2] = z[STATE.p_exh_bar], z[PROBE] + bias_K, M_REF_KG_S * z[FLOW]


@njit(cache=True, error_model="numpy")
def _observe(model, safety, z, measured, white_sd, coloured_sd, t):  # type: ignore[no-untyped-def]
    """Innovation, NaN where missing, H, and R, the data sheet's widened by Eq. (13), into the room."""
    bias_K, slope = map_one(N_HEALTH - 1, z[BIAS])
    for i in range(N_OUTPUTS):
        for j in range(SIZE):
            t.H[i, j] = 0.0
        for j in range(N_OUTPUTS):
            t.R[i, j] = 0.0
    t.H[0, STATE.p_exh_bar] = 1.0
    t.H[1, PROBE] = 1.0
    t.H[1, BIAS] = slope
    t.H[2, FLOW] = M_REF_KG_S
    readings(z, bias_K, t.innovation)
    for i in range(N_OUTPUTS):
        t.H[i, NOISE + i] = coloured_sd[i]
        R = max(white_sd[i] ** 2, LEAST_VARIANCE)  # at a reading of nothing the data sheet promises no noise at all
        t.R[i, i] = R * noise_factor(model.settings, safety.mismatch, R, safety.counts[UPDATES], i)
        t.innovation[i] = measured[i] - t.innovation[i] - coloured_sd[i] * z[NOISE + i]


@njit(cache=True, error_model="numpy")
def _bounded_states(model, z):  # type: ignore[no-untyped-def]
    """Flow positive, health within its coordinates, in place."""
    z[FLOW] = max(z[FLOW], 0.05)
    for i in range(N_HEALTH):
        z[ZETA + i] = min(max(z[ZETA + i], model.zeta_low[i]), model.zeta_high[i])


@njit(cache=True, error_model="numpy")
def _roll_back(safety, z, P, factor):  # type: ignore[no-untyped-def]
    """Health and its sd as in the last valid posterior, in place."""
    for i in range(N_HEALTH):
        z[ZETA + i] = safety.valid[0, i]
        factor[i] = safety.valid[1, i] / np.sqrt(P[ZETA + i, ZETA + i])
    scale_health(P, ZETA, factor)


@njit(cache=True, error_model="numpy")
def _health_gain(model, safety, t):  # type: ignore[no-untyped-def]
    """Hold back, in ``t.K``, the rows that correct health, and note where the correction pushes."""
    if safety.unknown > 0:
        for i in SLOW:
            for c in range(N_OUTPUTS):
                t.K[i, c] = 0.0
        return
    if safety.counts[FROZEN] > 0:
        for i in range(N_HEALTH):
            for c in range(N_OUTPUTS):
                t.K[ZETA + i, c] = 0.0
        return
    for i in range(N_HEALTH):
        t.push[i] = t.variance[i] = 0.0
        for c in range(N_OUTPUTS):
            t.rows[i, c] = t.K[ZETA + i, c]
            t.push[i] += t.rows[i, c] * t.r[c]
        for c in range(N_OUTPUTS):
            for d in range(N_OUTPUTS):
                t.variance[i] += t.rows[i, c] * t.S[c, d] * t.rows[i, d]
    note_push(safety.push, t.push, t.variance)
    if model.settings.least_information > 0.0:
        for i in range(N_HEALTH):
            for c in range(N_OUTPUTS):
                t.K[ZETA + i, c] = 0.0
                for j in range(N_HEALTH):
                    t.K[ZETA + i, c] += safety.observable[i, j] * t.rows[j, c]


@njit(cache=True, error_model="numpy")
def _remember(model, safety, z, P, white_sd, coloured_sd, t):  # type: ignore[no-untyped-def]
    """After an update: what it told about health, and whether its posterior is one to return to."""
    counts, settings = safety.counts, model.settings
    if settings.least_information > 0.0:
        for c in range(N_OUTPUTS):
            memory = (1.0 + model.noise_keep[c]) / (1.0 - model.noise_keep[c])
            t.accuracy[c] = white_sd[c] ** 2 + coloured_sd[c] ** 2 * memory
        gather(safety.information, safety.sensitivity, t.H, ZETA, t.accuracy, t.used, t.push)
        if counts[UPDATES] % REFRESH == 0:
            informed(safety.information, settings.least_information, safety.observable, t.complex)
    note_way(safety.steps.way, counts[UPDATES], z[ZETA:NOISE])
    counts[UPDATES] += 1
    if counts[OUTSIDE] == 0 and counts[FROZEN] == 0 and counts[INFLATING] == 0:
        for i in range(N_HEALTH):
            safety.valid[0, i] = z[ZETA + i]
            safety.valid[1, i] = np.sqrt(P[ZETA + i, ZETA + i])


@njit(cache=True, error_model="numpy")
def _present(values):  # type: ignore[no-untyped-def]
    n = 0
    for i in range(values.size):
        n += 0 if np.isnan(values[i]) else 1
    return n


@njit(cache=True, error_model="numpy")
def correct(model, safety, z, P, measured, white_sd, coloured_sd, clip, t):  # type: ignore[no-untyped-def]
    """Eqs. (8)-(14) with the outputs ``measured`` (3,), NaN where missing: z, P and ``safety`` move on in place.

    Channels that stepped and are left out become NaN in ``measured``. Leaves ``t.innovation``, the same without the
    channels that the gate left out in ``t.used``, and ``t.S``. Returns NIS.

    The function takes plain arrays because it is compiled.
    """
    settings, counts = model.settings, safety.counts
    if counts[INFLATING] > 0:
        if counts[INFLATING] == INFLATION_UPDATES:
            free_to_return(safety.steps.way, z, P, ZETA)
        counts[INFLATING] -= 1
        for i in range(N_HEALTH):
            t.push[i] = settings.inflation ** (1.0 / INFLATION_UPDATES)
        scale_health(P, ZETA, t.push)
    _observe(model, safety, z, measured, white_sd, coloured_sd, t)
    nis = gain_into(P, t.innovation, t.H, t.R, t.K, t.S, t.HP, t.L, t.X)
    bias_K, _ = map_one(N_HEALTH - 1, z[BIAS])
    if settings.steps and follow_steps(safety, counts[UPDATES], t.innovation, t.S, t.H, SHIFTS, z, P, ZETA):
        now_K, _ = map_one(N_HEALTH - 1, z[BIAS])
        for i in (GAS, PROBE):  # what the bias does not explain any more is temperature
            z[i] += bias_K - now_K
        for c in range(N_OUTPUTS):
            if safety.steps.out[c] > 0:
                measured[c] = np.nan
        _observe(model, safety, z, measured, white_sd, coloured_sd, t)
        nis = gain_into(P, t.innovation, t.H, t.R, t.K, t.S, t.HP, t.L, t.X)
    if settings.rollback and safety.unknown == 0 and watch(counts, nis, _present(t.innovation)):
        _roll_back(safety, z, P, t.push)
        _observe(model, safety, z, measured, white_sd, coloured_sd, t)
        nis = gain_into(P, t.innovation, t.H, t.R, t.K, t.S, t.HP, t.L, t.X)
    fill(t.used, t.innovation)
    left_out(settings, counts, t.used, t.S)
    if _present(t.used) < _present(t.innovation):
        nis = gain_into(P, t.used, t.H, t.R, t.K, t.S, t.HP, t.L, t.X)
    bound_into(t.used, t.S, clip, t.r)
    if counts[FROZEN] == 0 and counts[INFLATING] == 0:
        for i in range(N_OUTPUTS):
            t.surprise[i] = t.used[i] if np.isnan(t.used[i]) else t.r[i]
            for j in range(N_OUTPUTS):
                t.L[i, j] = t.S[i, j] - t.R[i, j]
        note_mismatch(safety.mismatch, t.surprise, t.L)
    _health_gain(model, safety, t)
    for i in range(SIZE):
        for c in range(N_OUTPUTS):
            z[i] += t.K[i, c] * t.r[c]
    joseph_into(P, t.K, t.H, t.R, t.HP, t.M)
    bound_health(P, ZETA, WIDEST, t.column)
    _bounded_states(model, z)
    _remember(model, safety, z, P, white_sd, coloured_sd, t)
    return nis


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
def _report(out, t, last):  # type: ignore[no-untyped-def]
    """Put one of a tick's corrections into its diagnostics; the last one speaks for what is missing, too."""
    for i in range(N_OUTPUTS):
        for j in range(N_OUTPUTS):
            both = not np.isnan(t.innovation[i]) and not np.isnan(t.innovation[j])
            if both or (last and np.isnan(out.innovation[i]) and np.isnan(out.innovation[j])):
                out.S[i, j] = t.S[i, j]
    for c in range(N_OUTPUTS):
        if not np.isnan(t.innovation[c]):
            out.innovation[c] = t.innovation[c]
            out.accepted[c] = not np.isnan(t.used[c])


@njit(cache=True, error_model="numpy")
def tick(w, model, m, query, measured, lag, white_sd, coloured_sd, clip, out, t):  # type: ignore[no-untyped-def]
    """Forecast one machine by a tick and correct it by its outputs, in place on ``m``, ``measured`` and ``out``.

    The function takes plain arrays because it is compiled.

    Args:
        m: the machine's z, P, stream and safety.
        query: (5,) standardised, of what the operator has last taken in.
        measured: (3,) outputs, NaN where missing or rejected.
        lag: (3,) how long before the tick they were read, in ticks. Up to LATE is at the tick; what is later
            gets a correction of its own at its time; what is older than the last tick is left out.
        white_sd: (3,) present sd of the outputs' white noise, in their units.
        coloured_sd: (3,) present sd of the outputs' coloured noise, in their units.
        out: innovation (3,), S (3, 3), nis, accepted (3,), flags.
    """
    safety, informs = m.safety, model.settings.least_information > 0.0
    away = distance(model.envelope, query)
    out.nis, at = np.nan, 0.0
    for i in range(N_OUTPUTS):
        out.innovation[i], out.accepted[i] = np.nan, False
        for j in range(N_OUTPUTS):
            out.S[i, j] = 0.0
    while at < 1.0:
        to = _next_readings(measured, lag, t.now)
        if m.stream.ticks[0] > 0 and to > at:
            predict(w, model, m.stream.base, m.z, m.P, away, safety.push, to - at, t)
            if safety.unknown > 0:
                for i in range(N_STATES):
                    m.P[i, i] += (to - at) * (WANDERING * model.increment[i]) ** 2
            if informs:
                carry_sensitivity(safety.sensitivity, t.F, ZETA, t.after)
        nis = correct(model, safety, m.z, m.P, t.now, white_sd, coloured_sd, clip, t)
        _report(out, t, to == 1.0)
        if not np.isnan(nis):
            out.nis = nis if np.isnan(out.nis) else out.nis + nis
        at = to
    out.flags = FLAG_FROZEN if safety.counts[FROZEN] > 0 else 0
    known = 0.0
    for i in range(N_HEALTH):
        known += safety.observable[i, i]
    if informs and known < N_HEALTH - 0.5:
        out.flags |= FLAG_UNINFORMED
    for c in range(N_OUTPUTS):
        if safety.steps.out[c] > 0 or (not out.accepted[c] and not np.isnan(out.innovation[c])):
            out.flags |= FLAG_GATED
