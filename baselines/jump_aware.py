"""An augmented extended Kalman filter that asks, after a sudden step of its readings, what leapt.

Health that steps leaves a random-walk filter wrong for minutes: it puts a step of capacity down to leakage, since both
lower the flow. Here Page's test watches the innovations. Where it fires, copies of the filter go on side by side for
some seconds. In one nothing happened, in others a health parameter leapt or a sensor failed. Each is weighed by how
well it foretells the readings (``methods.weighing``). Meanwhile the mixture is reported, and the likeliest is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import correct_one, forecast_one
from twinbench.baselines.model_ekf import ModelEKF
from twinbench.machines.coordinates import Array
from twinbench.methods.estimator import FLAG_GATED, Info, Sample, State
from twinbench.methods.frontend import Memory
from twinbench.methods.reporting import clean_flags
from twinbench.methods.shifts import forget, no_shifts, shifted
from twinbench.methods.weighing import (
    LEAP,
    causes_of,
    leap,
    likeliest,
    log_likelihood,
    mixture_into,
    probabilities,
)

REJOINS_SD, REJOINS_UPDATES = 2.0, 10
"""A failed output is believed again when it has been so near for so many updates. Nearer, or for longer, keeps it out
for longer after its fault has gone."""
MOST_OUT_S = 120.0
"""Then it is believed in any case: what it reads is how the machine is."""
UNSHAKEN_S = 30.0
"""At first the states find their place, and the readings surprise without cause: nothing is weighed. Less takes the
start for a leap, more misses a real one."""


class Rules(NamedTuple):
    """What is weighed, and for how long. K causes are: nothing, a leap of each health parameter, failures of outputs.

    Attributes:
        leap: how far health may leap, in zeta.
        weighed: updates for which causes are weighed.
        most_out: updates after which an output is believed in any case.
        causes: (K,) dimensionless places in ``methods.weighing``. That health goes back is among its leaps.
        leaps: how many of them, from the second on, are leaps.
        log_prior: (K,) dimensionless scores that they begin with.
        failed: (K, ny) dimensionless, which output fails under which cause.
    """

    leap: float
    weighed: int
    most_out: int
    causes: np.ndarray
    leaps: int
    log_prior: Array
    failed: np.ndarray


class Jumps(NamedTuple):
    """What is carried from tick to tick besides the filter, B machines.

    Attributes:
        sums: (B, 2, 2, ny) dimensionless, of Page's test.
        left: (B, 1) dimensionless: updates for which the causes are still weighed; negative: until the test begins.
        out: (B, ny) dimensionless: updates for which an output is still not believed.
        fits: (B, ny) dimensionless: updates in a row in which one of these fitted.
        scores: (B, K) dimensionless log scores of the causes.
        z: (B, K, n) their filters' means, in the units of z.
        P: (B, K, n, n) their covariances, in those units squared.
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
    for c in range(innovation.size):
        if not np.isnan(innovation[c]) and out[c] == 0 and shifted(sums, innovation[c], np.sqrt(S[c, c]), c):
            alarm = True
    return alarm


@njit(cache=True, error_model="numpy")
def _rejoin(out, fits, innovation, S):  # type: ignore[no-untyped-def]
    """One update less for outputs that are not believed, in place; none for those that fit again."""
    for c in range(innovation.size):
        if out[c] > 0 and not np.isnan(innovation[c]):
            fits[c] = fits[c] + 1 if abs(innovation[c]) < REJOINS_SD * np.sqrt(S[c, c]) else 0
            out[c] = 0 if fits[c] == REJOINS_UPDATES else out[c] - 1


@njit(cache=True, error_model="numpy")
def _part(rules, jumps, b, z, P, at):  # type: ignore[no-untyped-def]
    """Begin to weigh: a copy of the filter for every cause."""
    for k in range(rules.causes.size):
        jumps.scores[b, k] = rules.log_prior[k]
        jumps.z[b, k], jumps.P[b, k] = z, P
    for j in range(rules.leaps):
        leap(jumps.P[b, LEAP + j], at + j, rules.leap)


@njit(cache=True, error_model="numpy")
def _weigh(rhs, output, model, rules, jumps, b, u_before, u, u_sd, measured, white, coloured, weight):  # type: ignore[no-untyped-def]
    """Every cause's filter a tick on and its score, in place. Returns innovation, S and NIS of the likeliest.

    The function takes plain arrays because it is compiled.
    """
    count, ny = rules.failed.shape
    L, y = np.empty((ny, ny)), np.empty(ny)
    innovations, Ss, nis = np.empty((count, ny)), np.empty((count, ny, ny)), np.empty(count)
    for k in range(count):
        out = np.maximum(jumps.out[b], rules.failed[k])
        ahead, P, _ = forecast_one(rhs, model, jumps.z[b, k], jumps.P[b, k], u_before, u_sd)
        jumps.z[b, k], jumps.P[b, k], innovations[k], Ss[k], nis[k] = correct_one(
            output, model, ahead, P, u, measured, white, coloured, out
        )
        jumps.scores[b, k] += log_likelihood(innovations[k], Ss[k], out, L, y)
    probabilities(jumps.scores[b], weight)
    best = likeliest(jumps.scores[b])
    return innovations[best], Ss[best], nis[best]


