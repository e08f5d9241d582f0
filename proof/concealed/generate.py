"""Draw one case from a seed: a machine, what is wrong with it, how it was run; write what the engine may see."""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from twinbench.data.scenario import stream
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.changes import change_of, span_in_training, with_fault
from twinbench.proof.concealed.columns import picture
from twinbench.proof.concealed.faults import faults, parts
from twinbench.proof.concealed.integrate import Parameters
from twinbench.proof.concealed.machine import Effect, Machine
from twinbench.proof.concealed.machines import machine_of
from twinbench.proof.concealed.observer import observe
from twinbench.proof.concealed.on_twin import OnTwin
from twinbench.proof.concealed.outcome import UNKNOWN
from twinbench.proof.concealed.record import recorded
from twinbench.proof.concealed.refit import refitted
from twinbench.proof.concealed.severity import Take, Yardstick, readings

CELLS = (
    "clean", "parameters", "poor_excitation", "mechanism", "onset", "two_effects", "sensor", "left_out", "foreign",
)  # fmt: skip
BACKGROUND_PCT = ((0.0, 0.2, 1.0), (0.4, 0.4, 0.2))
"""Ripple of the main flow map that no catalogue has, in per cent; how often each is drawn."""
NOISY_INPUT = 0.5, (0.003, 0.05)
"""Share of the sound machines of which an input is recorded with noise; the range of that noise, as a share of how far
the input moves (sd). Real inputs are measured. Elsewhere inputs are recorded nearly as they are: the ideal observer
knows them."""
PAUSE_S = 600.0
MEANS_IT = 0.9
"""A case whose effect cannot reach this share of its severity carries the severity that it has."""


@dataclass(frozen=True)
class Item:
    """What a case is about.

    Attributes:
        effects: names of the machine's; none on a sound machine.
        background_pct: ripple that no catalogue has; drawn by ``BACKGROUND_PCT`` if None.
    """

    case: str
    cell: str
    machine: str
    effects: tuple[str, ...] = ()
    severity: float = 0.0
    background_pct: float | None = None


@dataclass(frozen=True)
class Case:
    """A drawn case.

    Attributes:
        public: what the engine may know, ``case.json``.
        tables: recordings by name: time, inputs, outputs.
        truth: what is sealed; plain JSON.
    """

    item: Item
    public: dict[str, Any]
    tables: dict[str, pd.DataFrame]
    truth: dict[str, Any]


@dataclass(frozen=True)
class _Plan:
    """A case before it is recorded: truth's parameters without and with the effects, faults and their sizes."""

    takes: tuple[Take, ...]
    parameters: Parameters
    faults: tuple[tuple[str, tuple[str, float], tuple[float, float]], ...]  # port, kind and size, span in training


def draw(item: Item, seed: int, machines: Mapping[str, Machine] | None = None, observed: bool = True) -> Case:
    """Draw a case; the same item and seed give the same case.

    Args:
        machines: in place of the seed's own.
        observed: ask the ideal observer, which takes most of the time. Else the case cannot be judged.
    """
    machine = machine_of(item.machine, seed) if machines is None else machines[item.machine]
    rng = stream(seed, "prove", item.case, item.cell, item.machine, item.effects)
    usual = float(rng.choice(BACKGROUND_PCT[0], p=BACKGROUND_PCT[1]))
    background = usual if item.background_pct is None else item.background_pct
    p = drawn_parameters(machine, item.cell, background, rng)
    takes = drawn_takes(machine, "poor" if item.cell == "poor_excitation" else "", rng)
    known = {e.name: e for e in (*machine.effects, *machine.foreign, *faults(machine))}
    effects = [known[name] for name in item.effects]
    onset_s = np.inf if not effects else _onset(takes, rng) if item.cell == "onset" else -np.inf
    plan, found = _scaled(machine, item, effects, takes, p, onset_s, observed)
    noisy = {} if effects else _noisy_input(machine, takes, stream(seed, "noisy input", item.case, item.machine))
    tables, floor = _recorded(machine, plan, rng)
    for table in tables.values():
        for name, sd in noisy.items():
            table[name] += sd * rng.standard_normal(len(table))
    reached = [f["severity"] for f in found]
    severity = item.severity if min(reached, default=1.0) >= MEANS_IT * item.severity else min(reached)
    # Not only its name is left out, but all that nobody could tell from it: what is then named is wrong indeed.
    alike = {n for f in found for n in (*f.get("class", ()), *f.get("close", ()))}
    without = sorted(alike) if item.cell in UNKNOWN else []
    public = {
        "machine": machine.name,
        "simulator": machine.simulator,
        "values": dict(machine.values),
        "calibrate": list(machine.calibrate),
        "without": without,
        "train": [t.name for t in takes if not t.held_out],
        "held_out": [t.name for t in takes if t.held_out],
    }
    if machine.network:
        public["network"] = dict(machine.network)
    truth = {
        "case": item.case,
        "machine": machine.name,
        "kind": machine.kind,
        "cell": item.cell,
        "severity": round(float(severity), 4),
        "background_pct": background,
        "effects": found,
        **_together(found if observed else ()),
        "onset_s": onset_s if np.isfinite(onset_s) else None,
        "calibrated": list(machine.calibrate),
        "parameters": {name: float(v) for name, v in zip(machine.parameters, plan.parameters.before, strict=True)},
        "noisy_input": noisy,
        "outputs": list(machine.outputs),
        "held_out_floor": floor,
    }
    return Case(item, public, tables, truth)


