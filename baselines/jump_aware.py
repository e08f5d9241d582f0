"""An augmented extended Kalman filter that asks, after a sudden step of its readings, what leapt.

Health that steps leaves a random-walk filter wrong for minutes: it puts a step of capacity down to leakage, since both
lower the flow. Here Page's test watches the innovations. Where it fires, copies of the filter go on side by side for
some seconds. In one nothing happened, in five a health parameter leapt, in two a sensor failed. Each is weighed by how
well it foretells the readings (``methods.weighing``). Meanwhile the mixture is reported, and the likeliest is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import N_HEALTH, N_NOISE, correct_one, forecast_one
from twinbench.baselines.model_ekf import ModelEKF, filter_inputs
from twinbench.data.batch import INPUTS, SAMPLE_PERIOD_S, Array
from twinbench.methods.estimator import FLAG_GATED, Info, Sample, State
from twinbench.methods.frontend import Memory
from twinbench.methods.reporting import clean_flags
from twinbench.methods.shifts import forget, no_shifts, shifted
from twinbench.methods.weighing import (
    FAILING,
    FAILS,
    LEAP,
    LOG_PRIOR,
    NOTHING,
    leap,
    likeliest,
    log_likelihood,
    mixture_into,
    probabilities,
)

CAUSES = np.array([NOTHING, *range(LEAP, LEAP + N_HEALTH), *range(FAILS, FAILS + len(FAILING))])
"""What is weighed, of the causes in ``methods.weighing``. That health goes back is among its leaps."""
FAILED = np.array(
    [[int(cause == FAILS + FAILING.index(i)) if i in FAILING else 0 for i in range(N_NOISE)] for cause in CAUSES]
)
"""(8, 3) which output fails under which cause."""
REJOINS_SD, REJOINS_UPDATES = 2.0, 10
"""A failed output is believed again when it has been so near for half a second. Nearer, or for longer, keeps it out
for longer after its fault has gone."""
MOST_OUT_UPDATES = 2400
"""After two minutes it is believed in any case: what it reads then is how the machine is."""

SETTLING_UPDATES = 600
"""For the first half minute the states find their place, and the readings surprise without cause: nothing is weighed.
Less takes the start for a leap, more misses a real one."""


class Jumps(NamedTuple):
    """What is carried from tick to tick besides the filter, B machines.

    Attributes:
        sums: (B, 2, 2, 3) dimensionless, of Page's test.
        left: (B, 1) dimensionless: updates for which the causes are still weighed; negative: until the test begins.
        out: (B, 3) dimensionless: updates for which an output is still not believed.
        fits: (B, 3) dimensionless: updates in a row in which one of these fitted.
        scores: (B, 8) dimensionless log scores of the causes.
        z: (B, 8, n) their filters' means, in the units of z.
        P: (B, 8, n, n) their covariances, in those units squared.
    """

    sums: Array
    left: np.ndarray
    out: np.ndarray
    fits: np.ndarray
    scores: Array
    z: Array
    P: Array


@njit(cache=True, error_model="numpy")
def _alarm(sums, innovation, S, out):  # type: ignore[no-untyped-def]
    """Did one of the outputs that are believed shift?"""
    alarm = False
    for c in range(N_NOISE):
        if not np.isnan(innovation[c]) and out[c] == 0 and shifted(sums, innovation[c], np.sqrt(S[c, c]), c):
            alarm = True
    return alarm


@njit(cache=True, error_model="numpy")
def _rejoin(out, fits, innovation, S):  # type: ignore[no-untyped-def]
    """One update less for outputs that are not believed, in place; none for those that fit again."""
    for c in range(N_NOISE):
        if out[c] > 0 and not np.isnan(innovation[c]):
            fits[c] = fits[c] + 1 if abs(innovation[c]) < REJOINS_SD * np.sqrt(S[c, c]) else 0
            out[c] = 0 if fits[c] == REJOINS_UPDATES else out[c] - 1


@njit(cache=True, error_model="numpy")
def _part(jumps, b, z, P, leap_sd, at):  # type: ignore[no-untyped-def]
    """Begin to weigh: a copy of the filter for every cause."""
    for k in range(CAUSES.size):
        jumps.scores[b, k] = LOG_PRIOR[CAUSES[k]]
        jumps.z[b, k], jumps.P[b, k] = z, P
        if LEAP <= CAUSES[k] < LEAP + N_HEALTH:
            leap(jumps.P[b, k], at + CAUSES[k] - LEAP, leap_sd)


@njit(cache=True, error_model="numpy")
def _weigh(rhs, output, model, jumps, b, u_before, u, u_sd, measured, white, coloured, weight):  # type: ignore[no-untyped-def]
    """Every cause's filter a tick on and its score, in place. Returns innovation, S and NIS of the likeliest.

    The function takes plain arrays because it is compiled.
    """
    L, y = np.empty((N_NOISE, N_NOISE)), np.empty(N_NOISE)
    innovations, Ss = np.empty((CAUSES.size, N_NOISE)), np.empty((CAUSES.size, N_NOISE, N_NOISE))
    nis = np.empty(CAUSES.size)
    for k in range(CAUSES.size):
        out = np.maximum(jumps.out[b], FAILED[k])
        ahead, P, _ = forecast_one(rhs, model, jumps.z[b, k], jumps.P[b, k], u_before, u_sd)
        jumps.z[b, k], jumps.P[b, k], innovations[k], Ss[k], nis[k] = correct_one(
            output, model, ahead, P, u, measured, white, coloured, out
        )
        jumps.scores[b, k] += log_likelihood(innovations[k], Ss[k], out, L, y)
    probabilities(jumps.scores[b], weight)
    best = likeliest(jumps.scores[b])
    return innovations[best], Ss[best], nis[best]


@njit(cache=True, error_model="numpy")
def _decide(jumps, b, z, P):  # type: ignore[no-untyped-def]
    """Keep the likeliest cause's filter, in z and P; an output that failed under it is not believed from now on."""
    best = likeliest(jumps.scores[b])
    z[:], P[:] = jumps.z[b, best], jumps.P[b, best]
    for c in range(N_NOISE):
        forget(jumps.sums[b], c)
        if FAILED[best, c] > 0:
            jumps.out[b, c], jumps.fits[b, c] = MOST_OUT_UPDATES, 0
    return CAUSES[best]


