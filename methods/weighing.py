"""What made the readings step? Causes are weighed against each other, each by a copy of the filter. Compiled.

A step of the readings may be the machine's or a sensor's. Which of them it is shows in what follows: each cause lets
the filter move in its own way, and foretells the next readings well or badly (Willsky and Jones, IEEE Trans. Autom.
Control 21, 1976: generalised likelihood ratio). Meanwhile the mixture of all copies is reported, as one Gaussian of the
same mean and covariance (Blom and Bar-Shalom, IEEE Trans. Autom. Control 33, 1988). At the end that goes on alone,
without the outputs that fail under the likeliest cause.

A filter that takes part copies itself once for every cause, calls ``leap`` on the copies whose health leaps, leaves out
the output that fails in others, and adds ``log_likelihood`` of every update to the cause's score, which begins at its
``log_prior``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine
from twinbench.methods.kalman import factorise

NOTHING, LEAP = 0, 1
"""Where the first causes stand: nothing happened; a health parameter leapt, one each from here on."""
NOTHING_SHARE = 0.5
"""Prior probability that nothing happened; the others share the rest alike. A thousand times more or less of it moves a
score by seven, which is what one or two readings that are clearly off say."""
MOST_SURPRISE = 16.0
"""Bound on the NIS of one update: three readings reach it by chance once in a thousand. More lets an outlier decide."""
FAILS_SD = 30.0
"""An output that fails reads anything within so many sd. More makes failures less likely: twice as much costs the score
.7 in every update."""


class Causes(NamedTuple):
    """What may make a machine's readings step, as compiled code takes it, too.

    Attributes:
        back: where it stands that health went back; the nh leaps stand before it.
        fails: where the failures of outputs stand, one each, from here on.
        count: how many causes there are.
        failing: (count - fails,) positions of the outputs that may fail. One whose bias is a health parameter does not:
            what its sensor does is that bias.
        log_prior: (count,) dimensionless log probabilities of the causes.
    """

    back: int
    fails: int
    count: int  # type: ignore[assignment]  # of a tuple it is a method
    failing: np.ndarray
    log_prior: Array


def causes_of(machine: Machine) -> Causes:
    """The causes of a machine, in this order: nothing, a leap each, health went back, a failure each."""
    failing = np.flatnonzero([not reading.bias for reading in machine.readings])
    back = LEAP + len(machine.health)
    count = back + 1 + len(failing)
    prior = np.full(count, (1.0 - NOTHING_SHARE) / (count - 1))
    prior[NOTHING] = NOTHING_SHARE
    return Causes(back, back + 1, count, failing, np.log(prior))


@njit(cache=True, error_model="numpy")
def log_likelihood(innovation, S, out, L, y):  # type: ignore[no-untyped-def]
    """Of one update under one cause, bounded, but for what all causes share.

    Args:
        innovation: (m,) in the outputs' units; NaN where missing, which is the same under every cause.
        S: (m, m) its covariance, in those units squared.
        out: (m,) positive for outputs that fail under this cause.
        L: (m, m) scratch.
        y: (m,) scratch.
    """
    m = 0
    for a in range(innovation.size):
        if np.isnan(innovation[a]):
            continue
        i = 0
        for b in range(a + 1):
            if not np.isnan(innovation[b]):
                L[m, i] = S[a, b]
                i += 1
        if out[a] > 0:
            L[m, m] += FAILS_SD**2 * S[a, a]
        y[m] = innovation[a]
        m += 1
    factorise(L, m)
    nis, log_det = 0.0, 0.0
    for i in range(m):
        for k in range(i):
            y[i] -= L[i, k] * y[k]
        y[i] /= L[i, i]
        nis += y[i] * y[i]
        log_det += 2.0 * np.log(L[i, i])
    return -0.5 * (min(nis, MOST_SURPRISE) + log_det)


@njit(cache=True, error_model="numpy")
def leap(P, k, size):  # type: ignore[no-untyped-def]
    """Entry ``k`` of the state may have leapt by ``size`` sd in its unit: its variance grows, in P (n, n) in place."""
    P[k, k] += size * size


@njit(cache=True, error_model="numpy")
def likeliest(scores):  # type: ignore[no-untyped-def]
    """Which cause (k,) of log scores has the highest."""
    best = 0
    for k in range(scores.size):
        if scores[k] > scores[best]:
            best = k
    return best


@njit(cache=True, error_model="numpy")
def probabilities(scores, out):  # type: ignore[no-untyped-def]
    """Of the causes (k,), from their log scores, into ``out`` (k,); they add up to one."""
    most, total = scores[likeliest(scores)], 0.0
    for k in range(scores.size):
        out[k] = np.exp(scores[k] - most)
        total += out[k]
    for k in range(scores.size):
        out[k] /= total


@njit(cache=True, error_model="numpy")
def mixture_into(weight, means, covs, mean, cov):  # type: ignore[no-untyped-def]
    """Mean and covariance of a mixture of Gaussians, into ``mean`` (n,) and ``cov`` (n, n).

    Args:
        weight: (k,) dimensionless, which add up to one.
        means: (k, n) each in its state's unit.
        covs: (k, n, n) in those units squared.
    """
    n = mean.size
    for i in range(n):
        mean[i] = 0.0
        for k in range(weight.size):
            mean[i] += weight[k] * means[k, i]
        for j in range(n):
            cov[i, j] = 0.0
    for k in range(weight.size):
        for i in range(n):
            for j in range(n):
                off = (means[k, i] - mean[i]) * (means[k, j] - mean[j])
                cov[i, j] += weight[k] * (covs[k, i, j] + off)
