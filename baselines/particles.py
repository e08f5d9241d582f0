"""Particles for some states and a Kalman filter for the rest, compiled: one machine at a time.

A particle is a point z (n,): of the sampled states what it supposes, of the others their mean if that is so. Their
covariance given the sampled states is one for all particles (Rao-Blackwellisation; Schön, Gustafsson and Nordlund,
2005). Numbers are drawn from a counter (Steele, Lea and Flood, 2014), which the caller carries: the same counter, the
same numbers.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.baselines.nominal_filter import nis_of
from twinbench.methods.kalman import bounded, cholesky_solve, factorise, gain, joseph

GOLDEN, FIRST, SECOND = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
ONE, A, B, C, KEPT = np.uint64(1), np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
"""SplitMix64's own."""
TINY = 1e-12
"""Of a spread, what is added before it is inverted: particles that agree leave none."""


@njit(cache=True, error_model="numpy")
def uniform(counter):  # type: ignore[no-untyped-def]
    """The counter's number in (0, 1)."""
    x = (np.uint64(counter) + ONE) * GOLDEN  # Python hands a counter back as a signed number
    x = (x ^ (x >> A)) * FIRST
    x = (x ^ (x >> B)) * SECOND
    return (float((x ^ (x >> C)) >> KEPT) + 0.5) * 2.0**-53


@njit(cache=True, error_model="numpy")
def normal(counter):  # type: ignore[no-untyped-def]
    """The standard normal number (Box and Muller) of a counter and the one after it."""
    first = np.uint64(counter)
    return np.sqrt(-2.0 * np.log(uniform(first))) * np.cos(2.0 * np.pi * uniform(first + ONE))


@njit(cache=True, error_model="numpy")
def mixture(particles, weights, P):  # type: ignore[no-untyped-def]
    """Mean (n,) and covariance (n, n) of weighted particles (N, n), each with covariance P (n, n) around it."""
    count, n = particles.shape
    mean, apart, weighted = np.zeros(n), np.empty((count, n)), np.empty((count, n))
    for k in range(count):
        for j in range(n):
            mean[j] += weights[k] * particles[k, j]
    for k in range(count):
        for j in range(n):
            apart[k, j] = particles[k, j] - mean[j]
            weighted[k, j] = weights[k] * apart[k, j]
    cov = P + apart.T @ weighted
    return mean, 0.5 * (cov + cov.T)


@njit(cache=True, error_model="numpy")
def follow(cov, sampled):  # type: ignore[no-untyped-def]
    """How far all states go (n, d) where the sampled ones, at positions (d,), go by one; the factor (d, d) of these."""
    L = cov[sampled][:, sampled].copy()
    for i in range(len(L)):
        L[i, i] *= 1.0 + TINY
    slope = cholesky_solve(L, cov[sampled]).T.copy()
    factorise(L, len(L))
    return slope, L


@njit(cache=True, error_model="numpy")
def walk(particles, sampled, sd, counter):  # type: ignore[no-untyped-def]
    """Move the sampled states of particles (N, n), in place, by normal steps of ``sd`` (d,); the counter after that.

    The function takes plain arrays because it is compiled.
    """
    at = np.uint64(counter)
    for k in range(particles.shape[0]):
        for j in range(sd.size):
            particles[k, sampled[j]] += sd[j] * normal(at)
            at += ONE + ONE
    return at


@njit(cache=True, error_model="numpy")
def _inverse(S, there):  # type: ignore[no-untyped-def]
    """Of S (m, m) among the channels that are there, zero elsewhere."""
    some = np.diag(there.astype(np.float64))
    alone = some @ S @ some + np.eye(len(S)) - some
    return some @ cholesky_solve(alone, some)


@njit(cache=True, error_model="numpy")
def reweigh(particles, weights, P, readings, H, R, measured, clip):  # type: ignore[no-untyped-def]
    """Weigh and correct particles (N, n) by what was measured, in place. Plain arrays, because it is compiled.

    Args:
        particles: (N, n), in the filter's coordinates.
        weights: (N,), their sum is 1.
        P: (n, n) covariance of the states that are not sampled, given those that are; is written.
        readings: (N, m), what each particle would read, in the sensors' units.
        H: (m, n) slope of the readings, in those units.
        R: (m, m) covariance of the measurement noise, in those units squared.
        measured: (m,) in the same units; NaN means missing.
        clip: the particles' common innovation is bounded to this many standard deviations.

    Returns:
        Innovation (m,) of their mean, S (m, m), NIS over the channels that are there.
    """
    m = measured.size
    K, S_given, _ = gain(P, measured - readings[0], H, R)
    expected, S = mixture(readings, weights, S_given)
    innovation = measured - expected
    there = ~np.isnan(innovation)
    if not there.any():
        return innovation, S, np.nan
    wanted = expected + bounded(innovation, S, clip)
    inverse = _inverse(S_given, there)
    nis, r = np.zeros(len(weights)), np.zeros(m)
    for k in range(len(weights)):
        for c in range(m):
            r[c] = wanted[c] - readings[k, c] if there[c] else 0.0
        for c in range(m):
            for e in range(m):
                nis[k] += r[c] * inverse[c, e] * r[e]
            for j in range(particles.shape[1]):
                particles[k, j] += K[j, c] * r[c]
    least = nis.min()
    for k in range(len(weights)):
        weights[k] *= np.exp(0.5 * (least - nis[k]))
    weights /= weights.sum()
    P[:] = joseph(P, K, H, R)
    return innovation, S, nis_of(innovation, S)


@njit(cache=True, error_model="numpy")
def resample(particles, weights, sampled, counter):  # type: ignore[no-untyped-def]
    """Systematic resampling, then a kernel (Liu and West, 2001), once weights have come to rest on half of them.

    The kernel keeps mean and covariance of the sampled states; the others follow as they did among the particles.
    In place; gives back the counter after that.
    """
    count, n = particles.shape
    if 2.0 * (1.0 / (weights @ weights)) > count:
        return np.uint64(counter)
    mean, cov = mixture(particles, weights, np.zeros((n, n)))
    slope, L = follow(cov, sampled)
    d = len(L)
    width = (4.0 / ((d + 2.0) * count)) ** (1.0 / (d + 4.0))
    shrink = np.sqrt(1.0 - width**2)
    old = particles.copy()
    at, total, u = 0, weights[0], uniform(counter)
    number = np.uint64(counter) + ONE
    drawn, step = np.empty(d), np.empty(d)
    for k in range(count):
        while (k + u) / count > total and at < count - 1:
            at += 1
            total += weights[at]
        for j in range(d):
            drawn[j] = normal(number)
            number += ONE + ONE
        for i in range(d):
            here = old[at, sampled[i]]
            step[i] = (shrink - 1.0) * (here - mean[sampled[i]])
            for j in range(i + 1):
                step[i] += width * L[i, j] * drawn[j]
        for j in range(n):
            particles[k, j] = old[at, j]
            for i in range(d):
                particles[k, j] += slope[j, i] * step[i]
    weights[:] = 1.0 / count
    return number
