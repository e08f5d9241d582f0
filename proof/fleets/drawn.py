"""A fleet drawn: machines of one kind that share an effect in much the same size; some have one more of their own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from twinbench.data.scenario import stream
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.changes import change_of
from twinbench.proof.concealed.generate import drawn_parameters, drawn_takes
from twinbench.proof.concealed.machines import machine_of
from twinbench.proof.concealed.record import written
from twinbench.proof.concealed.severity import Yardstick

KIND = "two_tanks"
"""The cheapest machine."""
EFFECTS = ("leak@h1_cm", "leak@h2_cm", "quadratic_leak@h1_cm", "offset@h2_cm", "overflow@h1_cm", "dead_zone@pump_V")
"""Of two drawn ones the first is shared, the second is what odd machines have."""
SECONDS = {"train": (600.0, 600.0), "held": (600.0,)}
SEVERITY, OWN_SCATTER = 1.0, 0.05
"""Of the shared effect on the median machine, and of its own on each odd one, each effect by itself; sd of the shared
size from machine to machine, as a share."""
BACKGROUND_PCT = 0.2
"""Ripple that no catalogue has; each machine has another."""


class One(NamedTuple):
    """A machine of a fleet.

    Attributes:
        yardstick: its recordings to be made, on the machine without effects and background.
        p: (n_parameters,) the truth's own, effects and background among them, each in its unit.
        sizes: of its effects, by name, each in its slot's unit.
    """

    yardstick: Yardstick
    p: Array
    sizes: Mapping[str, float]


class Drawn(NamedTuple):
    """A fleet: where its simulator is, the effect that all share, the one of the odd machines, and which those are.

    Attributes:
        seed: of the draw, and the fleet's number in it.
    """

    seed: tuple[int, int]
    simulator: str
    shared: str
    own: str
    odd: tuple[str, ...]
    machines: Mapping[str, One]


def draw(fleet: int, seed: int, machines: int, odd: int) -> Drawn:
    """Draw a fleet; the same number and seed give the same."""
    rng = stream(seed, "fleet", fleet)
    machine = replace(machine_of(KIND, seed), seconds=SECONDS)
    shared, own = (str(name) for name in rng.choice(EFFECTS, 2, replace=False))
    strange = {int(k) for k in rng.choice(machines, odd, replace=False)}
    streams = {f"machine_{k + 1:02d}": stream(seed, "fleet", fleet, k) for k in range(machines)}
    bare: dict[str, tuple[Yardstick, Array]] = {}
    for name, one in streams.items():
        takes = drawn_takes(machine, "", one)
        p = drawn_parameters(machine, "mechanism", BACKGROUND_PCT, one)
        quiet = p.copy()
        quiet[machine.at("ripple")] = quiet[machine.at("ambient")] = 0.0
        bare[name] = Yardstick(machine, takes, quiet), p
    usual = float(np.median([_size(yardstick, shared) for yardstick, _ in bare.values()]))
    built = {}
    for k, (name, (yardstick, p)) in enumerate(bare.items()):
        sizes = {shared: usual * (1.0 + OWN_SCATTER * float(streams[name].normal()))}
        sizes |= {own: _size(yardstick, own)} if k in strange else {}
        for effect, size in sizes.items():
            p[machine.at(machine.effect(effect).slot)] = size
        built[name] = One(yardstick, p, sizes)
    names = list(built)
    return Drawn((seed, fleet), machine.simulator, shared, own, tuple(names[k] for k in sorted(strange)), built)


def _size(yardstick: Yardstick, effect: str) -> float:
    """At which an effect has the severity on this machine, by itself."""
    change = change_of(yardstick, yardstick.machine.effect(effect))
    return yardstick.scale(change.of, change.start, change.most, SEVERITY)[0]


def write(drawn: Drawn, out: Path) -> None:
    """A folder of recordings for each machine.

    Raises:
        FloatingPointError: a machine diverges.
    """
    for name, one in drawn.machines.items():
        folder = out / name
        folder.mkdir(parents=True, exist_ok=True)
        machine, rng = one.yardstick.machine, stream(*drawn.seed, "fleet's noise", name)
        for k, take in enumerate(one.yardstick.takes):
            time_s, values = written(machine, take, one.p, rng)
            table = pd.DataFrame(
                {"time_s": time_s} | dict(zip((*machine.inputs, *machine.outputs), values.T, strict=True))
            )
            # The last by name is held out.
            table.to_csv(folder / f"{k + 1}_{take.name}.csv", index=False, float_format="%.8g")
