"""The augmented extended Kalman filter, Eqs. (6)-(14), with the operator as its model.

z = [states, lags behind them, health coordinates zeta, coloured-noise states, slow errors of the
operator].
Health is a random walk in zeta; a probe is an exact first-order lag; the coloured part of the
sensor noise is AR(1) of unit variance, scaled by its present standard deviation. What the operator
gets wrong is wrong for minutes, since it depends on the operating point: white process noise cannot
say that, and a filter without these states is far too sure of itself. The operator gives the
forecast and, in the same pass, its Jacobian.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.machines.coordinates import map_one
from twinbench.methods.deeponet_kalman.causes import free_to_return, let_in, note_way
from twinbench.methods.deeponet_kalman.parts import places
from twinbench.methods.deeponet_kalman.safeguards import (
    FROZEN,
    INFLATING,
    INFLATION_UPDATES,
    LEAST_VARIANCE,
    OUTSIDE,
    REFRESH,
    UPDATES,
    bound_health,
    gather,
    informed,
    left_out,
    noise_factor,
    note_mismatch,
    note_push,
    scale_health,
    watch,
)
from twinbench.methods.deeponet_kalman.stream import fill
from twinbench.methods.kalman import bound_into, innovation_cov_into, joseph_into, solve_gain_into


@njit(cache=True, error_model="numpy")
def readings(model, z, out):  # type: ignore[no-untyped-def]
    """Noise-free readings into ``out`` (ny,)."""
    zeta, _, _ = places(model)
    for i in range(out.size):
        out[i], bias = model.readings.gain[i] * z[model.readings.source[i]], model.readings.bias[i]
        if bias >= 0:
            out[i] += map_one(model.health, bias, z[zeta + bias])[0]


@njit(cache=True, error_model="numpy")
def _observe(model, safety, z, measured, white_sd, coloured_sd, t):  # type: ignore[no-untyped-def]
    """Innovation, NaN where missing, H, and R, the data sheet's widened by Eq. (13), into the room."""
    zeta, noise, _ = places(model)
    for i in range(t.H.shape[0]):
        for j in range(t.H.shape[1]):
            t.H[i, j] = 0.0
        for j in range(t.R.shape[0]):
            t.R[i, j] = 0.0
        source, bias, gain = model.readings.source[i], model.readings.bias[i], model.readings.gain[i]
        expected = gain * z[source]
        t.H[i, source] = gain
        if bias >= 0:
            offset, slope = map_one(model.health, bias, z[zeta + bias])
            expected += offset
            t.H[i, zeta + bias] = slope
        t.H[i, noise + i] = coloured_sd[i]
        R = max(white_sd[i] ** 2, LEAST_VARIANCE)  # at a reading of nothing the data sheet promises no noise at all
        updates = safety.counts[UPDATES]
        t.R[i, i] = R * noise_factor(model.settings, model.memories.mismatch, safety.mismatch, R, updates, i)
        t.innovation[i] = measured[i] - expected - coloured_sd[i] * z[noise + i]


@njit(cache=True, error_model="numpy")
def bound_states(model, z):  # type: ignore[no-untyped-def]
    """States no lower than they may be, in place."""
    for i in range(model.state_low.size):
        z[i] = max(z[i], model.state_low[i])


@njit(cache=True, error_model="numpy")
def _bound(model, z):  # type: ignore[no-untyped-def]
    """States no lower than they may be, health within its coordinates, in place."""
    bound_states(model, z)
    zeta, _, _ = places(model)
    for i in range(model.zeta_low.size):
        z[zeta + i] = min(max(z[zeta + i], model.zeta_low[i]), model.zeta_high[i])


@njit(cache=True, error_model="numpy")
def _roll_back(safety, z, P, at, factor):  # type: ignore[no-untyped-def]
    """Health, from ``at`` on, and its sd as in the last valid posterior, in place."""
    for i in range(factor.size):
        z[at + i] = safety.valid[0, i]
        factor[i] = safety.valid[1, i] / np.sqrt(P[at + i, at + i])
    scale_health(P, at, factor)


@njit(cache=True, error_model="numpy")
def _health_gain(model, safety, t):  # type: ignore[no-untyped-def]
    """Hold back, in ``t.K``, the rows that correct health, and note where the correction pushes."""
    (zeta, _, _), (health, outputs) = places(model), t.rows.shape
    if safety.unknown > 0:
        for i in range(model.slow.size):
            if model.slow[i]:
                for c in range(outputs):
                    t.K[i, c] = 0.0
        return
    if safety.counts[FROZEN] > 0:
        for i in range(health):
            for c in range(outputs):
                t.K[zeta + i, c] = 0.0
        return
    for i in range(health):
        t.push[i] = t.variance[i] = 0.0
        for c in range(outputs):
            t.rows[i, c] = t.K[zeta + i, c]
            t.push[i] += t.rows[i, c] * t.r[c]
        for c in range(outputs):
            for d in range(outputs):
                t.variance[i] += t.rows[i, c] * t.S[c, d] * t.rows[i, d]
    note_push(model.memories.push, safety.push, t.push, t.variance)
    if model.settings.least_information > 0.0:
        for i in range(health):
            for c in range(outputs):
                t.K[zeta + i, c] = 0.0
                for j in range(health):
                    t.K[zeta + i, c] += safety.observable[i, j] * t.rows[j, c]


