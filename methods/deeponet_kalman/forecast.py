"""The augmented filter's forecast, Eqs. (6) and (7): z and its covariance a tick ahead, by the operator."""

from __future__ import annotations

from numba import njit

from twinbench.methods.deeponet_kalman.model import ERROR, FLOW, GAS, NOISE, PROBE, SIZE, ZETA
from twinbench.methods.deeponet_kalman.safeguards import N_HEALTH, N_MOVED, N_OUTPUTS, trust, walk_factor
from twinbench.methods.deeponet_kalman.stream import heads, heads_with_differences, heads_with_jacobian
from twinbench.methods.kalman import symmetrise
from twinbench.methods.operator import N_STATES, N_ZETA
from twinbench.methods.probe import probe_lag
from twinbench.physics.health import ZETA_SCALE

ACTING = ZETA + N_HEALTH
"""Columns of F that the states' and the probe's rows fill: the states, the probe, health."""


@njit(cache=True, error_model="numpy")
def _condition(model, z, condition):  # type: ignore[no-untyped-def]
    for i in range(N_STATES):
        condition[i] = (z[i] - model.state_mean[i]) / model.state_scale[i]
    for i in range(N_ZETA):
        condition[N_STATES + i] = z[ZETA + i] / ZETA_SCALE


@njit(cache=True, error_model="numpy")
def _move(model, z, scaled, part):  # type: ignore[no-untyped-def]
    """Eq. (6) in place: states by the operator, probe by its lag, noise and slow error by their memory."""
    share, _ = probe_lag(z[FLOW])
    z[PROBE] += part * share * (z[GAS] - z[PROBE])
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
    share, slope = probe_lag(z[FLOW])
    F[PROBE, PROBE] -= part * share
    F[PROBE, GAS] = part * share
    F[PROBE, FLOW] = part * slope * (z[GAS] - z[PROBE])
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

    The function takes plain arrays because it is compiled.

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
