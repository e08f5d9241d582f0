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

from twinbench.data.batch import Array
from twinbench.methods.deeponet_kalman.records import record
from twinbench.methods.deeponet_kalman.safeguards import (
    FROZEN,
    INFLATING,
    INFLATION_UPDATES,
    LEAST_VARIANCE,
    N_HEALTH,
    N_MOVED,
    N_OUTPUTS,
    OUTSIDE,
    REFRESH,
    UPDATES,
    WIDEST,
    Envelope,
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
from twinbench.methods.deeponet_kalman.steps import follow_steps, free_to_return, note_way
from twinbench.methods.deeponet_kalman.stream import (
    N_STATES,
    N_ZETA,
    ZETA_SCALE,
    fill,
    heads,
    heads_with_differences,
    heads_with_jacobian,
    scratch_type,
)
from twinbench.methods.estimator import FLAG_FROZEN, FLAG_GATED, FLAG_UNINFORMED
from twinbench.methods.kalman import bound_into, gain_into, joseph_into, symmetrise
from twinbench.methods.probe import probe_lag
from twinbench.physics.compressor import M_REF_KG_S
from twinbench.physics.health import map_one

PROBE, ZETA, NOISE, ERROR, SIZE = 5, 6, 11, 14, 19
T_DIS, BIAS = 2, ZETA + 4
ACTING = ZETA + N_HEALTH
"""Columns of F that the states' and the probe's rows fill: the states, the probe, health."""
SHIFTS = (1, BIAS, 4)
"""Entries of z that a shift of each output is put down to: pressure, bias, flow."""
SLOW = (3, *range(ZETA, NOISE), *range(ERROR, SIZE))
"""Entries of z that change over minutes: the wall, health, the slow errors. They stay while the query is not known."""
WANDERING = 3.0
"""What the states move by in a tick meanwhile, in training increments."""
LATE = 0.5
"""Of a tick: what was read no longer ago than this counts as read at the tick."""


class Model(NamedTuple):
    """What the filter needs besides the operator's weights; ``MODEL`` is the same as a record.

    Attributes:
        state_mean: (5,) means of the training states in their units, order STATES.
        state_scale: (5,) their spreads in the same units.
        increment: (5,) spread of the states' change in a tick, in the same units.
        Q: (19, 19) process noise of one tick, in the units of z squared.
        noise_keep: (3,) dimensionless AR(1) factors of the coloured sensor noise.
        error_keep: AR(1) factor of the operator's slow errors.
        zeta_low: (5,) dimensionless lower bounds of the coordinates, far outside a machine's life.
        zeta_high: (5,) dimensionless upper bounds.
        settings: of the safeguards.
        envelope: where the operator was trained.
    """

    state_mean: Array
    state_scale: Array
    increment: Array
    Q: Array
    noise_keep: Array
    error_keep: float
    zeta_low: Array
    zeta_high: Array
    settings: Settings
    envelope: Envelope


MODEL = record({
    "state_mean": ("f8", (N_STATES,)), "state_scale": ("f8", (N_STATES,)), "increment": ("f8", (N_STATES,)),
    "Q": ("f8", (SIZE, SIZE)), "noise_keep": ("f8", (N_OUTPUTS,)), "error_keep": ("f8", ()),
    "zeta_low": ("f8", (N_HEALTH,)), "zeta_high": ("f8", (N_HEALTH,)),
    "settings": (record(dict.fromkeys(Settings._fields, ("f8", ()))), ()),
    "envelope": (record(dict.fromkeys(Envelope._fields, ("f8", (N_HEALTH,)))), ()),
})  # fmt: skip


def room_type(weights: np.ndarray) -> np.dtype[np.void]:
    """Room for what one tick reckons in between.

    Args:
        weights: (1,) of ``methods.deeponet_kalman.stream.pack``, a record of dimensionless weights.
    """
    square, wide, narrow = (SIZE, SIZE), (N_OUTPUTS, SIZE), (N_OUTPUTS, N_OUTPUTS)
    return record(
        {
            "operator": (scratch_type(weights), ()),
            "F": ("f8", square),
            "M": ("f8", square),
            "H": ("f8", wide),
            "HP": ("f8", wide),
            "X": ("f8", wide),
            "K": ("f8", (SIZE, N_OUTPUTS)),
            "R": ("f8", narrow),
            "S": ("f8", narrow),
            "L": ("f8", narrow),
            **dict.fromkeys(("innovation", "used", "r", "now", "accuracy", "surprise"), ("f8", (N_OUTPUTS,))),
            "column": ("f8", (SIZE,)),
            "rows": ("f8", (N_HEALTH, N_OUTPUTS)),
            "push": ("f8", (N_HEALTH,)),
            "variance": ("f8", (N_HEALTH,)),
            "after": ("f8", (N_MOVED, N_HEALTH)),
            "complex": ("c16", (N_HEALTH, 2 * N_HEALTH)),
        }
    )


@njit(cache=True, error_model="numpy")
def _condition(model, z, condition):  # type: ignore[no-untyped-def]
    for i in range(N_STATES):
        condition[i] = (z[i] - model.state_mean[i]) / model.state_scale[i]
    for i in range(N_ZETA):
        condition[N_STATES + i] = z[ZETA + i] / ZETA_SCALE


@njit(cache=True, error_model="numpy")
def _move(model, z, scaled, part):  # type: ignore[no-untyped-def]
    """Eq. (6) in place: states by the operator, probe by its lag, noise and slow error by their memory."""
    share, _ = probe_lag(z[4])
    z[PROBE] += part * share * (z[2] - z[PROBE])
    for i in range(N_STATES):
        z[i] += part * (scaled[i] * model.increment[i] + z[ERROR + i])
        z[ERROR + i] += part * (model.error_keep - 1.0) * z[ERROR + i]
    for i in range(N_OUTPUTS):
        z[NOISE + i] += part * (model.noise_keep[i] - 1.0) * z[NOISE + i]


@njit(cache=True, error_model="numpy")
def _transition(model, z, jacobian, trusted, part, F):  # type: ignore[no-untyped-def]
    """The Jacobian (19, 19) of ``_move``, into F."""
    for i in range(SIZE):
        for j in range(SIZE):
            F[i, j] = 1.0 if i == j else 0.0
    for i in range(N_STATES):
        for j in range(N_STATES):
            F[i, j] += part * jacobian[i, j] * model.increment[i] / model.state_scale[j]
        for j in range(N_ZETA):
            F[i, ZETA + j] = part * trusted * jacobian[i, N_STATES + j] * model.increment[i] / ZETA_SCALE
        F[i, ERROR + i] = part
        F[ERROR + i, ERROR + i] += part * (model.error_keep - 1.0)
    share, slope = probe_lag(z[4])
    F[PROBE, PROBE] -= part * share
    F[PROBE, 2] = part * share
    F[PROBE, 4] = part * slope * (z[2] - z[PROBE])
    for i in range(N_OUTPUTS):
        F[NOISE + i, NOISE + i] += part * (model.noise_keep[i] - 1.0)


@njit(cache=True, error_model="numpy")
def _times(F, A, B):  # type: ignore[no-untyped-def]
    """``B = (F A)'`` for an F of ``_transition``: beside its diagonal it has six rows, which few columns act on."""
    for i in range(N_MOVED):
        for j in range(SIZE):
            B[i, j] = 0.0
        for k in range(ACTING):
            for j in range(SIZE):
                B[i, j] += F[i, k] * A[k, j]
        if i < N_STATES:
            for j in range(SIZE):
                B[i, j] += F[i, ERROR + i] * A[ERROR + i, j]
    for i in range(N_MOVED, SIZE):
        for j in range(SIZE):
            B[i, j] = F[i, i] * A[i, j]
    for i in range(SIZE):
        for j in range(i):
            B[i, j], B[j, i] = B[j, i], B[i, j]


@njit(cache=True, error_model="numpy")
def predict(w, model, base, z, P, away, push, part, t):  # type: ignore[no-untyped-def]
    """One tick ahead, Eqs. (6) and (7): z (19,) and P (19, 19) in place, the Jacobian in ``t.F``.

    Args:
        away: distance of the query from the training envelope.
        push: (5,) direction of late corrections, which widens the walk of health by Eq. (14).
        part: of the tick, 1 for all of it; less goes along the straight line there.
        t: room.
    """
    settings, net = model.settings, t.operator
    _condition(model, z, net.condition)
    if settings.difference > 0.0:
        heads_with_differences(w, net, base, net.condition, settings.difference)
    else:
        heads_with_jacobian(w, net, base, net.condition)
    _transition(model, z, net.jacobian, trust(settings, away), part, t.F)
    _times(t.F, P, t.M)
    _times(t.F, t.M, P)
    for i in range(SIZE):
        for j in range(SIZE):
            P[i, j] += part * model.Q[i, j]
    for i in range(N_HEALTH):
        k = ZETA + i
        P[k, k] += part * model.Q[k, k] * (walk_factor(settings, push[i]) - 1.0)
    for i in range(N_STATES):
        k = ERROR + i
        P[k, k] += part * model.Q[k, k] * settings.extrapolation * away * away
    symmetrise(P)
    _move(model, z, net.out, part)


@njit(cache=True, error_model="numpy")
def predict_mean(w, model, base, z, t):  # type: ignore[no-untyped-def]
    """The forecast of ``predict`` alone, in place, for open loop."""
    net = t.operator
    _condition(model, z, net.condition)
    heads(w, net, base, net.condition, net.out)
    _move(model, z, net.out, 1.0)


@njit(cache=True, error_model="numpy")
def readings(z, bias_K, out):  # type: ignore[no-untyped-def]
    """Noise-free readings into ``out`` (3,), order OUTPUTS."""
    out[0], out[1], out[2] = z[1], z[PROBE] + bias_K, M_REF_KG_S * z[4]


@njit(cache=True, error_model="numpy")
def _observe(model, safety, z, measured, white_sd, coloured_sd, t):  # type: ignore[no-untyped-def]
    """Innovation, NaN where missing, H, and R, the data sheet's widened by Eq. (13), into the room."""
    bias_K, slope = map_one(N_HEALTH - 1, z[BIAS])
    for i in range(N_OUTPUTS):
        for j in range(SIZE):
            t.H[i, j] = 0.0
        for j in range(N_OUTPUTS):
            t.R[i, j] = 0.0
    t.H[0, 1] = 1.0
    t.H[1, PROBE] = 1.0
    t.H[1, BIAS] = slope
    t.H[2, 4] = M_REF_KG_S
    readings(z, bias_K, t.innovation)
    for i in range(N_OUTPUTS):
        t.H[i, NOISE + i] = coloured_sd[i]
        R = max(white_sd[i] ** 2, LEAST_VARIANCE)  # at a reading of nothing the data sheet promises no noise at all
        t.R[i, i] = R * noise_factor(model.settings, safety.mismatch, R, safety.counts[UPDATES], i)
        t.innovation[i] = measured[i] - t.innovation[i] - coloured_sd[i] * z[NOISE + i]


@njit(cache=True, error_model="numpy")
def _bounded_states(model, z):  # type: ignore[no-untyped-def]
    """Flow positive, health within its coordinates, in place."""
    z[4] = max(z[4], 0.05)
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
        for i in (T_DIS, PROBE):  # what the bias does not explain any more is temperature
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