@njit(cache=True, error_model="numpy")
def _remember(model, safety, z, P, white_sd, coloured_sd, t):  # type: ignore[no-untyped-def]
    """After an update: what it told about health, and whether its posterior is one to return to."""
    counts, settings = safety.counts, model.settings
    zeta, noise, _ = places(model)
    if settings.least_information > 0.0:
        for c in range(t.accuracy.size):
            memory = (1.0 + model.noise_keep[c]) / (1.0 - model.noise_keep[c])
            t.accuracy[c] = white_sd[c] ** 2 + coloured_sd[c] ** 2 * memory
        keep = model.memories.observed
        gather(keep, safety.information, safety.sensitivity, t.H, zeta, t.accuracy, t.used, t.push)
        if counts[UPDATES] % REFRESH == 0:
            informed(safety.information, settings.least_information, safety.observable, t.complex)
    note_way(model.waits, safety.steps.way, counts[UPDATES], z[zeta:noise])
    counts[UPDATES] += 1
    if counts[OUTSIDE] == 0 and counts[FROZEN] == 0 and counts[INFLATING] == 0:
        for i in range(noise - zeta):
            safety.valid[0, i] = z[zeta + i]
            safety.valid[1, i] = np.sqrt(P[zeta + i, zeta + i])


@njit(cache=True, error_model="numpy")
def _present(values):  # type: ignore[no-untyped-def]
    n = 0
    for i in range(values.size):
        n += 0 if np.isnan(values[i]) else 1
    return n


@njit(cache=True, error_model="numpy")
def foresee(model, safety, z, P, measured, white_sd, coloured_sd, t):  # type: ignore[no-untyped-def]
    """Eqs. (8) and (9) before anything is judged: innovation, H, R, S and ``H P`` of all outputs, into the room.

    The function takes plain arrays because it is compiled.
    """
    counts, (zeta, _, _) = safety.counts, places(model)
    if counts[INFLATING] > 0:
        if counts[INFLATING] == INFLATION_UPDATES:
            free_to_return(safety.steps.way, z, P, zeta)
        counts[INFLATING] -= 1
        for i in range(t.push.size):
            t.push[i] = model.settings.inflation ** (1.0 / INFLATION_UPDATES)
        scale_health(P, zeta, t.push)
    _observe(model, safety, z, measured, white_sd, coloured_sd, t)
    innovation_cov_into(P, t.H, t.R, t.S, t.HP)


@njit(cache=True, error_model="numpy")
def correct(model, safety, z, P, measured, white_sd, coloured_sd, clip, alone, t):  # type: ignore[no-untyped-def]
    """Eqs. (9)-(14) with what ``foresee`` left of the outputs ``measured`` (ny,): z, P and ``safety`` move on in place.

    Outputs that are left out become NaN in ``measured``. Leaves ``t.innovation``, the same without the
    channels that the gate left out in ``t.used``, and ``t.S``. Returns NIS.

    The function takes plain arrays because it is compiled.

    Args:
        alone: False while causes are weighed: nothing is rolled back then, so that each cause shows what it is worth.
    """
    settings, counts, (zeta, _, _) = model.settings, safety.counts, places(model)
    if let_in(model.waits, safety.steps, t.innovation, t.S, t.H, model.readings.shifts, P):
        innovation_cov_into(P, t.H, t.R, t.S, t.HP)
    for c in range(measured.size):
        if safety.steps.out[c] > 0:
            measured[c] = t.innovation[c] = np.nan
    nis = solve_gain_into(t.innovation, t.S, t.HP, t.K, t.L, t.X)
    if alone and settings.rollback and safety.unknown == 0 and watch(model.gate, counts, nis, _present(t.innovation)):
        _roll_back(safety, z, P, zeta, t.push)
        _observe(model, safety, z, measured, white_sd, coloured_sd, t)
        innovation_cov_into(P, t.H, t.R, t.S, t.HP)
        nis = solve_gain_into(t.innovation, t.S, t.HP, t.K, t.L, t.X)
    fill(t.used, t.innovation)
    left_out(settings, counts, t.used, t.S)
    if _present(t.used) < _present(t.innovation):
        nis = solve_gain_into(t.used, t.S, t.HP, t.K, t.L, t.X)
    bound_into(t.used, t.S, clip, t.r)
    if counts[FROZEN] == 0 and counts[INFLATING] == 0:
        for i in range(t.used.size):
            t.surprise[i] = t.used[i] if np.isnan(t.used[i]) else t.r[i]
            for j in range(t.used.size):
                t.L[i, j] = t.S[i, j] - t.R[i, j]
        note_mismatch(model.memories.mismatch, safety.mismatch, t.surprise, t.L)
    _health_gain(model, safety, t)
    for i in range(t.K.shape[0]):
        for c in range(t.K.shape[1]):
            z[i] += t.K[i, c] * t.r[c]
    joseph_into(P, t.K, t.H, t.R, t.HP, t.M)
    bound_health(P, zeta, model.widest, t.column)
    _bound(model, z)
    _remember(model, safety, z, P, white_sd, coloured_sd, t)
    return nis
