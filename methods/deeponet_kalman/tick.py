"""One tick of the augmented filter: a filter for each mode of ``methods.modes``, and the mixture that is reported.

The operator is evaluated once a tick, at the mixture's mean. All modes take its slopes there, since their means lie
near each other. The safeguards are the mixture's.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.methods.deeponet_kalman.augmented import correct, expect, foresee, remember
from twinbench.methods.deeponet_kalman.forecast import predict, spread
from twinbench.methods.deeponet_kalman.parts import places
from twinbench.methods.deeponet_kalman.safeguards import KNOWN, carry_sensitivity, distance
from twinbench.methods.deeponet_kalman.stream import fill
from twinbench.methods.estimator import FLAG_GATED, FLAG_UNINFORMED
from twinbench.methods.kalman import solve_gain_into
from twinbench.methods.mixing import (
    FAILS_FROM,
    Failing,
    failure,
    follow_into,
    log_likelihood,
    merge_into,
    mix_into,
    weigh_into,
)

WANDERING = 3.0
"""What the states move by in a tick while the query is not known, in training increments."""
LATE = 0.5
"""Of a tick: what was read no longer ago than this counts as read at the tick."""


@njit(cache=True, error_model="numpy")
def _next_readings(left, lag, now):  # type: ignore[no-untyped-def]
    """Move what is read next from ``left`` (ny,) to ``now`` (ny,). Returns when in the tick; the rest is at 1."""
    to = 1.0
    for c in range(now.size):
        if not np.isnan(left[c]) and LATE < lag[c] <= 1.0:
            to = min(to, 1.0 - lag[c])
    for c in range(now.size):
        due = 1.0 - lag[c] == to if lag[c] > LATE else to == 1.0
        now[c] = left[c] if due else np.nan
        if due:
            left[c] = np.nan
    return to


@njit(cache=True, error_model="numpy")
def _report(out, nis, t, last):  # type: ignore[no-untyped-def]
    """Put one of a tick's corrections into its diagnostics; the last one speaks for what is missing, too."""
    for i in range(t.innovation.size):
        for j in range(t.innovation.size):
            both = not np.isnan(t.innovation[i]) and not np.isnan(t.innovation[j])
            if both or (last and np.isnan(out.innovation[i]) and np.isnan(out.innovation[j])):
                out.S[i, j] = t.S[i, j]
    for c in range(t.innovation.size):
        if not np.isnan(t.innovation[c]):
            out.innovation[c] = t.innovation[c]
            out.accepted[c] = not np.isnan(t.used[c])
    if not np.isnan(nis):
        out.nis = nis if np.isnan(out.nis) else out.nis + nis


@njit(cache=True, error_model="numpy")
def _begin(model, m, t):  # type: ignore[no-untyped-def]
    """Each mode's filter starts the tick from a mixture of all."""
    modes, mixed = m.modes, t.mixed
    room, to = (t.weight, t.before, t.M), (mixed.mu, modes.stays, mixed.z, mixed.P)
    mix_into(modes.mu, model.modes, modes.z, modes.P, room, to)
    fill(modes.mu, mixed.mu)
    for k in range(modes.mu.size):
        fill(modes.z[k], mixed.z[k])
        for i in range(m.z.size):
            fill(modes.P[k, i], mixed.P[k, i])


@njit(cache=True, error_model="numpy")
def _go_on(w, model, base, m, away, part, t):  # type: ignore[no-untyped-def]
    """Forecast over a part of the tick, in place. The function takes plain arrays because it is compiled."""
    modes, safety, n = m.modes, m.safety, model.increment.size
    fill(t.before, m.z)
    predict(w, model, base, m.z[:], away, part, t)
    for k in range(modes.mu.size):
        z, P = modes.z[k], modes.P[k]
        follow_into(z, t.F, t.before, m.z, t.apart)
        spread(model, P, model.modes.walk[k], away, safety.push[:], part, t)
        if safety.unknown > 0:
            for i in range(n):
                P[i, i] += part * (WANDERING * model.increment[i]) ** 2
    merge_into(modes.mu, modes.z, modes.P, t.before, m.P)
    if model.settings.least_information > 0.0:
        carry_sensitivity(safety.sensitivity, t.F, places(model)[0], t.after)


