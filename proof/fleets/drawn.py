"""A fleet drawn: machines of one kind that share an effect in much the same size; some have one more of their own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from twinbench.data.scenario import stream
from twinbench.proof.concealed.changes import change_of
from twinbench.proof.concealed.generate import drawn_parameters, drawn_takes
from twinbench.proof.concealed.integrate import Parameters
from twinbench.proof.concealed.machine import Machine
from twinbench.proof.concealed.machines import machine_of
from twinbench.proof.concealed.record import recorded
from twinbench.proof.concealed.severity import Take, Yardstick, readings

KIND = "two_tanks"
"""The cheapest machine."""
EFFECTS = ("leak@h1_cm", "leak@h2_cm", "quadratic_leak@h1_cm", "offset@h2_cm", "overflow@h1_cm", "dead_zone@pump_V")
"""Of two drawn ones the first is shared, the second is what odd machines have."""
SECONDS = {"train": (600.0, 600.0), "held": (600.0,)}
SEVERITY, OWN_SCATTER = 1.0, 0.05
"""Of each effect on its own; sd of the shared size from machine to machine, as a share."""
BACKGROUND_PCT = 0.2
"""Ripple that no catalogue has; each machine has another."""


class Drawn(NamedTuple):
    """A fleet: where its simulator is, the effect that all share, the one of the odd machines, and which those are."""

    simulator: str
    shared: str
    own: str
    odd: tuple[str, ...]


def draw(fleet: int, seed: int, machines: int, odd: int, out: Path) -> Drawn:
    """Draw a fleet and write a folder of recordings for each machine; the same number and seed give the same."""
    rng = stream(seed, "fleet", fleet)
    machine = replace(machine_of(KIND, seed), seconds=SECONDS)
    shared, own = rng.choice(EFFECTS, 2, replace=False)
    strange = {int(k) for k in rng.choice(machines, odd, replace=False)}
    names = []
    for k in range(machines):
        name, one = f"machine_{k + 1:02d}", stream(seed, "fleet", fleet, k)
        takes = drawn_takes(machine, "", one)
        p = drawn_parameters(machine, "mechanism", BACKGROUND_PCT, one)
        quiet = p.copy()
        quiet[machine.at("ripple")] = quiet[machine.at("ambient")] = 0.0
        yardstick = Yardstick(machine, takes, quiet)
        for effect in (shared, own) if k in strange else (shared,):
            share = 1.0 + OWN_SCATTER * float(one.normal()) if effect == shared else 1.0
            p[machine.at(machine.effect(effect).slot)] = share * _amplitude(fleet, seed, machine, yardstick, effect)
        _record(machine, takes, p, one, out / name)
        names += [name] if k in strange else []
    return Drawn(machine.simulator, str(shared), str(own), tuple(names))


_SIZES: dict[tuple[int, int, str], float] = {}
"""Sizes of effects of a fleet, as its first machine that has them says."""


def _amplitude(fleet: int, seed: int, machine: Machine, yardstick: Yardstick, name: str) -> float:
    """Size of an effect at the fleet's severity: the same for all machines."""
    if (fleet, seed, name) not in _SIZES:
        change = change_of(yardstick, machine.effect(name))
        _SIZES[fleet, seed, name] = yardstick.scale(change.of, change.start, change.most, SEVERITY)[0]
    return _SIZES[fleet, seed, name]


def _record(machine: Machine, takes: tuple[Take, ...], p: np.ndarray, rng: np.random.Generator, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    channels, parameters = (*machine.inputs, *machine.outputs), Parameters.steady(p)
    for k, take in enumerate(takes):
        x0 = machine.settled(take.u, p, take.start_s)
        y = readings(machine, take, take.u, x0, parameters, machine.fine)
        noisy = recorded(machine, channels, np.concatenate([take.u, y], axis=-1), rng)
        time_s = np.round(take.start_s + np.arange(len(take.u)) * machine.period_s, 6)
        table = pd.DataFrame({"time_s": time_s} | dict(zip(channels, noisy.T, strict=True)))
        # The last by name is held out.
        table.to_csv(folder / f"{k + 1}_{take.name}.csv", index=False, float_format="%.8g")
