"""The augmented filter's forecast, Eqs. (6) and (7): z and its covariance a tick ahead, by the operator."""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.machines.coordinates import ZETA_SCALE
from twinbench.methods.deeponet_kalman.parts import places
from twinbench.methods.deeponet_kalman.safeguards import trust, walk_factor
from twinbench.methods.deeponet_kalman.stream import heads, heads_with_differences, heads_with_jacobian
from twinbench.methods.kalman import carry_into


@njit(cache=True, error_model="numpy")
def _condition(model, z, condition):  # type: ignore[no-untyped-def]
    zeta, _, _ = places(model)
    n = model.state_mean.size
    for i in range(n):
        condition[i] = (z[i] - model.state_mean[i]) / model.state_scale[i]
    for i in range(model.acting.size):
        condition[n + i] = z[zeta + model.acting[i]] / ZETA_SCALE


@njit(cache=True, error_model="numpy")
def lagged(lags, z, k):  # type: ignore[no-untyped-def]
    """Share of the gap to what it follows that the k-th lag closes in a tick, and its slope to what quickens it."""
    if lags.by[k] < 0:
        return 1.0 - np.exp(lags.keep_log[k]), 0.0
    quick = max(z[lags.by[k]], lags.least[k])
    log = lags.keep_log[k] * quick ** lags.power[k]
    keep = np.exp(log)
    return 1.0 - keep, -keep * log * lags.power[k] / quick


@njit(cache=True, error_model="numpy")
def _move(model, z, scaled, part):  # type: ignore[no-untyped-def]
    """Eq. (6) in place: states by the operator, lags by themselves, noise and slow error by their memory."""
    _, noise, error = places(model)
    n = model.state_mean.size
    for k in range(model.lags.of.size):
        share, _ = lagged(model.lags, z, k)
        z[n + k] += part * share * (z[model.lags.of[k]] - z[n + k])
    for i in range(n):
        z[i] += part * (scaled[i] * model.increment[i] + z[error + i])
        z[error + i] += part * (model.error_keep - 1.0) * z[error + i]
    for i in range(model.noise_keep.size):
        z[noise + i] += part * (model.noise_keep[i] - 1.0) * z[noise + i]


@njit(cache=True, error_model="numpy")
def _transition(model, z, jacobian, trusted, part, F):  # type: ignore[no-untyped-def]
    """The Jacobian (N, N) of ``_move``, into F."""
    zeta, noise, error = places(model)
    n, lags = model.state_mean.size, model.lags
    for i in range(F.shape[0]):
        for j in range(F.shape[1]):
            F[i, j] = 1.0 if i == j else 0.0
    for i in range(n):
        for j in range(n):
            F[i, j] += part * jacobian[i, j] * model.increment[i] / model.state_scale[j]
        for j in range(model.acting.size):
            F[i, zeta + model.acting[j]] = part * trusted * jacobian[i, n + j] * model.increment[i] / ZETA_SCALE
        F[i, error + i] = part
        F[error + i, error + i] += part * (model.error_keep - 1.0)
    for k in range(lags.of.size):
        share, slope = lagged(lags, z, k)
        F[n + k, n + k] -= part * share
        F[n + k, lags.of[k]] += part * share
        if lags.by[k] >= 0:
            F[n + k, lags.by[k]] += part * slope * (z[lags.of[k]] - z[n + k])
    for i in range(model.noise_keep.size):
        F[noise + i, noise + i] += part * (model.noise_keep[i] - 1.0)


@njit(cache=True, error_model="numpy")
def predict(w, model, base, z, away, part, t):  # type: ignore[no-untyped-def]
    """Eq. (6): z (N,) one tick ahead, in place, and the Jacobian in ``t.F``.

    The function takes plain arrays because it is compiled.

    Args:
        away: distance of the query from the training envelope.
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
    _move(model, z, net.out, part)


@njit(cache=True, error_model="numpy")
def spread(model, P, walk, away, push, part, t):  # type: ignore[no-untyped-def]
    """Eq. (7): P (N, N) one tick ahead with the Jacobian in ``t.F``, in place.

    The function takes plain arrays because it is compiled.

    Args:
        walk: (nh,) dimensionless variances that a tick adds to health's coordinates.
        away: distance of the query from the training envelope.
        push: (nh,) direction of late corrections, which widens the walk of health by Eq. (14).
        part: of the tick.
        t: room.
    """
    settings, (zeta, _, error) = model.settings, places(model)
    carry_into(P, t.F, zeta, t.M)
    for i in range(model.Q.shape[0]):
        for j in range(model.Q.shape[1]):
            P[i, j] += part * model.Q[i, j]
    for i in range(walk.size):
        P[zeta + i, zeta + i] += part * walk[i] * walk_factor(settings, model.memories.push, push[i])
    for i in range(model.state_mean.size):
        k = error + i
        P[k, k] += part * model.Q[k, k] * settings.extrapolation * away * away


@njit(cache=True, error_model="numpy")
def predict_mean(w, model, base, z, t):  # type: ignore[no-untyped-def]
    """The forecast of ``predict`` alone, in place, for open loop."""
    net = t.operator
    _condition(model, z, net.condition)
    heads(w, net, base, net.condition, net.out)
    _move(model, z, net.out, 1.0)