@njit(cache=True, error_model="numpy")
def _take_in(model, m, white_sd, coloured_sd, clip, t):  # type: ignore[no-untyped-def]
    """Correct every mode by the readings in ``t.now``, weigh and merge them. Returns NIS of the mixture.

    The function takes plain arrays because it is compiled.
    """
    modes, safety, out = m.modes, m.safety, model.modes.out
    foresee(model, safety, m.z[:], m.P[:], t.now, white_sd, coloured_sd, clip, t)
    fill(t.before, m.z)
    fill(t.ahead, modes.mu)
    for c in range(t.noise_var.size):
        t.noise_var[c] = t.R[c, c] + coloured_sd[c] ** 2
    for k in range(modes.mu.size):
        expect(modes.z[k], modes.P[k], t.before, t)
        if safety.unknown == 0:
            failing = Failing(modes.offset[k], t.noise_var, model.modes.wander)
            stays = model.modes.lasts[k] * modes.stays[k]
            t.score[k] = log_likelihood(t.own, t.own_S, out[k], stays, failing, t.L, t.whitened)
        else:
            t.score[k] = 0.0
        for c in range(t.own.size):
            if out[k, c] > 0.0:
                t.own[c] = np.nan
        correct(model, safety, modes.z[k], modes.P[k], clip, t)
    weigh_into(t.ahead, t.score, modes.mu)
    merge_into(modes.mu, modes.z, modes.P, m.z, m.P)
    for c in range(t.used.size):
        if failure(modes.mu, out, c) > FAILS_FROM:
            t.used[c] = np.nan
    remember(model, safety, white_sd, coloured_sd, t)
    return solve_gain_into(t.used, t.S, t.HP, t.K, t.L, t.X)


@njit(cache=True, error_model="numpy")
def _flags(model, m, out):  # type: ignore[no-untyped-def]
    """FLAG_ constants of what the filter did."""
    flags, (zeta, _, _) = 0, places(model)
    for i in range(model.prior_sd.size):
        if m.P[zeta + i, zeta + i] > (KNOWN * model.prior_sd[i]) ** 2:
            flags |= FLAG_UNINFORMED
    for c in range(out.innovation.size):
        failed = failure(m.modes.mu, model.modes.out, c) > FAILS_FROM
        if failed or (not out.accepted[c] and not np.isnan(out.innovation[c])):
            flags |= FLAG_GATED
    return flags


@njit(cache=True, error_model="numpy")
def tick(w, model, m, query, measured, lag, white_sd, coloured_sd, clip, out, t):  # type: ignore[no-untyped-def]
    """Forecast one machine by a tick and correct it by its outputs, in place on ``m``, ``measured`` and ``out``.

    The function takes plain arrays because it is compiled.

    Args:
        m: the machine's z, P, stream, safety and modes.
        query: (q,) standardised, of what the operator has last taken in.
        measured: (ny,) outputs, NaN where missing or rejected.
        lag: (ny,) how long before the tick they were read, in ticks. Up to LATE is at the tick; what is later
            gets a correction of its own at its time; what is older than the last tick is left out.
        white_sd: (ny,) present sd of the outputs' white noise, in their units.
        coloured_sd: (ny,) present sd of the outputs' coloured noise, in their units.
        out: innovation (ny,), S (ny, ny), nis, accepted (ny,), flags.
    """
    away, at, started = distance(model.envelope, query), 0.0, m.stream.ticks[0] > 0
    out.nis = np.nan
    for i in range(measured.size):
        out.innovation[i], out.accepted[i] = np.nan, False
        for j in range(measured.size):
            out.S[i, j] = 0.0
    if started:
        _begin(model, m, t)
    while at < 1.0:
        to = _next_readings(measured, lag, t.now)
        if started and to > at:
            _go_on(w, model, m.stream.base[:], m, away, to - at, t)
        nis = _take_in(model, m, white_sd, coloured_sd, clip, t)
        _report(out, nis, t, to == 1.0)
        at = to
    out.flags = _flags(model, m, out)
