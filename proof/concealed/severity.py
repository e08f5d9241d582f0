"""How large an effect is where it counts: what calibration cannot absorb, in noise sigmas.

An effect changes readings by (readings with it - readings without it) / sigma. All that the twin can absorb is
taken out of that. The rms of what is left, over samples and channels, is computed twice, and severity s is the
smaller of the two:

- in the training recordings: after a linear least-squares fit of the twin's calibratable parameters (with a
  prior as wide as they are off) and of the start values of slow states, one set per recording;
- in the held-out recordings: after the same parameters, not fitted again, and their own start values.

sigma is the sd of a channel's noise, white and coloured parts together. The smaller of the two, because an
effect that shows in the other regime alone cannot be found where the engine looks. A calibrated twin thus has
a held-out rms error of at least sqrt(1 + s^2) sigma: 1.0005, 1.005, 1.04 and 1.41 sigma at severities 0.03,
0.1, 0.3 and 1. Each effect is measured by itself, on the truth's own parameters, without background.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from twinbench.physics.simulator import Array
from twinbench.proof.concealed.integrate import Parameters, Steps, run
from twinbench.proof.concealed.machine import Machine
from twinbench.proof.concealed.tangent import SMALL_SHARE, Tangent

THIN = 4
SEVERITY_STEPS, SEVERITY_TOLERANCE = 8, 0.03


@dataclass(frozen=True)
class Take:
    """One recording to be made: when, under which inputs.

    Attributes:
        start_s: on the suite's clock.
        u: (N, nu) inputs in their units.
    """

    name: str
    start_s: float
    u: Array

    @property
    def held_out(self) -> bool:
        return self.name.startswith("held")


def readings(machine: Machine, take: Take, u: Array, x0: Array, parameters: Parameters, substeps: int) -> Array:
    """Clean readings (N, ny) of one take under inputs u (N, nu) from the state x0 (nx,).

    Args:
        u: (N, nu) inputs in their units.
        x0: (nx,) each state in its unit, at the first sample.
    """
    through = machine.driven(u, parameters, take.start_s)
    return run(machine.equations, Steps(take.start_s, machine.period_s, substeps), through, x0, parameters)[0]


class Yardstick:
    """Measures changes of a machine's readings over its takes.

    Args:
        machine: that is measured.
        takes: its recordings.
        p: (n_parameters,) the truth's own, each in its unit.

    Attributes:
        base: (N, ny) readings of each take, in the channels' units.
        tangents: the linearisation of each take.
        parameters: (K, ny, N) for each take, what one spread of each of the twin's parameters does.
    """

    def __init__(self, machine: Machine, takes: Sequence[Take], p: Array) -> None:
        self.machine, self.takes, self.p = machine, tuple(takes), p
        self.sigma = machine.sigma()
        self.starts = [machine.settled(t.u, p, t.start_s) for t in takes]
        self.base = [self._run(t, t.u, x, p) for t, x in zip(takes, self.starts, strict=True)]
        pairs = list(zip(takes, self.starts, strict=True))
        self.tangents = [Tangent(machine.equations, self._steps(t), t.u, x, p) for t, x in pairs]
        self.parameters = [self._by_parameters(tangent) for tangent in self.tangents]
        self._own = [self._thinned(columns) for columns in self.parameters]
        self._free = [self._thinned(self._by_starts(tangent)) for tangent in self.tangents]
        self._train = [i for i, t in enumerate(self.takes) if not t.held_out]
        self._columns = self._of_training()
        self._solved = np.linalg.pinv(np.concatenate([self._columns, np.eye(self._n_own, self._columns.shape[1])]))
        self._free_solved = [np.linalg.pinv(free) for free in self._free]

    def with_parameters(self, after: Array, onset_s: float = -np.inf) -> list[Array]:
        """Readings of every take with parameters ``after`` from ``onset_s`` on.

        Args:
            after: (n_parameters,) the law's own, each in its unit.
        """
        machine = self.machine
        made = []
        for take in self.takes:
            before = self.p if take.start_s < onset_s else after
            x0 = machine.settled(take.u, before, take.start_s)
            made.append(readings(machine, take, take.u, x0, Parameters(self.p, after, onset_s), machine.coarse))
        return made

    def with_inputs(self, inputs: Sequence[Array]) -> list[Array]:
        """Readings of every take had the inputs been others, and had it settled under them.

        Args:
            inputs: (N, nu) per take, in the inputs' units.
        """
        pairs = zip(self.takes, inputs, strict=True)
        return [self._run(t, u, self.machine.settled(u, self.p, t.start_s), self.p) for t, u in pairs]

    def measure(self, changed: Sequence[Array]) -> tuple[float, float]:
        """The two rms values, held-out and training, of readings that became ``changed``.

        Args:
            changed: (N, ny) per take, in the channels' units.
        """
        change = [self._whole(c - b) for c, b in zip(changed, self.base, strict=True)]
        target = np.concatenate([*(change[i] for i in self._train), np.zeros(self._n_own)])
        fit = self._solved @ target
        left = target[: len(self._columns)] - self._columns @ fit
        beyond = []
        for i in (i for i, t in enumerate(self.takes) if t.held_out):
            rest = change[i] - self._own[i] @ fit[: self._n_own]
            beyond.append(rest - self._free[i] @ (self._free_solved[i] @ rest))
        return _rms(np.concatenate(beyond)), _rms(left)

    @property
    def _n_own(self) -> int:
        return int(self._own[0].shape[1])

    def _of_training(self) -> Array:
        """All training recordings one below the other: parameters, one spread a column, then starts."""
        n_own, n_free = self._n_own, self._free[0].shape[1]
        columns = np.zeros((sum(len(self._own[i]) for i in self._train), n_own + n_free * len(self._train)))
        row = 0
        for j, i in enumerate(self._train):
            rows = slice(row, row + len(self._own[i]))
            columns[rows, :n_own] = self._own[i]
            columns[rows, n_own + j * n_free : n_own + (j + 1) * n_free] = self._free[i]
            row = rows.stop
        return columns

    def scale(
        self, change: Callable[[float], Sequence[Array]], start: float, most: float, wanted: float
    ) -> tuple[float, float, float]:
        """Find the amplitude at which ``change(amplitude)`` has the wanted severity.

        Returns:
            The amplitude (at most ``most``), and its rms held out and in training: those that came closest.
        """
        amplitude, tried = start, []
        for _ in range(SEVERITY_STEPS):
            beyond, in_training = self.measure(change(amplitude))
            # A machine that runs away has far too much of it.
            reached = max(min(beyond, in_training), 1e-3 * wanted) if np.isfinite(beyond + in_training) else np.inf
            tried.append((abs(np.log(reached / wanted)), amplitude, beyond, in_training))
            if abs(reached / wanted - 1.0) < SEVERITY_TOLERANCE or (amplitude == most and reached < wanted):
                break
            amplitude = float(np.clip(amplitude * wanted / reached, amplitude / 30.0, most))
        # More of an effect may show less: an empty tank cannot leak.
        _, amplitude, beyond, in_training = min(tried)
        return amplitude, beyond, in_training

    def _steps(self, take: Take) -> Steps:
        return Steps(take.start_s, self.machine.period_s, self.machine.coarse)

    def _by_parameters(self, tangent: Tangent) -> Array:
        """What one spread of each parameter does, (K, ny, N)."""
        machine, moved = self.machine, []
        for name in machine.calibrate:
            moved.append(self.p.copy())
            moved[-1][machine.at(name)] += SMALL_SHARE * self.step(name)
        count = len(moved)
        forces = tangent.forces(np.array(moved), np.full(count, SMALL_SHARE))
        return tangent.driven(forces, np.arange(count), np.ones((len(tangent.states), count)), settled=0)

    def _by_starts(self, tangent: Tangent) -> Array:
        """What the start of each slow state does, (K, ny, N)."""
        changes = np.zeros((tangent.states.shape[1], len(self.machine.slow)))
        changes[list(self.machine.slow), np.arange(len(self.machine.slow))] = list(self.machine.slow.values())
        return tangent.starts(changes)

    def _thinned(self, columns: Array) -> Array:
        """Columns (K, ny, N) as ``_whole`` has them, (n, K)."""
        thinned = (columns[:, :, ::THIN] / self.sigma[:, None]).transpose(2, 1, 0)
        return np.ascontiguousarray(thinned.reshape(thinned.shape[0] * thinned.shape[1], len(columns)))

    def _run(self, take: Take, u: Array, x0: Array, p: Array) -> Array:
        return readings(self.machine, take, u, x0, Parameters.steady(p), self.machine.coarse)

    def _whole(self, change: Array) -> Array:
        """(N, ny) to one whole vector in noise sigmas, thinned."""
        return (change[::THIN] / self.sigma).ravel()

    def step(self, name: str) -> float:
        """By how much a parameter is off at most, in its unit."""
        machine = self.machine
        if name in machine.offsets:
            return machine.offsets[name]
        return machine.spread.get(name, 0.15) * machine.parameters[name]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
