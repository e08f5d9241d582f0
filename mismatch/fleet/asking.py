"""Each machine of a fleet asked on its own, in processes side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.progress import Progress
from twinbench.common.shown import shown
from twinbench.common.workers import side_by_side
from twinbench.data.formats.kinds import READERS, kind_of
from twinbench.mismatch.fleet.evidence import Known, evidence, merged
from twinbench.mismatch.report.explain import Given, Request, explained, read

MACHINES = "machines"
"""Folder of what was found on each machine."""


@dataclass(frozen=True)
class Said:
    """What one machine says.

    Attributes:
        known: evidence of every set of effects that was weighed.
        document: its ``verdict.json``.
        among: by effect, probability that the right name is among those weighed in its place, by the learnt rule.
        beside: probability of something that nothing in the catalogue explains, and where; 0 if there is none.
        candidates: how many effects were looked for.
    """

    name: str
    known: Known
    document: Mapping[str, Any]
    among: Mapping[str, float]
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
    wanted = _likely(found)
    again = {name: (name, several[name], wanted) for name, said in found.items() if _lacks(said, wanted)}
    if again:
        with Progress() as progress, progress.stage("once more", len(again)) as going:
            for name, known in side_by_side(ask_again, again, progress.say, out):
                found[name] = replace(found[name], known=merged((found[name].known, known)))
                going.step()
    return {name: found[name] for name in several}


LIKELY = 3.0
"""Nats that a set of effects may lie behind a machine's likeliest for its effects to be asked of all machines."""


def _likely(fleet: Mapping[str, Said]) -> tuple[str, ...]:
    """Effects that are likely on some machine."""
    found: set[str] = set()
    for said in fleet.values():
        best = max(one.log - len(names) * np.log(said.candidates) for names, one in said.known.items())
        for names, one in said.known.items():
            if one.log - len(names) * np.log(said.candidates) > best - LIKELY:
                found |= names
    return tuple(sorted(found))


def _lacks(said: Said, wanted: Sequence[str]) -> bool:
    return any(frozenset((name,)) not in said.known for name in wanted)


def ask(name: str, request: Request, out: Path) -> Said:
    """One machine by itself; writes its ``verdict.json``, ``model.toml`` and ``sizes.csv``."""
    from twinbench.mismatch.naming.decision import features, learnt_rule, probability

    given = read(request)
    verdict, document = explained(request, given, out, lambda stage, share: None)
    d = verdict.diagnosis
    among: dict[str, float] = {}
    for f in d.answer.found:
        p = probability(learnt_rule().weights, features(f.evidence))
        among |= dict.fromkeys(f.alike, p)
    beside = next(((c.probability, str(c.port)) for c in d.claims if c.found is None), (0.0, ""))
    units = {c.name: c.mechanism.parameters[0].unit for c in d.machine.candidates}
    return Said(name, evidence(d.answer.naming), document, among, beside, len(d.machine.candidates), units)


def ask_again(name: str, request: Request, wanted: Sequence[str]) -> tuple[str, Known]:
    """The same machine with a catalogue of what is wanted alone: every set of those is near enough to be weighed."""
    from twinbench.mismatch.asked import Asked
    from twinbench.mismatch.naming.weighed import weighed
    from twinbench.mismatch.told import Told

    given = read(request)
    some = tuple(m for m in given.catalogue if m.name in wanted)
    told = Told(measured=given.told.measured)
    found = weighed(Asked(given.simulator, given.fitted, given.held_out, some, given.faults, given.inputs, told))
    return name, evidence(found.answer.naming)
