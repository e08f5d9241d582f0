"""How health and sensors change, as modes of a chain, and how the filters of all modes are mixed and weighed.

At any time health stands still, or one of its parameters ramps, or one leaps, or one output is erratic, or is off, or
has just been mended. Each mode has a filter of its own. Every tick they start from a mixture of each other, by the
chain, and are weighed by how likely each found the readings (interacting multiple models: Blom and Bar-Shalom, IEEE
Trans. Autom. Control 33, 1988). Compiled.

An output that fails tells its filter nothing. One that is erratic may read anything at every tick. One that is off
reads its noise around an offset, which is learnt. Its filter remembers the machine without that output for as long as a
failure lasts. So it is there when one has crept in, and an output that has been mended is compared with it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine
from twinbench.methods.kalman import factorise, predict_covariance, update
from twinbench.methods.noise import health_walk_var

STAY_S = (200.0, 300.0, 5.0)
"""How long health stands still, one of its parameters ramps, or one leaps, on average. A leap takes one tick, but shows
for seconds: one second errs by a tenth more on the two tanks, twenty no less. The others matter little."""
NEXT = np.array([[0.0, 0.7, 0.3], [0.7, 0.15, 0.15], [0.7, 0.3, 0.0]])
"""Dimensionless: which of them follows which. Ramps are commoner than leaps, and most end in standing still."""
FAILED_S, FAILS_EVERY_S = 60.0, 3600.0
"""How long an output fails, and how seldom each does in either way, on average. Ten times as seldom costs a failure
2.3 of its score: one reading that is clearly off."""
MOST_SURPRISE = 16.0
"""Bound on the NIS of one update: three readings reach it by chance once in a thousand. More lets an outlier decide."""
FAILS_SD = 30.0
"""An output that is erratic, or begins to be off, reads anything within so many sd. Twice as much costs a score .7."""
WANDERS_SD = 0.3
"""By how many sd of its noise the offset of an output that is off wanders in a second. With a third of it, or three
times as much, what health errs by after a drift or a bias of a sensor changes by 6 % at most."""
FAILS_FROM = 0.5
"""Probability from which an output is reported as failed. What is estimated does not depend on it."""
FARTHEST = 700.0
"""Squares of distances in sd beyond which a density stays as small as it is: in double precision it would be nought."""
NEGLIGIBLE = 1e-12
"""Share below which a mode adds nothing to a mixture, or noise to a reading: round-off is larger."""


class Modes(NamedTuple):
    """M modes: health stands still; a parameter ramps or leaps; an output is erratic, off or mended. One for each.

    Attributes:
        walk: (M, nh) dimensionless variances that a tick adds to the coordinates of health.
        out: (M, ny) dimensionless: 1 for an output that is not believed.
        turn: (M, M) dimensionless probabilities of going from one mode to another in a tick.
        pools, pool: ``pools_of`` of turn.
        lasts: (M,) dimensionless: 1 where an output is off by what it was a tick before, 0 where by anything.
        wander: dimensionless, of the variance of an output's noise: what a tick adds to that of its offset.
    """

    walk: Array
    out: Array
    turn: Array
    pools: Array
    pool: np.ndarray
    lasts: Array
    wander: float


class Failing(NamedTuple):
    """What the output reads that fails in a mode: noise around an offset.

    Attributes:
        offset: (2,) by how much it reads too high, in its unit, and the variance of that, in its unit squared.
        noise_var: (ny,) variance of all outputs' noise, in their units squared.
        wander: dimensionless, as in ``Modes``.
    """

    offset: Array
    noise_var: Array
    wander: float


def failing_of(machine: Machine) -> np.ndarray:
    """Positions of the outputs that may fail. One whose bias is a health parameter does not: that ramps or leaps."""
    return np.flatnonzero([not reading.bias for reading in machine.readings])


def count_of(machine: Machine) -> int:
    """How many modes a machine has."""
    return 1 + 2 * len(machine.health) + 3 * len(failing_of(machine))


def modes_of(machine: Machine, health_walk: float, still: float, leap: float) -> Modes:
    """The modes of a machine.

    Args:
        machine: whose.
        health_walk: dimensionless, of a parameter that ramps, times the walk of the machine's record.
        still: dimensionless, times that of one that ramps: the walk of one that stands still.
        leap: dimensionless sd of a leap, in the coordinates of health.
    """
    tick_s, parameters = machine.sample_period_s, len(machine.health)
    failing = failing_of(machine)
    ramp = health_walk_var(machine, health_walk)
    walk = np.tile(still**2 * ramp, (count_of(machine), 1))
    each = np.arange(parameters)
    walk[1 + each, each] = ramp
    walk[1 + parameters + each, each] = ramp + leap**2 * min(tick_s / STAY_S[-1], 1.0)
    out, lasts = np.zeros((len(walk), len(machine.outputs))), np.zeros(len(walk))
    erratic = 1 + 2 * parameters + np.arange(len(failing))
    off = erratic + len(failing)
    out[erratic, failing] = out[off, failing] = lasts[off] = 1.0
    turn = chain(parameters, len(failing), tick_s)
    return Modes(walk, out, turn, *pools_of(turn), lasts, WANDERS_SD**2 * tick_s)


def chain(parameters: int, failing: int, tick_s: float) -> Array:
    """Probabilities (M, M) of going from one mode to another in a tick.

    Args:
        parameters: of health.
        failing: outputs that may fail.
        tick_s: how long a tick is.
    """
    kind = np.repeat(range(len(STAY_S)), (1, parameters, parameters))
    leave = np.minimum(tick_s / np.array(STAY_S), 1.0)[kind]
    moving = slice(len(kind))
    fails, mended = slice(len(kind), len(kind) + 2 * failing), slice(len(kind) + 2 * failing, len(kind) + 3 * failing)
    turn = np.zeros((mended.stop,) * 2)
    turn[moving, moving] = leave[:, None] * NEXT[np.ix_(kind, kind)] / np.bincount(kind)[kind] + np.diag(1.0 - leave)
    begins, ends = min(tick_s / FAILS_EVERY_S, 0.25 / max(failing, 1)), min(tick_s / FAILED_S, 1.0)
    turn[moving] *= 1.0 - 2 * failing * begins
    turn[moving, fails] = begins
    turn[fails, fails] = (1.0 - ends) * np.eye(2 * failing)
    turn[fails, mended] = ends * np.tile(np.eye(failing), (2, 1))
    turn[mended, 0] = 1.0
    return turn


def pools_of(turn: Array) -> tuple[Array, np.ndarray]:
    """Modes that are come to alike from all others share a pool, so that it need be mixed once.

    Args:
        turn: (M, M) dimensionless probabilities of going from one mode to another in a tick.

    Returns:
        Dimensionless probabilities (G, M) of going from a mode to each of one pool's, and of which pool (M,) each is.
        What is on the diagonal of ``turn`` beyond these is staying.
    """
    pools: list[Array] = []
    pool, members = np.zeros(len(turn), np.int64), np.arange(len(turn))
    for j in members:
        for i in members[:j]:
            others = (members != i) & (members != j)
            if (turn[others, i] == turn[others, j]).all():
                pool[j] = pool[i]
                pools[pool[i]][i], pools[pool[i]][j] = turn[i, j], turn[j, i]
                break
        else:
            pool[j] = len(pools)
            pools.append(np.where(members == j, 0.0, turn[:, j]))
    return np.array(pools), pool


def at_first(modes: Modes) -> Array:
    """Probabilities (M,) before the first reading: those of the long run, two ticks after one at which no output fails.

    Two, since after one none has been mended, and a mode without any probability has no mixture to start from.

    Args:
        modes: of a machine.
    """
    mu = np.where(modes.out.any(axis=1), 0.0, in_the_long_run(modes.turn))
    return np.asarray(mu / mu.sum() @ modes.turn @ modes.turn)


def in_the_long_run(turn: Array) -> Array:
    """Probabilities (M,) of the modes of a chain that has gone on for long.

    Args:
        turn: (M, M) dimensionless probabilities of going from one mode to another in a tick.
    """
    return np.asarray(np.linalg.matrix_power(turn, 2**20)[0])


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
        failing: what the output reads that fails in it.
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