@njit(cache=True, error_model="numpy")
def _decide(rules, jumps, b, z, P):  # type: ignore[no-untyped-def]
    """Keep the likeliest cause's filter, in z and P; an output that failed under it is not believed from now on."""
    best = likeliest(jumps.scores[b])
    z[:], P[:] = jumps.z[b, best], jumps.P[b, best]
    for c in range(rules.failed.shape[1]):
        forget(jumps.sums[b], c)
        if rules.failed[best, c] > 0:
            jumps.out[b, c], jumps.fits[b, c] = rules.most_out, 0
    return rules.causes[best]


@njit(cache=True, error_model="numpy")
def watch(rhs, output, model, rules, z, P, started, jumps, b, read, info):  # type: ignore[no-untyped-def]
    """Machine ``b`` a tick on, in place. Returns what was decided: a cause of ``methods.weighing``, -1 for no decision.

    The function takes plain arrays because it is compiled.

    Args:
        rules: what is weighed.
        read: u_before, u, u_sd, measured, white and coloured sd, as ``filter_inputs`` gives them.
        info: innovation (B, ny), S (B, ny, ny) and NIS (B,) are written here.
    """
    u_before, u, u_sd, measured, white, coloured = read
    innovation, S, nis = info
    at, decided = model.step.size, -1
    if jumps.left[b, 0] > 0:
        weight = np.empty(rules.causes.size)
        innovation[b], S[b], nis[b] = _weigh(
            rhs, output, model, rules, jumps, b, u_before[b], u[b], u_sd[b], measured[b], white[b], coloured[b], weight
        )
        mixture_into(weight, jumps.z[b], jumps.P[b], z[b], P[b])
        jumps.left[b, 0] -= 1
        if jumps.left[b, 0] == 0:
            decided = _decide(rules, jumps, b, z[b], P[b])
    else:
        if started[b]:
            z[b], P[b], _ = forecast_one(rhs, model, z[b], P[b], u_before[b], u_sd[b])
        z[b], P[b], innovation[b], S[b], nis[b] = correct_one(
            output, model, z[b], P[b], u[b], measured[b], white[b], coloured[b], jumps.out[b]
        )
        if jumps.left[b, 0] < 0:
            jumps.left[b, 0] += 1
        elif _alarm(jumps.sums[b], innovation[b], S[b], jumps.out[b]):
            _part(rules, jumps, b, z[b], P[b], at)
            jumps.left[b, 0] = rules.weighed
    _rejoin(jumps.out[b], jumps.fits[b], innovation[b], S[b])
    started[b] = True
    return decided


@njit(cache=True, error_model="numpy")
def _tick(rhs, output, model, rules, z, P, started, jumps, read, info):  # type: ignore[no-untyped-def]
    """All machines a tick on, in place."""
    for b in range(z.shape[0]):
        watch(rhs, output, model, rules, z, P, started, jumps, b, read, info)


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

    def restore(self) -> None:
        """As the base class, and what is weighed."""
        super().restore()
        causes, tick_s, leaps = causes_of(self.machine), self.machine.sample_period_s, len(self.machine.health)
        failed = np.zeros((causes.count, len(self.machine.outputs)), np.int64)
        failed[np.arange(causes.fails, causes.count), causes.failing] = 1
        weighed = np.delete(np.arange(causes.count), causes.back)
        self.rules = Rules(
            leap=float(self.config["leap"]),
            weighed=round(self.config["weighed_s"] / tick_s),
            most_out=round(MOST_OUT_S / tick_s),
            causes=weighed,
            leaps=leaps,
            log_prior=causes.log_prior[weighed],
            failed=failed[weighed],
        )

    def unshaken(self, batch: int) -> Jumps:
        """Nothing is weighed, all outputs are believed.

        Args:
            batch: how many machines, B.
        """
        n, (causes, ny) = self._size, self.rules.failed.shape
        return Jumps(
            np.tile(no_shifts(ny), (batch, 1, 1, 1)),
            np.full((batch, 1), -round(UNSHAKEN_S / self.machine.sample_period_s)),
            np.zeros((batch, ny), np.int64),
            np.zeros((batch, ny), np.int64),
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
        info = self.blank_info(len(z))
        _tick(self._rhs, self._output, self._model, self.rules, z, P, started, jumps, self.told(clean), info)
        accepted = clean.accepted[:, len(self.machine.inputs) :] & (jumps.out == 0)
        flags = clean_flags(clean) | np.where((jumps.out > 0).any(axis=1), FLAG_GATED, 0)
        reported = self._report(z, P, (started, *jumps, *after))
        return reported, Info(*info, accepted, flags, clean.age_s)
