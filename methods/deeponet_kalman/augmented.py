"""The augmented extended Kalman filter, Eqs. (6)-(14), with the operator as its model.

z = [states, lags behind them, health coordinates zeta, coloured-noise states, slow errors of the
operator].
Health is a random walk in zeta, as quick as a mode says; a probe is an exact first-order lag; the coloured part of the
sensor noise is AR(1) of unit variance, scaled by its present standard deviation. What the operator
gets wrong is wrong for minutes, since it depends on the operating point: white process noise cannot
say that, and a filter without these states is far too sure of itself. The operator gives the
forecast and, in the same pass, its Jacobian.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.machines.coordinates import map_one
from twinbench.methods.deeponet_kalman.parts import places
from twinbench.methods.deeponet_kalman.safeguards import (
    LEAST_VARIANCE,
    REFRESH,
    UPDATES,
    bound_health,
    gather,
    informed,
    left_out,
    noise_factor,
    note_mismatch,
    note_push,
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
def _note_push(model, safety, t):  # type: ignore[no-untyped-def]
    """Note which way the correction with ``t.K`` and ``t.r`` pushes health."""
    (zeta, _, _), (health, outputs) = places(model), t.rows.shape
    for i in range(health):
        t.push[i] = t.variance[i] = 0.0
        for c in range(outputs):
            t.push[i] += t.K[zeta + i, c] * t.r[c]
            for d in range(outputs):
                t.variance[i] += t.K[zeta + i, c] * t.S[c, d] * t.K[zeta + i, d]
    note_push(model.memories.push, safety.push, t.push, t.variance)


@njit(cache=True, error_model="numpy")
def _hold_back(model, safety, t):  # type: ignore[no-untyped-def]
    """Hold back, in ``t.K``, the rows of what is not to be corrected, or only along some directions."""
    (zeta, _, _), (health, outputs) = places(model), t.rows.shape
    if safety.unknown > 0:
        for i in range(model.slow.size):
            if model.slow[i]:
                for c in range(outputs):
                    t.K[i, c] = 0.0
        return
    if model.settings.least_information > 0.0:
        for i in range(health):
            for c in range(outputs):
                t.rows[i, c] = t.K[zeta + i, c]
        for i in range(health):
            for c in range(outputs):
                t.K[zeta + i, c] = 0.0
                for j in range(health):
                    t.K[zeta + i, c] += safety.observable[i, j] * t.rows[j, c]


@njit(cache=True, error_model="numpy")
def remember(model, safety, white_sd, coloured_sd, t):  # type: ignore[no-untyped-def]
    """After an update: what the outputs in ``t.used`` (ny,) told about health, NaN where one was not used."""
    counts, settings = safety.counts, model.settings
    zeta, _, _ = places(model)
    if settings.least_information > 0.0:
        for c in range(t.accuracy.size):
            memory = (1.0 + model.noise_keep[c]) / (1.0 - model.noise_keep[c])
            t.accuracy[c] = white_sd[c] ** 2 + coloured_sd[c] ** 2 * memory
        keep = model.memories.observed
        gather(keep, safety.information, safety.sensitivity, t.H, zeta, t.accuracy, t.used, t.push)
        if counts[UPDATES] % REFRESH == 0:
            informed(safety.information, settings.least_information, safety.observable, t.complex)
    counts[UPDATES] += 1


@njit(cache=True, error_model="numpy")
def foresee(model, safety, z, P, measured, white_sd, coloured_sd, clip, t):  # type: ignore[no-untyped-def]
    """Eqs. (8), (9) and (13) of z (N,) and P (N, N): what the outputs ``measured`` (ny,) say before anything moves.

    Leaves ``t.innovation``, the same without the channels that the gate leaves out in ``t.used``, H, R and S.

    The function takes plain arrays because it is compiled.
    """
    _observe(model, safety, z, measured, white_sd, coloured_sd, t)
    innovation_cov_into(P, t.H, t.R, t.S, t.HP)
    fill(t.used, t.innovation)
    left_out(model.settings, safety.counts, t.used, t.S)
    bound_into(t.used, t.S, clip, t.r)
    for i in range(t.used.size):
        t.surprise[i] = t.used[i] if np.isnan(t.used[i]) else t.r[i]
        for j in range(t.used.size):
            t.L[i, j] = t.S[i, j] - t.R[i, j]
    note_mismatch(model.memories.mismatch, safety.mismatch, t.surprise, t.L)
    if safety.unknown == 0:
        solve_gain_into(t.used, t.S, t.HP, t.K, t.L, t.X)
        _note_push(model, safety, t)


@njit(cache=True, error_model="numpy")
def expect(z, P, centre, t):  # type: ignore[no-untyped-def]
    """``t.own``, ``t.own_S`` and ``t.own_HP``: ``foresee``'s innovation and its covariance, from z (N,) and P (N, N).

    The outputs are linear at ``centre`` (N,), of which ``foresee`` left H.
    """
    innovation_cov_into(P, t.H, t.R, t.own_S, t.own_HP)
    for c in range(t.own.size):
        t.own[c] = t.used[c]
        for i in range(z.size):
            t.own[c] -= t.H[c, i] * (z[i] - centre[i])


@njit(cache=True, error_model="numpy")
def correct(model, safety, z, P, clip, t):  # type: ignore[no-untyped-def]
    """Eqs. (10)-(12) with the innovations ``t.own`` (ny,), NaN where not used, in place on z (N,) and P (N, N).

    The function takes plain arrays because it is compiled.
    """
    zeta, _, _ = places(model)
    solve_gain_into(t.own, t.own_S, t.own_HP, t.K, t.L, t.X)
    bound_into(t.own, t.own_S, clip, t.r)
    _hold_back(model, safety, t)
    for i in range(t.K.shape[0]):
        for c in range(t.K.shape[1]):
            z[i] += t.K[i, c] * t.r[c]
    joseph_into(P, t.K, t.H, t.R, t.own_HP, t.X)
    bound_health(P, zeta, model.widest, t.column)
    _bound(model, z)
