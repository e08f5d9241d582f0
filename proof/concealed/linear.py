"""What effects, faults and nuisances do to a case's readings, to first order along its runs without them.

An effect keeps its full size where it acts; what it moves is carried on linearly. That costs one step of the
equations a sample, where a run of its own costs its settling too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twinbench.data.scenario import stream
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.changes import series_with_fault
from twinbench.proof.concealed.integrate import Parameters
from twinbench.proof.concealed.machine import Effect, clock
from twinbench.proof.concealed.severity import Yardstick
from twinbench.proof.concealed.tangent import SMALL_SHARE

FEATURES = 24
"""Random frequencies of the ripple, each with sine and cosine: enough for a function of two arguments."""
START_STEP = 0.01
"""Step of a start that the twin need not find, as a share of the state and its unit."""


class Linear:
    """First-order changes of a yardstick's readings.

    Args:
        yardstick: the takes on a machine without effects and background.
        onset_s: effects begin here, on the suite's clock.
    """

    def __init__(self, yardstick: Yardstick, onset_s: float) -> None:
        self.yardstick, self.machine, self._onset_s = yardstick, yardstick.machine, onset_s
        self._settled = round(self.machine.settle_s / self.machine.period_s)

    def changes(self, wanted: Sequence[tuple[Effect, float]]) -> list[list[Array]]:
        """Of each effect or fault of a size: changes of all takes' readings, (ny, N) each."""
        sides = [self._side(effect) for effect, _ in wanted]
        found: list[list[Array]] = [[] for _ in wanted]
        by_side = {s: [i for i, side in enumerate(sides) if side == s] for s in ("law", "input", "output")}
        for i in by_side["output"]:
            found[i] = self._at_output(*wanted[i])
        for take in range(len(self.yardstick.tangents)):
            for side, made in (("law", self._by_law), ("input", self._by_input)):
                if by_side[side]:
                    columns = made(take, [wanted[i] for i in by_side[side]])
                    for i, column in zip(by_side[side], columns, strict=True):
                        found[i].append(column)
        return found

    def starts(self, take: int) -> Array:
        """One take's columns of its start states, a step each; (nx, ny, N)."""
        x0 = self.yardstick.starts[take]
        steps = [self.machine.slow.get(i, START_STEP * (abs(x) + 1.0)) for i, x in enumerate(x0)]
        return self.yardstick.tangents[take].starts(np.diag(steps))

    def nuisances(self, take: int, rippled: bool) -> Array:
        """One take's columns of the parameters, a spread each, the ambient's two phases, the ripple's features.

        Returns:
            (K, ny, N).
        """
        machine, moved, share = self.machine, [], []
        if machine.ambient:
            moved += [self._moved(ambient=machine.ambient, ambient_phase=phase) for phase in (0.0, 0.5 * np.pi)]
            share += [1.0, 1.0]
        weights, which = np.ones((len(self._u(take)), len(moved))), np.arange(len(moved))
        if rippled:
            usual = self.yardstick.p[machine.at(machine.rippled)]
            moved.append(self._moved(**{machine.rippled: usual * (1.0 + SMALL_SHARE)}))
            share.append(SMALL_SHARE)
            weights = np.concatenate([weights, self._features(take)], axis=1)
            which = np.concatenate([which, np.full(2 * FEATURES, len(which))])
        if not moved:
            return self.yardstick.parameters[take]
        tangent = self.yardstick.tangents[take]
        forces = tangent.forces(np.array(moved), np.array(share))
        return np.concatenate([self.yardstick.parameters[take], tangent.driven(forces, which, weights, self._settled)])

    def _features(self, take: int) -> Array:
        """Random waves over the ripple's arguments, (N, 2 FEATURES)."""
        arguments = self.machine.ripple_arguments(self.yardstick.tangents[take].states, self._u(take))
        wave = arguments @ stream("ripple features").standard_normal((arguments.shape[1], FEATURES))
        return np.concatenate([np.sin(wave), np.cos(wave)], axis=1)

    def _side(self, effect: Effect) -> str:
        if effect.slot:
            return "input" if effect.slot in self.machine.played.values() else "law"
        return effect.ports[0].partition(":")[0]

    def _u(self, take: int) -> Array:
        return self.yardstick.takes[take].u

    def _moved(self, **values: float) -> Array:
        """The yardstick's parameters (np,) but for some."""
        moved = self.yardstick.p.copy()
        for name, value in values.items():
            moved[self.machine.at(name)] = value
        return moved

    def _by_law(self, take: int, wanted: Sequence[tuple[Effect, float]]) -> Array:
        moved = np.array([self._moved(**{effect.slot: size}) for effect, size in wanted])
        tangent, start_s = self.yardstick.tangents[take], self.yardstick.takes[take].start_s
        there = start_s + clock(len(self._u(take)) * self.machine.period_s, self.machine.period_s) >= self._onset_s
        weights = np.repeat(there[:, None].astype(float), len(wanted), axis=1)
        forces = tangent.forces(moved, np.ones(len(wanted)))
        return tangent.driven(forces, np.arange(len(wanted)), weights, self._settled)

    def _by_input(self, take: int, wanted: Sequence[tuple[Effect, float]]) -> Array:
        u, tangent, takes = self._u(take), self.yardstick.tangents[take], self.yardstick.takes
        which, weights = [], []
        for effect, size in wanted:
            if effect.slot:
                p = Parameters(self.yardstick.p, self._moved(**{effect.slot: size}), self._onset_s)
                given = self.machine.driven(u, p, takes[take].start_s)
            else:
                given = series_with_fault(self.yardstick, effect, size, self._onset_s)[take]
            # A fault is in one channel.
            column = int(np.argmax(np.abs(given - u).max(axis=0)))
            which.append(column)
            weights.append((given - u)[:, column])
        return tangent.driven(tangent.inputs, np.array(which), np.stack(weights, axis=1), self._settled)

    def _at_output(self, effect: Effect, size: float) -> list[Array]:
        made = series_with_fault(self.yardstick, effect, size, self._onset_s)
        return [(y - base).T for y, base in zip(made, self.yardstick.base, strict=True)]
