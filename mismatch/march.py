"""One compiled loop that runs a machine over a recording, and the two integrators that it can step with."""

from __future__ import annotations

import functools

import numpy as np
from numba import njit, types
from numba.extending import register_jitable

from twinbench.physics.integrate import INDICES, MATRIX
from twinbench.physics.jit import FUNCTION, VECTOR
from twinbench.physics.simulator import Array

RUNGE_KUTTA = np.empty((0, 5))
"""Scheme of the classical integrator, fourth order."""


@functools.cache
def legendre(stages: int) -> Array:
    """Scheme (stages + 1, 5) of the second-order integrator for stiff machines.

    Its steps may last (stages² + stages - 2) / 2 of the fastest time constants, Runge-Kutta's 2.8 of them only; and
    what is stiff dies away from step to step. Real time constants only: what swings it does not follow. After
    Meyer, Balsara and Aslam, A stabilized Runge-Kutta-Legendre method, J. Comput. Phys. 257 (2014), RKL2.
    The last column is how much each stage counts in the whole step.
    """
    j = np.arange(2.0, stages + 1)
    b = np.full(stages + 1, 1.0 / 3.0)
    b[2:] = (j**2 + j - 2.0) / (2.0 * j * (j + 1.0))
    w = 4.0 / (stages**2 + stages - 2.0)
    scheme = np.zeros((stages + 1, 5))
    scheme[1, 2] = b[1] * w
    scheme[2:, 0] = (2.0 * j - 1.0) / j * b[2:] / b[1:-1]
    scheme[2:, 1] = -(j - 1.0) / j * b[2:] / b[:-2]
    scheme[2:, 2] = w * scheme[2:, 0]
    scheme[2:, 3] = (b[1:-1] - 1.0) * scheme[2:, 2]
    last, now = np.zeros(stages + 1), scheme[1, 2] * (np.arange(stages + 1) == 0)
    for k in range(2, stages + 1):
        last, now = now, scheme[k, 0] * now + scheme[k, 1] * last
        now[k - 1] += scheme[k, 2]
        now[0] += scheme[k, 3]
    scheme[:, 4] = now
    return scheme


@register_jitable
def _runge_kutta(rhs, x, u, theta, h, work):  # type: ignore[no-untyped-def]
    # One buffer for each stage: an equation may hand back its argument.
    k1 = rhs(x, u, theta)
    for i in range(x.size):
        work[0, i] = x[i] + 0.5 * h * k1[i]
    k2 = rhs(work[0], u, theta)
    for i in range(x.size):
        work[1, i] = x[i] + 0.5 * h * k2[i]
    k3 = rhs(work[1], u, theta)
    for i in range(x.size):
        work[2, i] = x[i] + h * k3[i]
    k4 = rhs(work[2], u, theta)
    for i in range(x.size):
        work[3, i] = (x[i] + 2.0 * (work[0, i] + work[1, i]) + work[2, i]) / 6.0
        x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])


@register_jitable
def _stabilised(rhs, x, u, theta, h, scheme, work):  # type: ignore[no-untyped-def]
    f, last, now, mean = work[0], work[1], work[2], work[3]
    k = rhs(x, u, theta)
    for i in range(x.size):
        f[i] = k[i]
        last[i] = x[i]
        now[i] = x[i] + scheme[1, 2] * h * f[i]
        mean[i] = scheme[0, 4] * x[i] + scheme[1, 4] * now[i]
    for j in range(2, scheme.shape[0]):
        k = rhs(now, u, theta)
        for i in range(x.size):
            ahead = (1.0 - scheme[j, 0] - scheme[j, 1]) * x[i] + scheme[j, 0] * now[i] + scheme[j, 1] * last[i]
            ahead += h * (scheme[j, 2] * k[i] + scheme[j, 3] * f[i])
            last[i] = now[i]
            now[i] = ahead
            mean[i] += scheme[j, 4] * ahead
    for i in range(x.size):
        x[i] = now[i]


@register_jitable
def advance_stretch(rhs, x, u, theta, seconds, step_s, scheme, limit, work, mean):  # type: ignore[no-untyped-def]
    """Step ``x`` to the end of a stretch, in place, its mean state into ``mean``; False if it diverges on the way.

    The mean weights each stage as the step does. So linear rates there are exactly those by which ``x`` moves, however
    fast a state follows inputs that jump from one stretch to the next.
    """
    substeps = max(1, int(np.ceil(seconds / step_s - 1e-6)))
    h = seconds / substeps
    mean[:] = 0.0
    for _ in range(substeps):
        if scheme.shape[0] > 0:
            _stabilised(rhs, x, u, theta, h, scheme, work)
        else:
            _runge_kutta(rhs, x, u, theta, h, work)
        for i in range(x.size):
            if not abs(x[i]) < limit[i]:
                return False
            mean[i] += work[3, i] / substeps
    return True


@njit(
    types.void(
        FUNCTION,
        FUNCTION,
        MATRIX,
        VECTOR,
        INDICES,
        VECTOR,
        VECTOR,
        INDICES,
        MATRIX,
        types.float64,
        MATRIX,
        VECTOR,
        MATRIX,
    ),
    cache=True,
    error_model="numpy",
    nogil=True,
)
def march(rhs, output, u, seconds, samples, x0, theta, varying, values, step_s, scheme, limit, y_out):  # type: ignore[no-untyped-def]
    """Step through stretches over each of which the inputs hold; ``y_out`` stays NaN after a divergence.

    A stretch's reading is the mean over its samples, which lie on lines between the steps. The arguments are plain
    arrays, one by one, because that is what compiled code takes: ``Machine.clean`` is the way to call it. Shapes are
    u (S, nu), seconds and samples (S,), varying (V,), values (S, V), scheme (stages + 1, 5), limit (nx,), y_out
    (S, ny) or (S, nx); each in the units of what it holds.
    """
    theta = theta.copy()
    x = x0.copy()
    work = np.empty((4, x.size))
    total = np.zeros(y_out.shape[1])
    for k in range(u.shape[0]):
        for j in range(varying.size):
            theta[varying[j]] = values[k, j]
        substeps = max(1, int(np.ceil(seconds[k] / step_s - 1e-6)))
        h = seconds[k] / substeps
        n, read, diverged = samples[k], 0, False
        total[:] = 0.0
        for step in range(substeps):
            before = after = 0.0
            while read < n and read * substeps < (step + 1) * n:
                share = read * substeps / n - step
                before += 1.0 - share
                after += share
                read += 1
            if before > 0.0:
                total += before * output(x, u[k], theta)
            if read == n and after == 0.0 and k + 1 == u.shape[0]:
                break
            if scheme.shape[0] > 0:
                _stabilised(rhs, x, u[k], theta, h, scheme, work)
            else:
                _runge_kutta(rhs, x, u[k], theta, h, work)
            for i in range(x.size):
                diverged |= not abs(x[i]) < limit[i]
            if diverged and (read < n or after > 0.0):
                return
            if after > 0.0:
                total += after * output(x, u[k], theta)
            if diverged:
                break
        for i in range(total.size):
            y_out[k, i] = total[i] / n
        if diverged:
            return
