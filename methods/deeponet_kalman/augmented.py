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
from twinbench.methods.deeponet_kalman.causes import free_to_return, let_in, note_way
from twinbench.methods.deeponet_kalman.model import BIAS, ERROR, FLOW, NOISE, PROBE, SIZE, ZETA
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
from twinbench.physics.compressor import M_REF_KG_S
from twinbench.physics.health import map_one

SHIFTS = (STATE.p_exh_bar, BIAS, FLOW)
"""Entries of z that a shift of each output is put down to: pressure, bias, flow."""
SLOW = (STATE.T_wall_K, *range(ZETA, NOISE), *range(ERROR, SIZE))
"""Entries of z that change over minutes: the wall, health, the slow errors. They stay while the query is not known."""


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
def foresee(model, safety, z, P, measured, white_sd, coloured_sd, t):  # type: ignore[no-untyped-def]
    """Eqs. (8) and (9) before anything is judged: innovation, H, R, S and ``H P`` of all outputs, into the room.

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
    innovation_cov_into(P, t.H, t.R, t.S, t.HP)


@njit(cache=True, error_model="numpy")
def correct(model, safety, z, P, measured, white_sd, coloured_sd, clip, alone, t):  # type: ignore[no-untyped-def]
    """Eqs. (9)-(14) with what ``foresee`` left of the outputs ``measured`` (3,): z, P and ``safety`` move on in place.

    Outputs that are left out become NaN in ``measured``. Leaves ``t.innovation``, the same without the
    channels that the gate left out in ``t.used``, and ``t.S``. Returns NIS.

    The function takes plain arrays because it is compiled.

    Args:
        alone: False while causes are weighed: nothing is rolled back then, so that each cause shows what it is worth.
    """
    settings, counts = model.settings, safety.counts
    if let_in(safety.steps, t.innovation, t.S, t.H, SHIFTS, P):
        innovation_cov_into(P, t.H, t.R, t.S, t.HP)
    for c in range(N_OUTPUTS):
        if safety.steps.out[c] > 0:
            measured[c] = t.innovation[c] = np.nan
    nis = solve_gain_into(t.innovation, t.S, t.HP, t.K, t.L, t.X)
    if alone and settings.rollback and safety.unknown == 0 and watch(counts, nis, _present(t.innovation)):
        _roll_back(safety, z, P, t.push)
        _observe(model, safety, z, measured, white_sd, coloured_sd, t)
        innovation_cov_into(P, t.H, t.R, t.S, t.HP)
        nis = solve_gain_into(t.innovation, t.S, t.HP, t.K, t.L, t.X)
    fill(t.used, t.innovation)
    left_out(settings, counts, t.used, t.S)
    if _present(t.used) < _present(t.innovation):
        nis = solve_gain_into(t.used, t.S, t.HP, t.K, t.L, t.X)
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
