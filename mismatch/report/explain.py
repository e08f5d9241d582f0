"""Why simulator and recordings differ: everything read and checked, then the engine, then the files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from twinbench.common.documents import made_from, read_file
from twinbench.common.progress import Progress
from twinbench.common.store import check_writable
from twinbench.data.recording import Recording, files_of
from twinbench.mismatch.model import load_catalogue, load_model, made_of, model_toml, whole_catalogue
from twinbench.mismatch.recordings import check_excited, check_measured, read_recordings
from twinbench.mismatch.seed import ENGINE_SEED
from twinbench.mismatch.told import Told, read_told
from twinbench.physics.simulator import Mechanism, Series, Simulator

if TYPE_CHECKING:
    from twinbench.mismatch import Verdict


@dataclass(frozen=True)
class Request:
    """What a user wants to have explained, as given.

    Attributes:
        spec: the simulator, as ``load_simulator`` takes it.
        paths, hold_out: files of recordings to learn from, and of those that nothing is learnt from.
        catalogue: the file of a user's own mechanisms, or nothing.
        mapping: which columns are which channels, each as COLUMN[UNIT]=CHANNEL.
        trust: run the Python that a ``model.toml`` names wherever it lies.
        inputs: between samples "held" or "linear"; "auto" is what a ``model.toml`` says, or else a fit.
        leave_out, prior, measured: what is known beforehand, as ``mismatch.told.read_told`` takes it.
    """

    spec: str
    paths: Sequence[Path]
    hold_out: Sequence[Path]
    catalogue: str = ""
    mapping: Sequence[str] = ()
    trust: bool = False
    inputs: str = "auto"
    leave_out: Sequence[str] = ()
    prior: Sequence[str] = ()
    measured: Sequence[str] = ()

    @property
    def settings(self) -> dict[str, Any]:
        """What decides a verdict beside the files."""
        return {
            "simulator": self.spec,
            "catalogue": self.catalogue,
            "map": self.mapping,
            "inputs": self.inputs,
            "leave_out": self.leave_out,
            "prior": self.prior,
            "measured": self.measured,
            "seed": ENGINE_SEED,
        }

    def provenance(self) -> dict[str, Any]:
        """What a verdict on this rests on, as ``verdict.json`` holds it. Everything has been read and can be used."""
        return made_from(self.settings, self.files())

    def files(self) -> Iterator[dict[str, Any]]:
        """Every file that was read, with its checksum."""
        for spec in made_of(self.spec):
            yield from read_file("simulator", spec)
        yield from read_file("catalogue", self.catalogue)
        last = len(self.paths) - 1 if not self.hold_out and len(self.paths) > 1 else None  # as ``diagnose`` has it
        for k, path in enumerate((*self.paths, *self.hold_out)):
            yield from files_of(path, held_out=k == last or k >= len(self.paths))


class Explained(NamedTuple):
    """What was found, and the same as ``verdict.json`` holds it."""

    verdict: Verdict
    document: dict[str, Any]


class Given(NamedTuple):
    """A request whose files were read and can be used.

    Attributes:
        catalogue: all that may be missing.
        inputs: what they do between samples, or "auto".
        model_inputs: the same, as a ``model.toml`` has it; empty if none does.
    """

    simulator: Simulator
    fitted: Sequence[Recording]
    held_out: Sequence[Recording]
    catalogue: tuple[Mechanism, ...]
    faults: Sequence[Series]
    inputs: str
    model_inputs: str
    told: Told


def read(asked: Request) -> Given:
    """Read what a request names.

    Raises:
        BadInput: the simulator, a recording or the catalogue cannot be used.
    """
    given = load_model(asked.spec, asked.trust)
    simulator = given.simulator
    own = load_catalogue(asked.catalogue, simulator) if asked.catalogue else ()
    recordings = read_recordings([*asked.paths, *asked.hold_out], simulator, asked.mapping)
    fitted, held_out = recordings[: len(asked.paths)], recordings[len(asked.paths) :]
    check_measured(recordings, simulator)
    check_excited(fitted, simulator)
    told = read_told(asked.leave_out, asked.prior, asked.measured, simulator)
    period_s = float(np.median(np.concatenate([np.diff(r.time_s) for r in fitted])))
    whole = whole_catalogue(simulator, own, period_s)
    told.check(simulator, whole)
    inputs = given.inputs if asked.inputs == "auto" and given.inputs else asked.inputs
    return Given(simulator, fitted, held_out, whole, given.faults, inputs, given.inputs, told)


def explain(asked: Request, out: Path) -> Explained:
    """Diagnose, and write ``verdict.json``, ``model.toml`` and ``sizes.csv`` into ``out``; the page comes after them.

    Raises:
        BadInput: the simulator, a recording or the catalogue cannot be used; nothing is written.
    """
    given = read(asked)
    check_writable(out)
    with Progress() as progress:
        return explained(asked, given, out, progress.report)


def explained(asked: Request, given: Given, out: Path, report: Callable[[str, float], None]) -> Explained:
    """As ``explain``, of what was read; ``report`` is told of each stage how much of it is done."""
    # Now that the input is good: the engine takes seconds to import.
    from twinbench.mismatch import diagnose
    from twinbench.mismatch.report.write import write_findings

    made, told = asked.provenance(), given.told
    verdict = diagnose(
        given.simulator,
        given.fitted,
        hold_out=given.held_out,
        catalogue=given.catalogue,
        progress=report,
        faults=given.faults,
        inputs=given.inputs,
        leave_out=told.leave_out,
        prior=told.prior,
        measured=told.measured,
    )
    joined = verdict.diagnosis.joined.inputs
    said = joined if given.model_inputs or joined == "linear" else ""
    values = verdict.values
    model = model_toml(asked.spec, given.simulator, verdict.mechanisms, values, out, asked.catalogue, said)
    notes = [{"name": r.name, "notes": list(r.notes)} for r in (*given.fitted, *given.held_out)]
    document = {**verdict.to_dict(), "recordings": notes, "provenance": made}
    write_findings(document, model, out)
    return Explained(verdict, document)
