"""Ensemble Kalman filter with the recalibrated nominal model, in its deterministic form.

The ensemble begins with exactly the prior's moments (Pham, 2001), takes up process noise by a square root (Raanes et
al., 2015), and is corrected one reading at a time without perturbed readings (Whitaker and Hamill, 2002). Nothing is
drawn: the same readings give the same estimates, and on a linear machine it is the Kalman filter for any ensemble with
more members than states. So it needs neither inflation nor localisation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import REST, bound, linearise
from twinbench.baselines.nominal_filter import NominalFilter, advance, nis_of, read
from twinbench.machines.coordinates import Array
from twinbench.methods.estimator import register
from twinbench.methods.kalman import INNOVATION_CLIP_SD, bounded, factorise

MEMBERS = 64
"""Members of the ensemble: more than twice as many as states, so that its moments hold where the model bends; more cost
time in proportion and change little."""


def begin(z: Array, P: Array) -> Array:
    """An ensemble (MEMBERS, n) with exactly these moments, the same each time.

    Args:
        z: (n,) its mean, in the units of z.
        P: (n, n) its covariance, in those units squared.
    """
    drawn = np.random.default_rng(0).normal(size=(MEMBERS, len(z) + 1))
    drawn[:, 0] = 1.0  # the others are made orthogonal to it: their mean is zero
    apart = np.linalg.qr(drawn)[0][:, 1:] * np.sqrt(MEMBERS - 1)
    values, vectors = np.linalg.eigh(P)
    return z + apart @ (vectors * np.sqrt(np.maximum(values, 0.0))).T


@njit(cache=True, error_model="numpy")
def moments_of(members):  # type: ignore[no-untyped-def]
    """Mean (n,) and covariance (n, n) of an ensemble (N, n)."""
    count, n = members.shape
    mean = np.zeros(n)
    for k in range(count):
        for j in range(n):
            mean[j] += members[k, j] / count
    apart = members - mean
    return mean, apart.T @ apart / (count - 1)


@njit(cache=True, error_model="numpy")
def take_up(members, Q):  # type: ignore[no-untyped-def]
    """Move an ensemble (N, n) apart, in place, until its covariance has grown by Q (n, n); its mean stays."""
    n = members.shape[1]
    mean, P = moments_of(members)
    narrow, wide = P + REST * Q, P + Q
    factorise(narrow, n)
    factorise(wide, n)
    unit = np.empty(n)
    for k in range(members.shape[0]):
        for i in range(n):
            unit[i] = members[k, i] - mean[i]
            for j in range(i):
                unit[i] -= narrow[i, j] * unit[j]
            unit[i] /= narrow[i, i]
        for i in range(n):
            members[k, i] = mean[i]
            for j in range(i + 1):
                members[k, i] += wide[i, j] * unit[j]


@njit(cache=True, error_model="numpy")
def _shift(members, shares, moves):  # type: ignore[no-untyped-def]
    """Move members (N, n), in place, along their regression on what ``shares`` (N,) weighs, each by its ``moves``."""
    count, n = members.shape
    slope = np.zeros(n)
    for k in range(count):
        for j in range(n):
            slope[j] += shares[k] * members[k, j]
    for k in range(count):
        for j in range(n):
            members[k, j] += moves[k] * slope[j]


@njit(cache=True, error_model="numpy")
def assimilate(members, readings, measured, variance, clip):  # type: ignore[no-untyped-def]
    """Correct an ensemble (N, n), in place, by the measurements that are there, one after the other.

    Args:
        members: (N, n), in the filter's coordinates.
        readings: (N, m), what each member would read, in the sensors' units; changed in place.
        measured: (m,) in the same units; NaN means missing.
        variance: (m,) of the measurement noise, those units squared.
        clip: innovations are bounded to this many standard deviations.

    Returns:
        Innovation (m,), S (m, m), NIS over the channels that are there.
    """
    count, m = readings.shape
    expected, S = moments_of(readings)
    S += np.diag(variance)
    innovation = measured - expected
    wanted = expected + bounded(innovation, S, clip)
    for i in range(m):
        if np.isnan(innovation[i]):
            continue
        at, apart = 0.0, readings[:, i].copy()
        for k in range(count):
            at += apart[k] / count
        for k in range(count):
            apart[k] -= at
        spread = (apart @ apart) / (count - 1)
        total = spread + variance[i]
        if not total > 0.0:  # a reading of zero has no noise: what all members foretell exactly tells them nothing
            continue
        # What is left of the spread of a reading after it is known: the square root of the Kalman gain's share.
        reduced = 1.0 / (1.0 + np.sqrt(variance[i] / total))
        _shift(members, apart / ((count - 1) * total), wanted[i] - at - reduced * apart)
        _shift(readings, apart / ((count - 1) * total), wanted[i] - at - reduced * apart)
    return innovation, S, nis_of(innovation, S)


@njit(cache=True, error_model="numpy")
def _tick(rhs, output, model, z, P, started, ensembles, told, info):  # type: ignore[no-untyped-def]
    before, now, u_sd, measured, white, coloured = told
    readings = np.empty((ensembles.shape[1], measured.shape[1]))
    for b in range(z.shape[0]):
        members = ensembles[b]
        if started[b]:
            _, _, Q = linearise(rhs, model, z[b], before[b], u_sd[b])
            for k in range(members.shape[0]):
                members[k] = advance(rhs, model, members[k], before[b])
            take_up(members, Q)
        for k in range(members.shape[0]):
            readings[k] = read(output, model, members[k], now[b], coloured[b])
        info[0][b], info[1][b], info[2][b] = assimilate(
            members, readings, measured[b], white[b] ** 2, INNOVATION_CLIP_SD
        )
        for k in range(members.shape[0]):
            bound(model, members[k])
        z[b], P[b] = moments_of(members)


@register
class NominalEnKF(NominalFilter):
    """What the same engineer would run who follows 64 machines instead of one and its Jacobians."""

    name = "nominal_enkf"
    says = "deterministic ensemble Kalman filter with the recalibrated reduced-order model"
    settings: ClassVar[dict[str, Any]] = {
        **NominalFilter.settings,
        "health_walk": 0.643,
        "state_walk": 27.06,
        "slow_error": 2.642,
    }

    def fresh(self, z: Array, P: Array) -> tuple[np.ndarray, ...]:
        """An ensemble of each machine."""
        return (np.tile(begin(z[0], P[0]), (len(z), 1, 1)),)

    def tick(
        self,
        z: Array,
        P: Array,
        started: np.ndarray,
        own: tuple[np.ndarray, ...],
        told: tuple[Array, ...],
        info: tuple[Array, ...],
    ) -> tuple[np.ndarray, ...]:
        """Move every member, part them by the process noise, correct them."""
        ensembles = own[0].copy()
        _tick(self._rhs, self._output, self._model, z, P, started, ensembles, told, info)
        return (ensembles,)

    @staticmethod
    def toy_filter(
        F: Array, H: Array, Q: Array, R: Array, x0: Array, P0: Array
    ) -> Callable[[Array], tuple[Array, Array]]:
        """The ensemble on a linear machine.

        Args:
            F: (n, n) how a tick moves the state, in the states' units.
            H: (m, n) slope of the readings, a sensor's unit per unit of the state.
            Q: (n, n) covariance of a tick's process noise, in the states' units squared.
            R: (m, m) covariance of the measurement noise, in the sensors' units squared; diagonal.
            x0: (n,) mean before the first prediction, each in its state's unit.
            P0: (n, n) covariance before the first prediction, in the states' units squared.
        """

        def run(measured: Array) -> tuple[Array, Array]:
            members = begin(x0, P0)
            means, covs = np.empty((len(measured), len(x0))), np.empty((len(measured), *P0.shape))
            for k, y in enumerate(measured):
                members = np.ascontiguousarray(members @ F.T)
                take_up(members, Q)
                assimilate(members, np.ascontiguousarray(members @ H.T), y, np.diag(R).copy(), np.inf)
                means[k], covs[k] = moments_of(members)
            return means, covs

        return run
