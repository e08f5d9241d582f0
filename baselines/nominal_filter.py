"""What the filters of the recalibrated nominal model share: a tick's bookkeeping, and how a point of z moves and reads.

They differ from the nominal EKF in how they follow the distribution, and in nothing else: model, noise, prior, front
end and tuning are the same.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import bound, drift_of, move, parameters, true_inputs
from twinbench.baselines.nominal_ekf import NominalEKF
from twinbench.machines.coordinates import Array
from twinbench.methods.estimator import Info, Sample, State
from twinbench.methods.frontend import Memory
from twinbench.methods.kalman import factorise
from twinbench.methods.reporting import clean_flags


@njit(cache=True, error_model="numpy")
def advance(rhs, model, z, u):  # type: ignore[no-untyped-def]
    """The point z (n,), put within the model's bounds in place, a tick on at its own health; inputs u (nu,) as read."""
    bound(model, z)
    theta, _ = parameters(model, z)
    after = move(rhs, model, z, true_inputs(model, z, u), theta)
    for value in after:
        if not np.isfinite(value):  # of absurd readings the equations may make no number: the point stays
            return z.copy()
    return after


@njit(cache=True, error_model="numpy")
def read(output, model, z, u, coloured_sd):  # type: ignore[no-untyped-def]
    """What the outputs (ny,) read at the point z (n,) under inputs u (nu,) as read, but for white noise."""
    nx = model.step.size
    noise = nx + model.health.size
    theta, _ = parameters(model, z)
    y = output(z[:nx].copy(), true_inputs(model, z, u), theta)
    for i in range(y.size):
        if model.output_drift[i] != 0.0:
            y[i] *= 1.0 + model.output_drift[i] * z[drift_of(model)]
        y[i] += coloured_sd[i] * z[noise + i]
    return y


@njit(cache=True, error_model="numpy")
def nis_of(innovation, S):  # type: ignore[no-untyped-def]
    """NIS over the channels of the innovation (m,) that are not NaN, with S (m, m); NaN if none is."""
    there = np.flatnonzero(~np.isnan(innovation))
    if there.size == 0:
        return np.nan
    L, r = np.empty((there.size, there.size)), np.empty(there.size)
    for i in range(there.size):
        for k in range(there.size):
            L[i, k] = S[there[i], there[k]]
    factorise(L, there.size)
    nis = 0.0
    for i in range(there.size):
        r[i] = innovation[there[i]]
        for k in range(i):
            r[i] -= L[i, k] * r[k]
        r[i] /= L[i, i]
        nis += r[i] ** 2
    return nis


class NominalFilter(NominalEKF):
    """Base of the other filters of the nominal model; a subclass gives ``tick``, and ``fresh`` if it carries more."""

    implementations: ClassVar[tuple[str, ...]] = ("compiled",)
    settings: ClassVar[dict[str, Any]] = {k: v for k, v in NominalEKF.settings.items() if k != "implementation"}

    def fresh(self, z: Array, P: Array) -> tuple[np.ndarray, ...]:
        """What is carried besides z and P, before the first sample; every shape (B, ...).

        Args:
            z: (B, n) mean of the prior, in the units of z.
            P: (B, n, n) its covariance, in those units squared.
        """
        return ()

    def tick(
        self,
        z: Array,
        P: Array,
        started: np.ndarray,
        own: tuple[np.ndarray, ...],
        told: tuple[Array, ...],
        info: tuple[Array, ...],
    ) -> tuple[np.ndarray, ...]:
        """One tick of B machines, written into z, P and info; gives back what is carried.

        Args:
            z: (B, n) mean in the filter's coordinates: states in their units, health as dimensionless zeta.
            P: (B, n, n) its covariance, in those units squared.
            started: (B,) bool, was there a tick before?
            own: every shape (B, ...), in units of its own: what ``fresh`` or the tick before gave; it is not changed.
            told: what ``filter_inputs`` gives, (B, nu) of inputs and (B, ny) of outputs, in the channels' units.
            info: innovation (B, ny), S (B, ny, ny) and NIS (B,), are written, in the outputs' units.
        """
        raise NotImplementedError

    def init(self, batch: int) -> State:
        """As the nominal EKF, with what is carried besides."""
        z, P, started, *front = super().init(batch).memory
        return self._report(z, P, (started, *self.fresh(z, P), *front))

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """The front end, then ``tick``."""
        cut = len(state.memory) - len(Memory._fields)
        z, P, started, *own = state.memory[:cut]
        front, clean = self._front_end.step(Memory(*state.memory[cut:]), sample.measured)
        z, P = z.copy(), P.copy()
        info = self.blank_info(len(z))
        carried = self.tick(z, P, started, tuple(own), self.told(clean), info)
        reported = self._report(z, P, (np.ones_like(started), *carried, *front))
        return reported, Info(*info, clean.accepted[:, len(self.machine.inputs) :], clean_flags(clean), clean.age_s)
