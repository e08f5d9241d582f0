"""What an estimate was made from: settings, a user's files, and what the run's store holds of the estimator."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from twinbench.bench.cells import Cell
from twinbench.common.documents import made_from, read_file
from twinbench.common.store import Store


class Trained(NamedTuple):
    """A trained estimator, and how it was asked for.

    Attributes:
        name, profile: as given; each may be the path of a file.
        machine: its name, or the path of the file it comes from.
        results: the run's folder.
    """

    name: str
    profile: str
    machine: str
    results: Path
    store: Store
    cell: Cell

    def provenance(self, mapping: Sequence[str], force: bool, delay_s: float) -> dict[str, Any]:
        """As every summary holds it, but for the recording's own files."""
        settings = {
            "estimator": self.name,
            "profile": self.profile,
            "results": self.results.as_posix(),
            "machine": self.machine,
            "map": mapping,
            "force": force,
            "delay_s": delay_s,
            "seed": self.cell.seed,
        }
        return made_from(settings, self._files())

    def _files(self) -> Iterator[dict[str, Any]]:
        for role, spec in (("estimator", self.name), ("profile", self.profile), ("machine", self.machine)):
            yield from read_file(role, spec)
        for role, kind, key in (("training", "fit", self.cell.fit), ("calibration", "estimate", self.cell.estimates)):
            if self.store.has(kind, key):
                part = self.store.path(kind, key).relative_to(self.store.root.parent)
                yield from read_file(role, self.results / part)
