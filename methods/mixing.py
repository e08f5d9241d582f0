"""How the filters of all modes are mixed before a tick and weighed after it. Compiled.

Each mode of ``methods.modes`` has a filter of its own. Every tick they start from a mixture of each other, by the
chain, and are weighed by how likely each found the readings (interacting multiple models: Blom and Bar-Shalom, IEEE
Trans. Autom. Control 33, 1988).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.machines.coordinates import Array
from twinbench.methods.kalman import factorise, predict_covariance, update
from twinbench.methods.modes import Modes, pools_of

MOST_SURPRISE = 16.0
"""Bound on the NIS of one update: three readings reach it by chance once in a thousand. More lets an outlier decide."""
FAILS_SD = 30.0
"""An output that is erratic, or begins to be off, reads anything within so many sd. Twice as much costs a score .7."""
FAILS_FROM = 0.5
"""Probability from which an output is reported as failed. What is estimated does not depend on it."""
FARTHEST = 700.0
"""Squares of distances in sd beyond which a density stays as small as it is: in double precision it would be nought."""
NEGLIGIBLE = 1e-12
"""Share below which a mode adds nothing to a mixture, or noise to a reading: round-off is larger."""


class Failing(NamedTuple):
    """What a failing output reads: noise around an offset.

    Attributes:
        offset: (2,) by how much it reads too high, in its unit, and the variance of that, in its unit squared.
        noise_var: (ny,) variance of all outputs' noise, in their units squared.
        wander: dimensionless, as in ``Modes``.
    """

    offset: Array
    noise_var: Array
    wander: float


@njit(cache=True, error_model="numpy")
def merge_into(weight, z, P, mean, cov):  # type: ignore[no-untyped-def]
    """Mean (n,) and covariance (n, n) of a mixture with weights (M,), means (M, n) and covariances (M, n, n)."""
    n = mean.size
    mean[:], cov[:] = 0.0, 0.0
    for i in range(weight.size):
        if weight[i] > NEGLIGIBLE:
            for a in range(n):
                mean[a] += weight[i] * z[i, a]
    for i in range(weight.size):
        if weight[i] > NEGLIGIBLE:
            for a in range(n):
                off = z[i, a] - mean[a]
                for b in range(a + 1):
                    cov[a, b] += weight[i] * (P[i, a, b] + off * (z[i, b] - mean[b]))
    for a in range(n):
        for b in range(a):
            cov[b, a] = cov[a, b]


@njit(cache=True, error_model="numpy")
def mix_into(mu, modes, z, P, room, mixed):  # type: ignore[no-untyped-def]
    """``mix`` written into ``mixed``; ``room`` is scratch: (M,), (n,) and (n, n).

    The function takes plain arrays because it is compiled.
    """
    weight, mean, cov = room
    ahead, stays, z_mixed, P_mixed = mixed
    for g in range(modes.pools.shape[0]):
        total = 0.0
        for i in range(mu.size):
            weight[i] = mu[i] * modes.pools[g, i]
            total += weight[i]
        for i in range(mu.size):
            weight[i] /= total
        merge_into(weight, z, P, mean, cov)
        for j in range(mu.size):
            if modes.pool[j] != g:
                continue
            own = mu[j] * (modes.turn[j, j] - modes.pools[g, j])
            ahead[j] = total + own
            stays[j] = own / ahead[j]
            come = 1.0 - stays[j]
            for a in range(mean.size):
                off = come * (z[j, a] - mean[a])
                z_mixed[j, a] = come * mean[a] + stays[j] * z[j, a]
                for b in range(mean.size):
                    apart = off * stays[j] * (z[j, b] - mean[b])
                    P_mixed[j, a, b] = come * cov[a, b] + stays[j] * P[j, a, b] + apart


@njit(cache=True, error_model="numpy")
def mix(mu, modes, z, P):  # type: ignore[no-untyped-def]
    """Each mode's start of a tick: its probability (M,), that it goes on (M,), mean (M, n) and covariance (M, n, n).

    Args:
        mu: (M,) probabilities of the modes at the tick before.
        modes: how they follow each other.
        z: (M, n) their means, in the filter's coordinates.
        P: (M, n, n) their covariances.
    """
    n = z.shape[1]
    mixed = np.empty_like(mu), np.empty_like(mu), np.empty_like(z), np.empty_like(P)
    mix_into(mu, modes, z, P, (np.empty_like(mu), np.empty(n), np.empty((n, n))), mixed)
    return mixed


@njit(cache=True, error_model="numpy")
def read_failing(failing, c, stays, innovation, S):  # type: ignore[no-untyped-def]
    """Output ``c`` is read while it fails: its offset is learnt, in place. Returns NIS and log variance.

    The failure goes on, or has just begun: NIS is twice the negative logarithm of both together.

    Args:
        stays: dimensionless probability that it goes on.
        innovation: in the output's unit, of a filter that does not use it.
        S: its variance, in that unit squared.
    """
    offset, noise = failing.offset, max(failing.noise_var[c], NEGLIGIBLE * S)  # a data sheet may promise none
    known, anything = offset[1] + failing.wander * noise, FAILS_SD**2 * S
    var = known + noise
    goes_on = stays * np.exp(-0.5 * min((innovation - offset[0]) ** 2 / var, FARTHEST))
    begins = (1.0 - stays) * np.sqrt(var / anything) * np.exp(-0.5 * min(innovation**2 / anything, FARTHEST))
    share = goes_on / (goes_on + begins)
    mean = offset[0] + known / var * (innovation - offset[0])
    off = innovation - mean  # one that has just begun is off by what it reads
    offset[0] = mean + (1.0 - share) * off
    offset[1] = share * known * noise / var + (1.0 - share) * noise + share * (1.0 - share) * off * off
    return -2.0 * np.log(goes_on + begins), np.log(var)


@njit(cache=True, error_model="numpy")
def log_likelihood(innovation, S, out, stays, failing, L, y):  # type: ignore[no-untyped-def]
    """Of one update under one mode, bounded, but for what all modes share. What an output is off by is learnt.

    Args:
        innovation: (m,) in the outputs' units; NaN where missing, which is the same under every mode.
        S: (m, m) its covariance, in those units squared.
        out: (m,) positive for outputs that fail under this mode.
        stays: dimensionless probability that the mode goes on from the tick before.
        failing: what the output that fails in it reads.
        L: (m, m) scratch.
        y: (m,) scratch.
    """
    m, nis, log_det = 0, 0.0, 0.0
    for a in range(innovation.size):
        if np.isnan(innovation[a]):
            continue
        if out[a] > 0:
            nis, log_det = read_failing(failing, a, stays, innovation[a], S[a, a])
            continue
        i = 0
        for b in range(a + 1):
            if not np.isnan(innovation[b]) and out[b] <= 0:
                L[m, i] = S[a, b]
                i += 1
        y[m] = innovation[a]
        m += 1
    factorise(L, m)
    for i in range(m):
        for k in range(i):
            y[i] -= L[i, k] * y[k]
        y[i] /= L[i, i]
        nis += y[i] * y[i]
        log_det += 2.0 * np.log(L[i, i])
    return -0.5 * (min(nis, MOST_SURPRISE) + log_det)


@njit(cache=True, error_model="numpy")
def follow_into(z, F, before, after, apart):  # type: ignore[no-untyped-def]
    """A mode's mean z (n,) a tick on, in place: the common mean goes from ``before`` to ``after``, and F says the rest.

    The function takes plain arrays because it is compiled.

    Args:
        F: (n, n) how a tick moves the state.
        apart: (n,) scratch.
    """
    for i in range(z.size):
        apart[i] = z[i] - before[i]
    for i in range(z.size):
        z[i] = after[i]
        for k in range(z.size):
            z[i] += F[i, k] * apart[k]


@njit(cache=True, error_model="numpy")
def failure(mu, out, c):  # type: ignore[no-untyped-def]
    """Probability that output ``c`` fails, from those of the modes (M,) and which of them it fails in (M, ny)."""
    total = 0.0
    for k in range(mu.size):
        total += mu[k] * out[k, c]
    return total


@njit(cache=True, error_model="numpy")
def weigh_into(ahead, score, mu):  # type: ignore[no-untyped-def]
    """Probabilities of the modes after the readings into mu (M,), from those before and the log scores (M,)."""
    most, total = score.max(), 0.0
    for j in range(mu.size):
        mu[j] = ahead[j] * np.exp(score[j] - most)
        total += mu[j]
    for j in range(mu.size):
        mu[j] /= total


@njit(cache=True, error_model="numpy")
def weigh_afterwards(mu, turn):  # type: ignore[no-untyped-def]
    """Probabilities (N, M) of the modes at N ticks, in place: each from all that followed, too.

    Kim, J. Econometrics 60, 1994.

    Args:
        mu: (N, M) dimensionless, after each tick's own readings.
        turn: (M, M) dimensionless, of going from one mode to another in a tick.
    """
    for k in range(mu.shape[0] - 2, -1, -1):
        mu[k] *= turn @ (mu[k + 1] / (mu[k] @ turn))
        mu[k] /= mu[k].sum()


def linear_modes(
    F: Array, H: Array, Q: Array, R: Array, x0: Array, P0: Array, turn: Array
) -> Callable[[Array], tuple[Array, Array]]:
    """These blocks on a linear-Gaussian machine whose process noise has modes, as ``methods.kalman.linear_filter``.

    Args:
        F: (n, n) how a tick moves the state, in the states' units.
        H: (m, n) slope of the readings, a sensor's unit per unit of the state.
        Q: (M, n, n) covariance of a tick's process noise in each mode, in the states' units squared.
        R: (m, m) covariance of the measurement noise, in the sensors' units squared.
        x0: (n,) mean before the first prediction, each in its state's unit.
        P0: (n, n) covariance before the first prediction, in the states' units squared.
        turn: (M, M) dimensionless probabilities of going from one mode to another in a tick.
    """
    count, m = len(Q), len(R)
    nothing, L, y = Failing(np.zeros(2), np.zeros(m), 0.0), np.empty((m, m)), np.empty(m)
    modes = Modes(Q, np.zeros((count, m)), turn, *pools_of(turn), np.zeros(count), 0.0)

    def run(measured: Array) -> tuple[Array, Array]:
        mu = np.full(count, 1.0 / count)
        z, P = np.repeat(x0[None], count, axis=0), np.repeat(P0[None], count, axis=0)
        means, covs = np.empty((len(measured), len(x0))), np.empty((len(measured), *P0.shape))
        for k, reading in enumerate(measured):
            mu, stays, z, P = mix(mu, modes, z, P)
            score = np.empty(count)
            for j in range(count):
                z[j], P[j] = F @ z[j], predict_covariance(P[j], F, Q[j])
                innovation = reading - H @ z[j]
                z[j], P[j], S, _ = update(z[j], P[j], innovation, H, R, np.inf)
                score[j] = log_likelihood(innovation, S, modes.out[j], stays[j], nothing, L, y)
            weigh_into(mu.copy(), score, mu)
            merge_into(mu, z, P, means[k], covs[k])
        return means, covs

    return run
