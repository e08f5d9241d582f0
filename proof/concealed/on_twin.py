"""A case's recordings as the twin would make them, at the truth's own constants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twinbench.mismatch.machine import Machine as Twin
from twinbench.mismatch.machine import Setting
from twinbench.mismatch.model import whole_catalogue
from twinbench.mismatch.steps import settle_step
from twinbench.mismatch.tracks import Track, block_seconds
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.severity import Take, Yardstick
from twinbench.proof.twins import simulator_of


class OnTwin:
    """The twin over the takes that may be learnt from.

    Args:
        yardstick: the case's takes on its machine without effects and background.
        onset_s: effects act from here on, on the suite's clock.

    Attributes:
        twin: with its whole catalogue, nothing of it there.
        tracks: by take, with the twin's own readings.
    """

    def __init__(self, yardstick: Yardstick, onset_s: float) -> None:
        machine = yardstick.machine
        own = dict(zip(machine.parameters, yardstick.p, strict=True))
        simulator = simulator_of(machine.simulator, machine.network)
        simulator = simulator.with_values(**dict(machine.values) | {name: own[name] for name in machine.calibrate})
        self.simulator = replace(simulator, calibrate=machine.calibrate, drifts=())
        self.twin = Twin(self.simulator, whole_catalogue(simulator, (), machine.period_s))
        self.yardstick, self.onset_s = yardstick, onset_s
        pairs = list(zip(yardstick.takes, yardstick.base, strict=True))
        learnt = [y for take, y in pairs if not take.held_out]
        block = round(block_seconds(learnt, [machine.period_s] * len(learnt)) / machine.period_s)
        given = {i: self._track(take, y, block) for i, (take, y) in enumerate(pairs) if not take.held_out}
        settle_step(self.twin, list(given.values()), machine.sigma())
        self.tracks = {i: t.reading(self.readings(t, self.twin.theta)) for i, t in given.items()}

    def readings(self, track: Track, theta: Array) -> Array:
        """(N, ny) in the outputs' units.

        Args:
            theta: (n_theta,) the twin's parameters, each in its unit.
        """
        return self.twin.run(Setting(track, theta, self.twin.start(track), since_s=self.onset_s))

    def _track(self, take: Take, y: Array, block: int) -> Track:
        time_s = np.asarray(take.start_s + np.arange(len(y)) * self.yardstick.machine.period_s, dtype=np.float64)
        starts = np.arange(0, len(y), block)
        return Track(take.name, time_s, np.ascontiguousarray(take.u), y, starts, y[starts]).reading(y)
