"""Each machine of a fleet asked on its own, in processes side by side."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.progress import Progress
from twinbench.common.shown import shown
from twinbench.common.workers import side_by_side
from twinbench.data.formats.kinds import READERS, kind_of
from twinbench.mismatch.fleet.evidence import Known, evidence, merged, weigh_all
from twinbench.mismatch.fleet.pooled import pooled
from twinbench.mismatch.fleet.tied import shapes, tied, untied, with_tied
from twinbench.mismatch.report.explain import Given, Request, explained, read

MACHINES = "machines"
"""Folder of what was found on each machine."""


@dataclass(frozen=True)
class Said:
    """What one machine says.

    Attributes:
        known: evidence of every set of effects that was weighed.
        document: its ``verdict.json``.
        speaks: by effect that it finds, what speaks for it, as ``naming.decision`` weighs it.
        alike: by such an effect, names that do the same in its recordings.
        beside: probability of something that nothing in the catalogue explains, and where; 0 if there is none.
        candidates: how many effects were looked for.
    """

    name: str
    known: Known
    document: Mapping[str, Any]
    speaks: Mapping[str, Mapping[str, float]]
    alike: Mapping[str, frozenset[str]] = field(default_factory=dict)
    beside: tuple[float, str] = (0.0, "")
    candidates: int = 1
    units: Mapping[str, str] = field(default_factory=dict)


def requests(folders: Sequence[Path], like: Request) -> dict[str, Request]:
    """A request for each machine, by the name of its folder.

    Args:
        folders: of recordings, one for each machine; the last recording by name is held out if there are several.
        like: all else.

    Raises:
        BadInput: one machine alone, two of one name, or a folder without recordings.
    """
    if len(folders) < 2:
        raise BadInput(f"{len(folders)} machine is no fleet; give a folder for each, or ask twinbench mismatch")
    found: dict[str, Request] = {}
    for folder in folders:
        if not folder.is_dir():
            raise BadInput(f"{folder}: no such folder; give one folder with recordings for each machine")
        paths = sorted(p for p in folder.iterdir() if p.is_file() and kind_of(p) is not None)
        if not paths:
            kinds = ", ".join(READERS)
            raise BadInput(f"{folder}: holds no recording; put that machine's recordings into it ({kinds})")
        name = folder.resolve().name
        if name in found:
            raise BadInput(f"two machines are named {shown(name)}; rename one folder, or give it once only")
        found[name] = replace(like, paths=paths)
    return found


def check_alike(given: Mapping[str, Given]) -> None:
    """Refuse machines that are not measured by the same sensors.

    Raises:
        BadInput: one line.
    """
    first, *others = given
    measured = {name: _measured(one) for name, one in given.items()}
    for name in others:
        for more, less in ((first, name), (name, first)):
            if lacks := sorted(measured[more] - measured[less]):
                raise BadInput(
                    f"machine {less} has no readings of {lacks[0]}, machine {more} has; a fleet is measured alike: map "
                    "its column with --map, or leave that machine out"
                )


def _measured(given: Given) -> set[str]:
    """Outputs that any recording of a machine has readings of."""
    names, n = [v.name for v in given.simulator.outputs], len(given.simulator.inputs)
    seen = np.any([np.isfinite(r.values[:, n:]).any(axis=0) for r in (*given.fitted, *given.held_out)], axis=0)
    return {name for name, there in zip(names, seen, strict=True) if there}


def asked(several: Mapping[str, Request], out: Path) -> dict[str, Said]:
    """What every machine says; those that never weighed what others say are asked of that once more.

    Raises:
        BadInput: recordings that are too short, or a simulator that diverges.
    """
    with Progress() as progress, progress.stage("machines", len(several)) as going:
        found: dict[str, Said] = {}
        work = {name: (name, request, out / MACHINES / name) for name, request in several.items()}
        for said in side_by_side(ask, work, progress.say, out):
            found[said.name] = said
            going.step()
    for name, known in _again(several, found, out):
        found[name] = replace(found[name], known=merged((found[name].known, known)))
    return {name: found[name] for name in several}


def _again(several: Mapping[str, Request], found: Mapping[str, Said], out: Path) -> Iterator[tuple[str, Known]]:
    """What machines say of sets that others hold likely, and of the effects where the fleet has them."""
    fleet, likely = {name: said.known for name, said in found.items()}, _likely(found)
    shared = pooled(fleet, next(iter(found.values())).candidates)[0].names
    known = shapes(fleet.values(), {*likely, *shared})
    again = {}
    for name, said in found.items():
        wanted = _wanted(said, likely, shared)
        further = (wanted - set(said.known)) | with_tied(wanted, known)
        if further:
            again[name] = (name, several[name], further, known)
    if again:
        with Progress() as progress, progress.stage("once more", len(again)) as going:
            for told in side_by_side(ask_again, again, progress.say, out):
                yield told
                going.step()


LIKELY, MOST_ASKED = 3.0, 8
"""Nats that a set of effects may lie behind a machine's likeliest for its effects to be asked of all machines, and how
many effects are: those that are likely on most machines."""


def _likely(fleet: Mapping[str, Said]) -> list[str]:
    """Effects that are likely on some machine."""
    counts: dict[str, int] = {}
    for said in fleet.values():
        for name in {name for names in _near(said) for name in names}:
            counts[name] = counts.get(name, 0) + 1
    return sorted(counts, key=lambda name: -counts[name])[:MOST_ASKED]


def _near(said: Said) -> list[frozenset[str]]:
    """A machine's likeliest sets, the likeliest first."""
    logs = {names: those[0].log - len(names) * np.log(said.candidates) for names, those in said.known.items()}
    best = max(logs.values())
    return sorted((names for names, log in logs.items() if log > best - LIKELY), key=lambda names: -logs[names])