def _together(found: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What the ideal observer makes of the whole case: its hardest effect decides."""
    if not found:
        return dict.fromkeys(("D0_sq", "Dk_sq", "detectable", "ideal_name", "ideal_class"))
    return {
        "D0_sq": min(f["D0_sq"] for f in found),
        "Dk_sq": min(f["Dk_sq"] for f in found),
        "detectable": all(f["detectable"] for f in found),
        "ideal_name": float(np.prod([f["ideal_name"] for f in found])),
        "ideal_class": float(np.prod([f["ideal_class"] for f in found])),
    }


def write(case: Case, folder: Path) -> None:
    """Write what the engine may see: ``case.json`` and one CSV per recording."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "case.json").write_text(json.dumps(case.public, indent=1, sort_keys=True))
    for name, table in case.tables.items():
        table.to_csv(folder / f"{name}.csv", index=False, float_format="%.8g")


def drawn_parameters(machine: Machine, cell: str, background: float, rng: np.random.Generator) -> Array:
    """The machine's own constants: as the twin says in cell "clean", off by up to 15 % elsewhere."""
    off = 0.0 if cell == "clean" else 1.0
    values = {}
    for name, share in machine.spread.items():
        value = machine.parameters[name] * (1.0 + off * share * rng.uniform(-1.0, 1.0))
        values[name] = min(value, machine.high.get(name, np.inf))
    for name, width in machine.offsets.items():
        values[name] = machine.parameters[name] + off * width * rng.uniform(-1.0, 1.0)
    return machine.p(
        **values,
        ripple=background / 100.0,
        ripple_phase=rng.uniform(0, 2 * np.pi),
        ambient=machine.ambient,
        ambient_phase=rng.uniform(0, 2 * np.pi),
        exponent=rng.uniform(*machine.exponent),
    )


def drawn_takes(machine: Machine, regime: str, rng: np.random.Generator) -> tuple[Take, ...]:
    """The recordings to be made, one after the other on the suite's clock; of the usual regimes if none is given."""
    takes, clock = [], 0.0
    for part in ("train", "held"):
        for i, seconds in enumerate(machine.seconds[part]):
            takes.append(Take(f"{part}_{i + 1}", clock, machine.operate(rng, seconds, regime or part)))
            clock += seconds + PAUSE_S
    return tuple(takes)


def _noisy_input(machine: Machine, takes: Sequence[Take], rng: np.random.Generator) -> dict[str, float]:
    """The noise that one of the inputs that move is recorded with, sd in its unit, by its name; in some cases none."""
    share, (least, most) = NOISY_INPUT
    moves = np.concatenate([take.u for take in takes]).std(axis=0)
    if not moves.any():
        return {}
    column = int(rng.choice(np.flatnonzero(moves > 0.0)))
    sd = float(moves[column] * np.exp(rng.uniform(np.log(least), np.log(most))))
    return {machine.inputs[column]: sd} if rng.random() < share else {}


def _onset(takes: Sequence[Take], rng: np.random.Generator) -> float:
    """In the middle half of the second training recording."""
    seconds = takes[2].start_s - PAUSE_S - takes[1].start_s
    return float(np.round(takes[1].start_s + rng.uniform(0.25, 0.75) * seconds, 1))


def _scaled(
    machine: Machine,
    item: Item,
    effects: Sequence[Effect],
    takes: tuple[Take, ...],
    p: Array,
    onset_s: float,
    observed: bool,
) -> tuple[_Plan, list[dict[str, Any]]]:
    """Give every effect the amplitude of the case's severity, each by itself, on a machine without background."""
    after, wrong, found = p.copy(), [], []
    yardstick = Yardstick(machine, takes, _quiet(machine, p)) if effects else None
    for effect in effects:
        assert yardstick is not None
        change = change_of(yardstick, effect, onset_s)
        amplitude = change.start
        if effect.is_stuck:
            held_out, in_training = yardstick.measure(change.of(amplitude))
        else:
            amplitude, held_out, in_training = yardstick.scale(change.of, change.start, change.most, item.severity)
        if effect.slot:
            after[machine.at(effect.slot)] = amplitude
        else:
            wrong.append((effect.ports[0], (parts(effect)[0], amplitude), span_in_training(yardstick, effect)))
        sizes = {effect.size: [effect.absent + effect.scale * amplitude, effect.absent]} if effect.size else {}
        found.append(
            {
                "name": effect.name,
                "ports": list(effect.ports),
                "amplitude": amplitude,
                "sizes": sizes,
                "held_out": held_out,
                "in_training": in_training,
                "severity": in_training if effect.is_stuck else min(held_out, in_training),
            }
        )
    if yardstick is not None and observed:
        _observe(item, yardstick, effects, found, 100.0 * p[machine.at("ripple")], onset_s)
    return _Plan(takes, Parameters(p, after, onset_s), tuple(wrong)), found


def _quiet(machine: Machine, p: Array) -> Array:
    """Parameters (np,) without background."""
    quiet = p.copy()
    quiet[machine.at("ripple")] = quiet[machine.at("ambient")] = 0.0
    return quiet


def _observe(
    item: Item,
    yardstick: Yardstick,
    effects: Sequence[Effect],
    found: Sequence[dict[str, Any]],
    background_pct: float,
    onset_s: float,
) -> None:
    """Add to every effect what the ideal observer makes of it."""
    there = {f["name"]: f["amplitude"] for f in found}
    run = OnTwin(yardstick, onset_s)
    seen = picture(run, there, background_pct)
    made = {e.name: change_of(yardstick, e, onset_s).of(there[e.name]) for e in effects}
    change = {name: {i: y[i] - yardstick.base[i] for i in run.tracks} for name, y in made.items()}
    for f in found:
        beside = tuple(name for name in there if name != f["name"])
        refit = functools.partial(refitted, run, change[f["name"]], [change[name] for name in beside], background_pct)
        f |= observe(seen, f["name"], beside, stream("ideal observer", item.case, f["name"]), refit).told()


def _with_faults(machine: Machine, plan: _Plan, side: str, series: Sequence[Array]) -> Sequence[Array]:
    """The takes' inputs or outputs, (N, channels) each, with all faults of that side."""
    made = series
    for port, fault, span in plan.faults:
        if port.startswith(f"{side}:"):
            pairs = zip(plan.takes, made, strict=True)
            made = [with_fault(machine, take, s, port, fault, span) for take, s in pairs]
    return made


def _recorded(
    machine: Machine, plan: _Plan, rng: np.random.Generator
) -> tuple[dict[str, pd.DataFrame], dict[str, float]]:
    """Tables as recorded; and per output the rms of reading less clean reading over the held-out ones."""
    commands = [take.u for take in plan.takes]
    given = _with_faults(machine, plan, "input", commands)
    clean, p = [], plan.parameters
    for take, u in zip(plan.takes, given, strict=True):
        x0 = machine.settled(u, p.before if take.start_s < p.onset_s else p.after, take.start_s)
        clean.append(readings(machine, take, u, x0, p, machine.fine))
    sensed = _with_faults(machine, plan, "output", clean)
    tables, errors = {}, []
    channels = (*machine.inputs, *machine.outputs)
    for take, u, y in zip(plan.takes, commands, sensed, strict=True):
        if not np.isfinite(y).all():
            raise FloatingPointError(f"machine {machine.name} diverged while {take.name} was recorded")
        noisy = recorded(machine, channels, np.concatenate([u, y], axis=-1), rng)
        time_s = np.round(take.start_s + np.arange(len(u)) * machine.period_s, 6)
        tables[take.name] = pd.DataFrame({"time_s": time_s} | dict(zip(channels, noisy.T, strict=True)))
        if take.held_out:
            errors.append(noisy[:, len(machine.inputs) :] - y)
    rms = np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))
    return tables, {name: float(v) for name, v in zip(machine.outputs, rms, strict=True)}
