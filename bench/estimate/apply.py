"""A trained estimator over somebody's recordings: estimates with intervals, what they rest on, a figure."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from twinbench.bench import cells
from twinbench.bench.cells import Cell
from twinbench.bench.estimate.delay import check_delay, known_later
from twinbench.bench.estimate.figure import Readings, estimate_figure
from twinbench.bench.estimate.made import Trained
from twinbench.bench.estimate.quality import Quality, judge
from twinbench.bench.estimate.reference import References
from twinbench.bench.estimate.sampling import joined, manner_of
from twinbench.bench.estimate.witness import watch
from twinbench.bench.estimate.words import told
from twinbench.bench.estimates import Estimates
from twinbench.bench.profile import Profile, flattened, folder_of, profile_on
from twinbench.bench.registry import discover, find
from twinbench.bench.results import load_results
from twinbench.bench.roster import label, ordered
from twinbench.common.documents import strict, to_json
from twinbench.common.errors import BadInput
from twinbench.common.progress import each
from twinbench.common.store import Store, write_atomically, write_csv, write_text
from twinbench.common.threads import pin_torch
from twinbench.common.versions import code_version
from twinbench.data.recording import Recording, check_overlap, files_of, read_recording
from twinbench.data.units import limits_of, units_of
from twinbench.machines.coordinates import Array
from twinbench.machines.load import load_machine
from twinbench.machines.machine import Machine

SUMMARY_VERSION = 1
"""Of the form of a summary. It rises when a field goes, or changes its type or what it means. A new field leaves it as
it is."""
SHORTEST_S = 10.0
MOST_ROWS = 30_000
BOUNDS = {"value": "mean", "low": "low", "high": "high"}


@dataclass(frozen=True)
class Training:
    """Where estimators were trained.

    Attributes:
        profile: name or path of the profile.
        results: the run's folder; None: where ``twinbench run`` puts it.
        machine: its name, or the path of the file it comes from; empty: the profile's own.
    """

    profile: str
    results: Path | None = None
    machine: str = ""

    def folder(self, profile: Profile) -> Path:
        """The run's, where its profile is read already."""
        return self.results or folder_of(profile, self.machine)


def trained_cells(where: Training, names: Sequence[str]) -> tuple[Store, list[Cell]]:
    """A run's store, and the first-seed cells of the named estimators, or of all that are trained there.

    Raises:
        BadInput: one is not trained in that run, or none is.
    """
    profile = profile_on(where.profile, where.machine)
    results = where.folder(profile)
    named = f" --machine {where.machine}" if where.machine else ""
    store = Store(results / "store")
    found = []
    load_machine(profile.machine)  # refuses what is none
    for name in names or ordered(discover()):
        cell = cells.make_cell(name, profile.seeds[0], profile)
        if store.has("fit", cell.fit):
            found.append(cell)
        elif names:
            raise BadInput(
                f"{name} is not trained in {results} with this code and profile {profile.name!r}"
                f"{_what_differs(results, name, profile)}; "
                f"train it with: twinbench run --profile {where.profile}{named} --only {name} --out {results}"
            )
    if not found:
        raise BadInput(
            f"nothing is trained in {results} with this code and profile {profile.name!r}; "
            f"train with: twinbench run --profile {where.profile}{named} --out {results}"
        )
    return store, found


def _what_differs(results: Path, name: str, profile: Profile) -> str:
    """In brackets, how the run in ``results`` differs from one that would hold the estimator; empty if unknown."""
    try:
        manifest = load_results(results).manifest
    except BadInput:
        return ""
    kind = find(name)
    now, then = (flattened(p) for p in (json.loads(json.dumps(asdict(profile))), manifest.get("profile", {})))
    trained = [
        key for key in now if key.startswith(("machine", "seeds", "data.", "corruption.", f"settings.{kind.name}."))
    ]
    for key in trained:
        if then.get(key) != now[key]:
            return f" (there {key} was {then.get(key)}, now it is {now[key]})"
    if manifest.get("code", {}).get(kind.name) not in (None, code_version(kind.__module__)):
        return f" (the code of {kind.name}, or what it imports, has changed since)"
    return ""


@dataclass(frozen=True)
class _Answer:
    """One recording's estimates, and what they rest on."""

    estimates: Estimates
    readings: Readings
    quality: Quality
    summary: dict[str, Any]


def apply(
    name: str,
    paths: Sequence[Path],
    out: Path,
    where: Training,
    mapping: Sequence[str],
    force: bool = False,
    delay_s: float = 0.0,
) -> list[dict[str, Any]]:
    """Write ``<recording>.estimates.csv``, ``.png`` and ``.summary.json`` into ``out`` for each recording.

    Every recording is read, checked and estimated before anything is written. Long ones are thinned to some
    30,000 rows.

    Args:
        force: write those that are not usable, too.
        delay_s: of each time write what is known so many seconds later; 0: at that time.

    Returns:
        One summary per recording: what the estimate rests on, whether it is ``usable``, where it ended, with 95 %
        intervals, and in words.
    """
    check_delay(name, delay_s)
    profile = profile_on(where.profile, where.machine)
    recordings = _read(paths, mapping, load_machine(profile.machine))
    store, (cell,) = trained_cells(where, [name])
    pin_torch()
    references = References(store, cell, cells.load_fit(store, cell))
    trained = Trained(name, where.profile, profile.machine, where.folder(profile), store, cell)
    made = trained.provenance(mapping, force, delay_s)
    each_made = [{**made, "files": [*files_of(path), *made["files"]]} for path in paths]
    answers = [
        _answer(recording, references, label(cell.estimator), each_made[k], delay_s)
        for k, recording in enumerate(each("estimate", recordings))
    ]
    for answer in answers:
        if answer.quality.usable or force:
            _write(out, answer)
    return [answer.summary for answer in answers]