def _wanted(said: Said, likely: Sequence[str], shared: frozenset[str]) -> set[frozenset[str]]:
    """Sets that have to be known of a machine: what may be shared, alone and beside what it has likeliest of its own.

    Args:
        shared: the likeliest shared set, as far as is known by now.
    """
    near = _near(said)
    own = near[0] - shared
    beside = {shared} | {shared | {name} for names in near for name in names}
    return {frozenset((name,)) for name in likely} | {own | {name} for name in likely} | (beside - {frozenset()})


def ask(name: str, request: Request, out: Path) -> Said:
    """One machine by itself; writes its ``verdict.json``, ``model.toml`` and ``sizes.csv``."""
    given = read(request)
    verdict, document = explained(request, given, out, lambda stage, share: None)
    d = verdict.diagnosis
    speaks = {name: f.evidence for f in d.answer.found for name in f.alike}
    alike = {name: f.alike for f in d.answer.found for name in f.alike}
    beside = next(((c.probability, str(c.port)) for c in d.claims if c.found is None), (0.0, ""))
    units = {c.name: c.mechanism.parameters[0].unit for c in d.machine.candidates}
    return Said(name, evidence(d.answer.naming), document, speaks, alike, beside, len(d.machine.candidates), units)


def ask_again(
    name: str, request: Request, wanted: Collection[frozenset[str]], shapes: Mapping[str, tuple[float, ...]]
) -> tuple[str, Known]:
    """The same machine, with a catalogue of what is wanted alone and every wanted set weighed, likely or not.

    Args:
        shapes: those of the fleet, by effect, each parameter in its unit.
    """
    from twinbench.mismatch.asked import Asked
    from twinbench.mismatch.naming.weighed import weighed
    from twinbench.mismatch.told import Told

    given = read(request)
    names = {name for some in wanted for name in some}
    offered = (*given.catalogue, *(tied(m, shapes[m.name]) for m in given.catalogue if m.name in shapes))
    some = tuple(m for m in offered if m.name in names)
    told = Told(measured=given.told.measured)
    found = weighed(Asked(given.simulator, given.fitted, given.held_out, some, given.faults, given.inputs, told))
    naming = found.answer.naming
    weigh_all(naming, wanted)
    return name, untied(evidence(naming))
