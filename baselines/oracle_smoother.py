"""The oracle with hindsight: what all of a recording says about each instant of it, its future included.

A Rauch-Tung-Striebel pass (AIAA Journal 3, 1965) runs backwards over a second forward pass of the oracle's own filter.
The first pass has found out when the readings began to step and what leapt; the second lets it leap there and then.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import correct_one, forecast_one
from twinbench.baselines.jump_aware import watch
from twinbench.baselines.oracle import Oracle
from twinbench.machines.coordinates import Array
from twinbench.methods.estimator import State, register
from twinbench.methods.hindsight import Pass, empty_pass, look_back
from twinbench.methods.noise import input_sd, output_sd
from twinbench.methods.reporting import report
from twinbench.methods.shifts import LIMIT_SD, N_SUMS
from twinbench.methods.weighing import LEAP

NO_CAUSE = -1


@njit(cache=True, error_model="numpy")
def _began(sums, since, k):  # type: ignore[no-untyped-def]
    """Note in ``since`` (2, 2, ny) when each sum was last zero. Returns when the one nearest its limit began."""
    first, most = k, 0.0
    for i in range(N_SUMS):
        for side in range(2):
            for c in range(sums.shape[2]):
                if sums[i, side, c] == 0.0:
                    since[i, side, c] = k
                elif sums[i, side, c] / LIMIT_SD[i] > most:
                    first, most = since[i, side, c] + 1, sums[i, side, c] / LIMIT_SD[i]
    return first


@njit(cache=True, error_model="numpy")
def find_leaps(rhs, output, model, rules, z, P, started, jumps, read, cause, out, info):  # type: ignore[no-untyped-def]
    """Run the jump-aware filter over one machine's ticks; write what leapt when it began, and which outputs were out.

    The function takes plain arrays because it is compiled.

    Args:
        read: u_before, u, u_sd, measured, white and coloured sd, each (N, 1, ...).
        cause: (N,) of ``methods.weighing``, or NO_CAUSE.
        out: (N, ny) is 1 where an output is not believed.
    """
    u_before, u, u_sd, measured, white, coloured = read
    since, began = np.zeros(jumps.sums.shape[1:], np.int64), 0
    only = z.shape[0] - 1  # a plain 0 would be a type of its own, for which everything is compiled again
    for k in range(cause.size):
        weighed = jumps.left[0, 0] > 0
        suspect = _began(jumps.sums[0], since, k)
        now = u_before[k], u[k], u_sd[k], measured[k], white[k], coloured[k]
        decided = watch(rhs, output, model, rules, z, P, started, jumps, only, now, info)
        if jumps.left[0, 0] > 0 and not weighed:
            began = suspect
        if LEAP <= decided < LEAP + rules.leaps:
            cause[began] = decided
        for c in range(out.shape[1]):
            if decided >= LEAP + rules.leaps and jumps.out[0, c] >= rules.most_out - 1:
                out[began : k + 1, c] = 1
            if jumps.out[0, c] > 0:
                out[k, c] = 1


@njit(cache=True, error_model="numpy")
def forward(rhs, output, model, leap_sd, z, P, read, cause, out, kept):  # type: ignore[no-untyped-def]
    """The filter over one machine's ticks from z and P, with what is known to leap and to be out, into ``kept``.

    The function takes plain arrays because it is compiled.
    """
    u_before, u, u_sd, measured, white, coloured = read
    for k in range(cause.size):
        if k > 0:
            z, P, kept.F[k] = forecast_one(rhs, model, z, P, u_before[k, 0], u_sd[k, 0])
        if cause[k] >= 0:
            i = model.step.size + cause[k] - LEAP
            P[i, i] += leap_sd**2
        kept.ahead[k], kept.ahead_cov[k] = z, P
        z, P, _, _, _ = correct_one(output, model, z, P, u[k, 0], measured[k, 0], white[k, 0], coloured[k, 0], out[k])
        kept.z[k], kept.P[k] = z, P


@register
class OracleSmoother(Oracle):
    """What can be known of a machine afterwards by one who knows what the oracle knows.

    Its estimates look at the whole recording, so no filter is expected to reach them. Step by step, and in its
    forecasts, it is the oracle.
    """

    name = "oracle_smoother"
    says = "the oracle with hindsight: smoothed over the whole recording, its future included"
    two_sided = True

    def smooth(self, measured: Array, ticks: np.ndarray, delay_s: float = np.inf) -> State:
        """What a whole recording says about some of its ticks; machines are not in lockstep here, B x K stand in a row.

        Args:
            measured: (B, N, nu + ny) readings in the channels' units, inputs first; NaN means missing.
            ticks: (K,) positions in the recordings.
            delay_s: infinite seconds: it looks at the whole recording.

        Returns:
            State with B x K rows, the ticks of each machine together.

        Raises:
            ValueError: a finite delay.
        """
        if np.isfinite(delay_s):
            raise ValueError(f"{self.name} looks at the whole recording, not {delay_s:g} s ahead")
        filled, accepted, _ = self._front_end.run(measured)
        later, _, _ = self._front_end.run(measured, hindsight=True)
        z, P = [], []
        for b in range(len(measured)):
            kept = self._smoothed(filled[b], accepted[b], later[b])
            z.append(kept.z[ticks])
            P.append(kept.P[ticks])
        return report(self.machine.coordinates, np.concatenate(z), np.concatenate(P), self.reported(), ())

    def _smoothed(self, filled: Array, accepted: np.ndarray, later: Array) -> Pass:
        """Both passes over one machine's readings (N, nu + ny): as accepted, and as known one tick later."""
        inputs, outputs = slice(0, len(self.machine.inputs)), slice(len(self.machine.inputs), None)
        before = np.concatenate([later[:1], later[:-1]])
        measured = np.where(accepted, filled, np.nan)[:, outputs]
        sds = input_sd(self.machine, filled), *output_sd(self._sheet, filled)
        parts = before[:, inputs], filled[:, inputs], sds[0], measured, *sds[1:]
        read = tuple(np.ascontiguousarray(part[:, None]) for part in parts)
        samples = len(filled)
        cause, out = np.full(samples, NO_CAUSE), np.zeros((samples, measured.shape[1]), np.int64)
        info = self.blank_info(1)
        z, P = self.start(1)
        equations = self._rhs, self._output, self._model
        find_leaps(*equations, self.rules, z, P, np.zeros(1, np.bool_), self.unshaken(1), read, cause, out, info)
        kept = empty_pass(samples, self._size)
        z, P = self.start(1)
        forward(*equations, self.rules.leap, z[0], P[0], read, cause, out, kept)
        look_back(kept)
        return kept
