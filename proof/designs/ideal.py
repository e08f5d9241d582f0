"""The truth of a concealed machine, and what the ideal observer makes of any recordings of it."""

from __future__ import annotations

import functools
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinbench.data.scenario import stream
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.changes import change_of
from twinbench.proof.concealed.columns import Picture, picture
from twinbench.proof.concealed.machine import Effect, Machine
from twinbench.proof.concealed.observer import PARAMETER_SQ, Seen, ideal_posterior, observe
from twinbench.proof.concealed.on_twin import OnTwin
from twinbench.proof.concealed.refit import refitted
from twinbench.proof.concealed.severity import Take, Yardstick


@dataclass(frozen=True)
class Truth:
    """What is really there.

    Attributes:
        own: (np,) parameters of the law without the effect, each in its unit.
        amplitude: of the effect, in its unit.
        background_pct: ripple that no catalogue has.
    """

    machine: Machine
    own: Array
    effect: Effect
    amplitude: float
    background_pct: float

    @property
    def parameters(self) -> Array:
        """(np,) of the law with the effect, each in its unit."""
        p = self.own.copy()
        p[self.machine.at(self.effect.slot)] = self.amplitude
        return p

    @property
    def quiet(self) -> Array:
        """(np,) of the law without effect and background, each in its unit."""
        p = self.own.copy()
        p[self.machine.at("ripple")] = p[self.machine.at("ambient")] = 0.0
        return p

    def told(self, same: Collection[str]) -> dict[str, Any]:
        """As ``outcome`` takes it.

        Args:
            same: names that nobody can tell from the effect's.
        """
        effect = {"name": self.effect.name, "ports": list(self.effect.ports), "class": sorted(same)}
        return {"cell": "mechanism", "effects": [effect]}


def seen(truth: Truth, takes: Sequence[Take], refit: bool = False) -> Seen:
    """What the ideal observer makes of recordings, those held out left out.

    Args:
        refit: fit all that is unknown anew for the nearest rivals. It takes most of the time.
    """
    run, name = OnTwin(Yardstick(truth.machine, takes, truth.quiet), -np.inf), truth.effect.name
    again = None
    if refit:
        made = change_of(run.yardstick, truth.effect).of(truth.amplitude)
        change = {i: made[i] - run.yardstick.base[i] for i in run.tracks}
        again = functools.partial(refitted, run, change, [], truth.background_pct)
    return observe(_picture(truth, run), name, (), stream("ideal observer", name), again)


def sure(truth: Truth, takes: Sequence[Take], same: Collection[str]) -> float:
    """Probability that the ideal observer of recordings is sure that it is one of some names.

    Args:
        same: these, the true one among them.
    """
    name = truth.effect.name
    columns = _picture(truth, OnTwin(Yardstick(truth.machine, takes, truth.quiet), -np.inf))
    own = columns.names.index(name)
    there = (np.diag(columns.gram) > PARAMETER_SQ * columns.raw) & ~columns.foreign
    there[own] = True
    right = np.isin(columns.names, sorted(same)) & ~columns.foreign
    return ideal_posterior(columns, columns.gram, own, there, right, stream("ideal observer", name))[1]


def _picture(truth: Truth, run: OnTwin) -> Picture:
    return picture(run, {truth.effect.name: truth.amplitude}, truth.background_pct)