def _answer(recording: Recording, references: References, who: str, made: Mapping[str, Any], delay_s: float) -> _Answer:
    batch = recording.to_batch(references.machine)
    manner = manner_of(batch.measured[0])
    every = max(1, batch.measured.shape[1] // MOST_ROWS)
    filled = replace(batch, measured=joined(batch.measured, manner, len(batch.machine.inputs)))
    estimates, seen = watch(references.estimator, filled, every, references.cell.seed)
    quality = judge(batch.measured[0], manner, estimates, seen, references, who)
    if delay_s > 0.0:
        estimates = known_later(references.estimator, estimates, filled, every, delay_s)
    factors = references.calibrated()
    if factors is not None:
        estimates = _calibrated(estimates, factors, batch.machine)
    warning = "" if quality.usable else f"not usable: {quality.verdict}"
    readings = Readings(
        batch.machine, batch.time_s, batch.measured[0], seen.accepted[0], manner, *references.envelope, warning
    )
    summary = _summarise(recording, references.machine, who, estimates, quality)
    summary |= {"calibrated": factors is not None, "provenance": made}
    if delay_s > 0.0:
        summary["rests_on"].append(f"  estimates: as known {delay_s:g} s later, the last ones as known at the end")
    return _Answer(estimates, readings, quality, strict(summary))


def _calibrated(estimates: Estimates, factors: Array, machine: Machine) -> Estimates:
    """The same with the intervals that fit the run's calibration recordings, health within its physical bounds."""
    wide = replace(estimates, factors=factors).calibrated()
    low, high = wide.low.copy(), wide.high.copy()
    for part in (low, high):
        n = len(machine.estimated)
        part[..., n:] = np.clip(part[..., n:], machine.coordinates.low, machine.coordinates.high)
    return replace(wide, low=low, high=high)


def read_all(paths: Sequence[Path], mapping: Sequence[str], machine: Machine) -> list[Recording]:
    """Recordings of a machine, each of a name of its own.

    Args:
        mapping: ``COLUMN[unit]=channel``, as ``read_recording`` takes it.

    Raises:
        BadInput: one line; one cannot be read, two share no channel or are of one name.
    """
    units, limits, period_s = units_of(machine), limits_of(machine), machine.sample_period_s
    recordings = [read_recording(path, mapping, units, limits, period_s=period_s) for path in paths]
    check_overlap(recordings)
    names = [recording.name for recording in recordings]
    for name in names:
        if names.count(name) > 1:
            raise BadInput(f"two recordings are named {name}; rename one, or give each run its own --out")
    return recordings


def _read(paths: Sequence[Path], mapping: Sequence[str], machine: Machine) -> list[Recording]:
    recordings = read_all(paths, mapping, machine)
    for recording in recordings:
        length = recording.time_s[-1] - recording.time_s[0]
        if length < SHORTEST_S:
            raise BadInput(f"recording {recording.name} lasts {length:.1f} s; at least {SHORTEST_S:.0f} s are needed")
    return recordings


def _summarise(
    recording: Recording, machine: Machine, who: str, estimates: Estimates, quality: Quality
) -> dict[str, Any]:
    final = {
        q: {key: float(getattr(estimates, field)[0, -1, i]) for key, field in BOUNDS.items()}
        for i, q in enumerate(machine.quantities)
    }
    said = {q: (machine.axis_label(q).removesuffix(", –"), final[q]) for q in machine.health_names}
    words = "; ".join(f"{w} {f['value']:.4g} ({f['low']:.4g} to {f['high']:.4g})" for w, f in said.values())
    seconds = float(recording.time_s[-1] - recording.time_s[0])
    return {
        "schema_version": SUMMARY_VERSION,
        "recording": recording.name,
        "estimator": who,
        "seconds": seconds,
        "missing_share": float(np.isnan(recording.values).mean()),
        **quality.to_json(),
        "final": final,
        "says": f"{recording.name}: at the end of {seconds:.0f} s, {who} has {words}.",
        "notes": list(recording.notes),
        "rests_on": [*told(recording.name, quality), *(f"  {note}" for note in recording.notes)],
    }


def _write(out: Path, answer: _Answer) -> None:
    estimates = answer.estimates
    name, time_s = estimates.names[0], estimates.time_s
    mean, low, high = estimates.mean[0], estimates.low[0], estimates.high[0]
    columns = {"time_s": time_s}
    for i, q in enumerate(answer.readings.machine.quantities):
        columns |= {q: mean[:, i], f"{q}_low": low[:, i], f"{q}_high": high[:, i]}
    table = pd.DataFrame(columns)
    drawn = (time_s, mean, low, high, answer.readings)
    write_csv(out / f"{name}.estimates.csv", table)
    write_text(out / f"{name}.summary.json", to_json(answer.summary) + "\n")
    write_atomically(out / f"{name}.png", lambda path: estimate_figure(*drawn, path))
