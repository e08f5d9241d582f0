"""One tick of the augmented filter: alone, or as one rival for each cause of a step that is weighed.

While causes are weighed, the machine's own z and P are the rivals' mixture, and its safety is that of the likeliest.
With these it goes on alone at the end: causes that still look alike leave health as uncertain as they are. Going on
with the likeliest rival alone would be surer of health, and more often wrong. Steps are not looked for meanwhile: the
causes are supposed from where the weighing begins, and what comes later is found when it is over.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.machines.coordinates import map_one
from twinbench.methods.deeponet_kalman.augmented import correct, foresee
from twinbench.methods.deeponet_kalman.causes import moved, stepped, suppose
from twinbench.methods.deeponet_kalman.forecast import predict
from twinbench.methods.deeponet_kalman.parts import places
from twinbench.methods.deeponet_kalman.safeguards import (
    FROZEN,
    INFLATING,
    KNOWN,
    OUTSIDE,
    UPDATES,
    carry_sensitivity,
    distance,
)
from twinbench.methods.deeponet_kalman.stream import fill
from twinbench.methods.estimator import FLAG_FROZEN, FLAG_GATED, FLAG_UNINFORMED
from twinbench.methods.weighing import likeliest, log_likelihood, mixture_into, probabilities

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
def _go_on(w, model, base, safety, z, P, away, part, t):  # type: ignore[no-untyped-def]
    """Forecast over a part of the tick, in place. The function takes plain arrays because it is compiled."""
    predict(w, model, base, z, P, away, safety.push[:], part, t)
    if safety.unknown > 0:
        for i in range(model.increment.size):
            P[i, i] += part * (WANDERING * model.increment[i]) ** 2
    if model.settings.least_information > 0.0:
        carry_sensitivity(safety.sensitivity, t.F, places(model)[0], t.after)


@njit(cache=True, error_model="numpy")
def _explain_without(model, z, was):  # type: ignore[no-untyped-def]
    """What the biases of z do not explain any more, as they were in ``was``, is the machine's: its states move.

    The states are those behind biased readings; what lags there takes along what it follows.
    """
    zeta, _, _ = places(model)
    n = model.state_mean.size
    for c in range(model.readings.bias.size):
        bias, source = model.readings.bias[c], model.readings.source[c]
        if bias < 0:
            continue
        more = map_one(model.health, bias, was[zeta + bias])[0] - map_one(model.health, bias, z[zeta + bias])[0]
        z[source] += more / model.readings.gain[c]
        if source >= n:
            z[model.lags.of[source - n]] += more / model.readings.gain[c]


@njit(cache=True, error_model="numpy")
def _begin(model, m, which, t):  # type: ignore[no-untyped-def]
    """Output ``which`` stepped: a copy of the filter for every cause, in which it is supposed."""
    rivals, causes, waits, (zeta, _, _) = m.rivals, model.causes, model.waits, places(model)
    rivals.left = max(round(model.settings.weighed_s / model.period_s), 1)
    for k in range(rivals.score.size):
        rivals.score[k] = causes.log_prior[k]
        fill(rivals.z[k], m.z)
        for i in range(m.z.size):
            fill(rivals.P[k, i], m.P[i])
        rivals.safety[k] = m.safety
        safety, z, P = rivals.safety[k], rivals.z[k], rivals.P[k]
        if k == causes.back and not moved(waits, safety.steps.way, safety.counts[UPDATES], z, P, zeta):
            rivals.score[k] = -np.inf  # a way back that leads nowhere would only let the readings' states be anything
        safety.counts[OUTSIDE] = safety.counts[FROZEN] = safety.counts[INFLATING] = 0
        suppose(causes, waits, k, safety.steps, safety.counts[UPDATES], z, P, zeta, model.settings.leap)
        if k == causes.back:
            entry = model.readings.shifts[which]
            P[entry, entry] += (t.innovation[which] / t.H[which, entry]) ** 2
            _explain_without(model, z, m.z)


@njit(cache=True, error_model="numpy")
def _compete(w, model, m, base, away, part, white_sd, coloured_sd, clip, out, last, t):  # type: ignore[no-untyped-def]
    """All rivals go on over a part of the tick and take its readings in; their mixture is the machine's.

    The function takes plain arrays because it is compiled.
    """
    rivals = m.rivals
    shown = likeliest(rivals.score)
    for k in range(rivals.score.size):
        safety, z, P = rivals.safety[k], rivals.z[k], rivals.P[k]
        safety.unknown = m.safety.unknown
        if part > 0.0:
            _go_on(w, model, base, safety, z, P, away, part, t)
        fill(t.read, t.now)
        foresee(model, safety, z, P, t.read, white_sd, coloured_sd, t)
        if safety.unknown == 0:
            rivals.score[k] += log_likelihood(t.innovation, t.S, safety.steps.out, t.L, t.whitened)
        nis = correct(model, safety, z, P, t.read, white_sd, coloured_sd, clip, rivals.left == 0, t)
        if k == shown:
            _report(out, nis, t, last)
    m.safety = rivals.safety[likeliest(rivals.score)]
    probabilities(rivals.score, t.probability)
    mixture_into(t.probability, rivals.z, rivals.P, m.z, m.P)


@njit(cache=True, error_model="numpy")
def _flags(model, m, out):  # type: ignore[no-untyped-def]
    """FLAG_ constants of what the filter did."""
    flags, (zeta, _, _) = FLAG_FROZEN if m.safety.counts[FROZEN] > 0 else 0, places(model)
    for i in range(model.prior_sd.size):
        if m.P[zeta + i, zeta + i] > (KNOWN * model.prior_sd[i]) ** 2:
            flags |= FLAG_UNINFORMED
    for c in range(out.innovation.size):
        if m.safety.steps.out[c] > 0 or (not out.accepted[c] and not np.isnan(out.innovation[c])):
            flags |= FLAG_GATED
    return flags


@njit(cache=True, error_model="numpy")
def tick(w, model, m, query, measured, lag, white_sd, coloured_sd, clip, out, t):  # type: ignore[no-untyped-def]
    """Forecast one machine by a tick and correct it by its outputs, in place on ``m``, ``measured`` and ``out``.

    The function takes plain arrays because it is compiled.

    Args:
        m: the machine's z, P, stream, safety and rivals.
        query: (q,) standardised, of what the operator has last taken in.
        measured: (ny,) outputs, NaN where missing or rejected.
        lag: (ny,) how long before the tick they were read, in ticks. Up to LATE is at the tick; what is later
            gets a correction of its own at its time; what is older than the last tick is left out.
        white_sd: (ny,) present sd of the outputs' white noise, in their units.
        coloured_sd: (ny,) present sd of the outputs' coloured noise, in their units.
        out: innovation (ny,), S (ny, ny), nis, accepted (ny,), flags.
    """
    away, at = distance(model.envelope, query), 0.0
    base, z, P = m.stream.base[:], m.z[:], m.P[:]  # of one type with the rivals' own: everything compiles once
    out.nis = np.nan
    for i in range(measured.size):
        out.innovation[i], out.accepted[i] = np.nan, False
        for j in range(measured.size):
            out.S[i, j] = 0.0
    while at < 1.0:
        to = _next_readings(measured, lag, t.now)
        part = to - at if m.stream.ticks[0] > 0 else 0.0
        if m.rivals.left == 0:
            if part > 0.0:
                _go_on(w, model, base, m.safety, z, P, away, part, t)
                part = 0.0
            fill(t.read, t.now)
            foresee(model, m.safety, z, P, t.read, white_sd, coloured_sd, t)
            which = stepped(m.safety.steps, m.safety.unknown, t.innovation, t.S) if model.settings.steps else -1
            if which >= 0:
                _begin(model, m, which, t)
            else:
                nis = correct(model, m.safety, z, P, t.read, white_sd, coloured_sd, clip, m.rivals.left == 0, t)
                _report(out, nis, t, to == 1.0)
        if m.rivals.left > 0:
            _compete(w, model, m, base, away, part, white_sd, coloured_sd, clip, out, to == 1.0, t)
        at = to
    m.rivals.left = max(m.rivals.left - 1, 0)
    out.flags = _flags(model, m, out)
