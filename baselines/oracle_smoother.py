"""The oracle with hindsight: what all of a recording says about each instant of it, its future included.

The oracle's own filter finds the modes' probabilities, and a pass back (Kim, J. Econometrics 60, 1994) what they were
in hindsight. From these follow the process noise of every tick and the outputs that failed. A second filter is given
both, and a Rauch-Tung-Striebel pass (AIAA Journal 3, 1965) runs back over it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.baselines.augmented_model import correct_one, forecast_one
from twinbench.baselines.modes_ekf import tick_modes
from twinbench.baselines.oracle import Oracle
from twinbench.machines.coordinates import Array
from twinbench.methods.estimator import State, register
from twinbench.methods.hindsight import Pass, empty_pass, look_back
from twinbench.methods.mixing import FAILS_FROM, weigh_afterwards
from twinbench.methods.noise import input_sd, output_sd
from twinbench.methods.reporting import report


@njit(cache=True, error_model="numpy")
def find_modes(rhs, output, model, modes, z, P, carried, read, mu, info):  # type: ignore[no-untyped-def]
    """Run the oracle's filter over one machine's ticks, and write the modes' probabilities in hindsight.

    The function takes plain arrays because it is compiled.

    Args:
        modes: as ``tick_modes`` takes them.
        read: u_before, u, u_sd, measured, white and coloured sd, each (N, 1, ...).
        mu: (N, M) dimensionless probabilities, written.
    """
    u_before, u, u_sd, measured, white, coloured = read
    started = np.zeros(1, np.bool_)
    for k in range(mu.shape[0]):
        now = u_before[k], u[k], u_sd[k], measured[k], white[k], coloured[k]
        tick_modes(rhs, output, model, modes, z, P, started, carried, now, info)
        mu[k] = carried[0][0]
    weigh_afterwards(mu, modes.turn)


@njit(cache=True, error_model="numpy")
def forward(rhs, output, model, Q, z, P, read, out, kept):  # type: ignore[no-untyped-def]
    """One filter over a machine's ticks from z and P, with the process noise and the failures of each, into ``kept``.

    The function takes plain arrays because it is compiled.

    Args:
        Q: (N, n, n) process noise that each tick adds to the model's, in the units of z squared.
        read: u_before, u, u_sd, measured, white and coloured sd, each (N, 1, ...).
        out: (N, ny) is 1 where an output is not believed.
    """
    u_before, u, u_sd, measured, white, coloured = read
    for k in range(out.shape[0]):
        if k > 0:
            z, P, kept.F[k] = forecast_one(rhs, model, z, P, u_before[k, 0], u_sd[k, 0])
            P += Q[k]
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
        equations = self._rhs, self._output, self._model
        z, P = self.start(1)
        mu = np.empty((len(filled), len(self._modes.turn)))
        find_modes(*equations, self._modes, z, P, self.undecided(z, P), read, mu, self.blank_info(1))
        out = (mu @ self._modes.out > FAILS_FROM).astype(float)
        kept = empty_pass(len(filled), self._size)
        z, P = self.start(1)
        forward(*equations, np.tensordot(mu, self._modes.walk, 1), z[0], P[0], read, out, kept)
        look_back(kept)
        return kept
