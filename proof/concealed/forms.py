"""What the catalogue offers and no truth is drawn for: its own forms, run on the twin at the truth's constants.

Whoever names an effect may name any of these instead, so the ideal observer has to tell the effect from them too.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.machine import Machine as Twin
from twinbench.mismatch.machine import Setting
from twinbench.mismatch.model import whole_catalogue
from twinbench.mismatch.tracks import Track
from twinbench.mismatch.variants import Variant, switched, typical, variants
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.severity import Take, Yardstick
from twinbench.proof.twins import simulator_of

PROBED = 0.5
"""Severity near which a candidate's column is taken: that of what it may stand for."""
PROBED_FACTOR = 30.0
"""A form's size is changed by this factor at most, up or down, to come near that severity."""


class Form(NamedTuple):
    """A name of the catalogue with one trial shape.

    Attributes:
        columns: (ny, N) per take, changes of its readings in the channels' units; zero where it is held out.
        severity: of that change, in training.
    """

    name: str
    columns: tuple[Array, ...]
    severity: float


def forms(yardstick: Yardstick, covered: Collection[str], onset_s: float) -> list[Form]:
    """The forms of a machine's catalogue but for those names that have a truth or a fault of their own.

    Args:
        yardstick: the case's takes on its machine without effects and background.
        covered: names that are looked at by truth's own equations.
        onset_s: forms act from here on, on the suite's clock.
    """
    machine = yardstick.machine
    own = dict(zip(machine.parameters, yardstick.p, strict=True))
    simulator = simulator_of(machine.simulator, machine.network)
    simulator = simulator.with_values(**dict(machine.values) | {name: own[name] for name in machine.calibrate})
    run = _Run(yardstick, Twin(simulator, whole_catalogue(simulator, (), machine.period_s)), onset_s)
    found = []
    for variant in variants(run.twin.candidates):
        name = run.twin.candidates[variant.candidate].name
        if name not in covered:
            columns, severity = run.probed(variant)
            if severity > 0.0:
                found.append(Form(name, columns, severity))
    return found


class _Run:
    """The twin over the takes that may be learnt from."""

    def __init__(self, yardstick: Yardstick, twin: Twin, onset_s: float) -> None:
        self._yardstick, self.twin, self._onset_s = yardstick, twin, onset_s
        pairs = enumerate(zip(yardstick.takes, yardstick.base, strict=True))
        self._tracks = {i: self._track(take, y) for i, (take, y) in pairs if not take.held_out}
        self._shortest = min(self._tracks, key=lambda i: len(self._tracks[i].time_s))
        twin.settle_step(list(self._tracks.values()), yardstick.machine.sigma())
        self._quiet = {i: self._readings(i, twin.theta) for i in self._tracks}

    def probed(self, variant: Variant) -> tuple[tuple[Array, ...], float]:
        """A form's columns and severity; severity 0 where it does nothing, or where the twin cannot run with it."""
        size = typical(self.twin.candidates[variant.candidate])
        columns, severity = self._at(variant, size, [self._shortest])
        if severity == 0.0:
            return columns, severity
        return self._at(
            variant, size * np.clip(PROBED / severity, 1.0 / PROBED_FACTOR, PROBED_FACTOR), list(self._tracks)
        )

    def _at(self, variant: Variant, size: float, takes: Sequence[int]) -> tuple[tuple[Array, ...], float]:
        candidate, base = self.twin.candidates[variant.candidate], self._yardstick.base
        first, null = candidate.mechanism.parameters[0], candidate.null[0]
        size = float(np.clip(null + size, first.low, first.high) - null)
        theta = switched(self.twin, self.twin.theta, variant, size)
        columns = [np.zeros(y.T.shape) for y in base]
        for i in takes:
            columns[i] = (self._readings(i, theta) - self._quiet[i]).T
        if not all(np.isfinite(column).all() for column in columns):
            return tuple(columns), 0.0
        changed = [y + column.T for y, column in zip(base, columns, strict=True)]
        return tuple(columns), self._yardstick.measure(changed)[1]

    def _readings(self, i: int, theta: Array) -> Array:
        track = self._tracks[i]
        return self.twin.run(Setting(track, theta, self.twin.start(track), since_s=self._onset_s))

    def _track(self, take: Take, y: Array) -> Track:
        time_s = np.asarray(take.start_s + np.arange(len(y)) * self._yardstick.machine.period_s, dtype=np.float64)
        return Track(take.name, time_s, np.ascontiguousarray(take.u), y, np.arange(len(y)), y)