@njit(cache=True, error_model="numpy")
def watch(rhs, output, model, leaps, z, P, started, jumps, b, read, info):  # type: ignore[no-untyped-def]
    """Machine ``b`` a tick on, in place. Returns what was decided: a cause of ``methods.weighing``, -1 for no decision.

    The function takes plain arrays because it is compiled.

    Args:
        leaps: how far health may leap, in zeta, and for how many updates causes are weighed.
        read: u_before, u, u_sd, measured, white and coloured sd, as ``filter_inputs`` gives them.
        info: innovation (B, 3), S (B, 3, 3) and NIS (B,) are written here.
    """
    u_before, u, u_sd, measured, white, coloured = read
    innovation, S, nis = info
    at, decided = model.step.size, -1
    if jumps.left[b, 0] > 0:
        weight = np.empty(CAUSES.size)
        innovation[b], S[b], nis[b] = _weigh(
            rhs, output, model, jumps, b, u_before[b], u[b], u_sd[b], measured[b], white[b], coloured[b], weight
        )
        mixture_into(weight, jumps.z[b], jumps.P[b], z[b], P[b])
        jumps.left[b, 0] -= 1
        if jumps.left[b, 0] == 0:
            decided = _decide(jumps, b, z[b], P[b])
    else:
        if started[b]:
            z[b], P[b], _ = forecast_one(rhs, model, z[b], P[b], u_before[b], u_sd[b])
        z[b], P[b], innovation[b], S[b], nis[b] = correct_one(
            output, model, z[b], P[b], u[b], measured[b], white[b], coloured[b], jumps.out[b]
        )
        if jumps.left[b, 0] < 0:
            jumps.left[b, 0] += 1
        elif _alarm(jumps.sums[b], innovation[b], S[b], jumps.out[b]):
            _part(jumps, b, z[b], P[b], leaps[0], at)
            jumps.left[b, 0] = leaps[1]
    _rejoin(jumps.out[b], jumps.fits[b], innovation[b], S[b])
    started[b] = True
    return decided


@njit(cache=True, error_model="numpy")
def _tick(rhs, output, model, leaps, z, P, started, jumps, read, info):  # type: ignore[no-untyped-def]
    """All machines a tick on, in place."""
    for b in range(z.shape[0]):
        watch(rhs, output, model, leaps, z, P, started, jumps, b, read, info)


class JumpAwareEKF(ModelEKF):
    """A ``ModelEKF`` whose health may leap.

    ``leap`` is how far it may, in its coordinates zeta; ``weighed_s`` for how long causes are weighed.
    """

    settings: ClassVar[dict[str, Any]] = {
        **{name: value for name, value in ModelEKF.settings.items() if name != "implementation"},
        "leap": 3.0,
        "weighed_s": 10.0,
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {
        "health_walk": (0.5, 4.0),
        "state_walk": (0.03, 3.0),
        "leap": (1.0, 10.0),
    }
    online = ModelEKF.online | {"leap", "weighed_s"}

    @property
    def leaps(self) -> tuple[float, int]:
        """How far health may leap, in zeta, and for how many updates causes are weighed."""
        return float(self.config["leap"]), round(self.config["weighed_s"] / SAMPLE_PERIOD_S)

    def unshaken(self, batch: int) -> Jumps:
        """Nothing is weighed, all outputs are believed.

        Args:
            batch: how many machines, B.
        """
        n, causes = self._size, len(CAUSES)
        return Jumps(
            np.tile(no_shifts(N_NOISE), (batch, 1, 1, 1)),
            np.full((batch, 1), -SETTLING_UPDATES),
            np.zeros((batch, N_NOISE), np.int64),
            np.zeros((batch, N_NOISE), np.int64),
            np.zeros((batch, causes)),
            np.zeros((batch, causes, n)),
            np.zeros((batch, causes, n, n)),
        )

    def init(self, batch: int) -> State:
        """As the base class; nothing is weighed yet."""
        z, P = self.start(batch)
        memory = (np.zeros(batch, np.bool_), *self.unshaken(batch), *self._front_end.init(batch))
        return self._report(z, P, memory)

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """Predict by the model, correct by the outputs; where they step, weigh why."""
        z, P, started, *rest = state.memory
        jumps, front = Jumps(*(part.copy() for part in rest[: len(Jumps._fields)])), rest[len(Jumps._fields) :]
        after, clean = self._front_end.step(Memory(*front), sample.measured)
        z, P, started = z.copy(), P.copy(), started.copy()
        info = (np.empty((len(z), 3)), np.empty((len(z), 3, 3)), np.empty(len(z)))
        _tick(self._rhs, self._output, self._model, self.leaps, z, P, started, jumps, filter_inputs(clean), info)
        accepted = clean.accepted[:, len(INPUTS) :] & (jumps.out == 0)
        flags = clean_flags(clean) | np.where((jumps.out > 0).any(axis=1), FLAG_GATED, 0)
        reported = self._report(z, P, (started, *jumps, *after))
        return reported, Info(*info, accepted, flags, clean.age_s)
