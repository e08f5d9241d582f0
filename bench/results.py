"""What a run left in its folder, read back for the report."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from twinbench.bench.cells import load_batches, split_at
from twinbench.bench.estimates import Estimates
from twinbench.bench.manifest import read_manifest, unusable
from twinbench.bench.scenes import KIND, RECORDINGS
from twinbench.bench.statistics.subject import PAPERS, Subject
from twinbench.common.errors import BadInput
from twinbench.common.store import Store
from twinbench.data.batch import Batch
from twinbench.machines.compressor import COMPRESSOR

COLUMNS = {
    "scores.csv": ("estimator", "seed", "sequence", "metric", "value"),
    "failures.csv": ("estimator", "seed", "stage", "reason"),
    "latency.csv": (
        "estimator", "mode", "implementation", "window", "p50_us", "p95_us", "p99_us", "max_us", "memory_kB",
    ),
    "cost.csv": ("estimator", "seed", "stage", "cpu_s"),
}  # fmt: skip

NUMBERS = ("seed", "value", "window", "p50_us", "p95_us", "p99_us", "max_us", "memory_kB", "cpu_s")
KEY = ("estimator", "seed", "group", "condition", "sequence", "metric")
"""Columns that together say what a score is of."""
HARDER = ("estimator", "seed", "group", "condition", "sequence", "metric", "value")
"""Columns of ``robustness.csv``, which only a run with --robustness leaves."""


@dataclass(frozen=True)
class Results:
    """The tables of one run; the estimates stay in the store until they are asked for."""

    out: Path
    scores: pd.DataFrame
    failed_cells: pd.DataFrame
    latency: pd.DataFrame
    cost: pd.DataFrame
    robustness: pd.DataFrame
    manifest: dict[str, Any]

    @property
    def failures(self) -> dict[str, str]:
        """Per estimator whose estimates are incomplete, which cells failed and why."""
        said: dict[str, list[str]] = {}
        for estimator, seed, stage, reason in self.failed_cells.to_numpy():
            if stage != "latency":
                said.setdefault(str(estimator), []).append(f"seed {seed}, {stage}: {reason}")
        return {estimator: "; ".join(reasons) for estimator, reasons in said.items()}

    def estimates(self) -> Iterator[Estimates]:
        """The run's stored estimates, one cell at a time; those no longer in the store are left out."""
        store = Store(self.out / "store")
        for key in self.manifest.get("estimates_keys", []):
            if store.has("estimate", key):
                yield Estimates.load(store.path("estimate", key))

    def truth(self) -> Batch | None:
        """The test recordings with their truth; None if they are no longer in the store."""
        store, key = Store(self.out / "store"), self.manifest.get("data_key", "")
        if not store.has("data", key):
            return None
        try:
            return split_at(store, key, str(self.manifest.get("profile", {}).get("machine", COMPRESSOR.name))).test
        except BadInput as error:  # the machine's file is no longer where it was
            raise unusable(self.out / "manifest.json", str(error)) from error

    @property
    def subject(self) -> Subject:
        """What the run was about; the compressor where its manifest says nothing."""
        found = self.manifest.get("subject")
        try:
            return Subject.from_json(found) if found else PAPERS
        except (KeyError, TypeError) as error:
            raise unusable(
                self.out / "manifest.json", f"subject does not say what the run is about ({error})"
            ) from error

    def scenes(self) -> Iterator[tuple[Batch, Estimates]]:
        """Recordings of each scene with their truth, and each estimator's estimates of them, one at a time."""
        store, filmed = Store(self.out / "store"), self.manifest.get("scenes", {})
        if not store.has(RECORDINGS, filmed.get("recordings", "")):
            return
        recordings = load_batches(store.path(RECORDINGS, filmed["recordings"]))
        for scene, key in filmed["takes"]:
            if store.has(KIND, key) and scene in recordings:
                yield recordings[scene], Estimates.load(store.path(KIND, key))


def load_results(out: Path) -> Results:
    """Read a run's folder.

    Raises:
        BadInput: a file is missing, unreadable, or not what a run writes.
    """
    tables = {name: _read_csv(out / name, columns) for name, columns in COLUMNS.items()}
    if tables["scores.csv"].empty:
        raise unusable(out / "scores.csv", "has no rows")
    manifest = read_manifest(out / "manifest.json")
    robustness = pd.DataFrame(columns=list(HARDER))
    if manifest.get("robustness"):
        robustness = _read_csv(out / "robustness.csv", HARDER)
    scores, failures, latency, cost = (tables[name] for name in COLUMNS)
    return Results(out, scores, failures, latency, cost, robustness, manifest)


def cost_of(out: Path) -> pd.DataFrame:
    """The table of costs alone: scores are many.

    Raises:
        BadInput: it is missing, unreadable, or not what a run writes.
    """
    return _read_csv(out / "cost.csv", COLUMNS["cost.csv"])


def _read_csv(path: Path, columns: tuple[str, ...]) -> pd.DataFrame:
    texts = [column for column in columns if column not in NUMBERS]
    try:
        # Only an empty cell is a missing value: an estimator may be called "null", or "7".
        frame = pd.read_csv(path, keep_default_na=False, na_values=[""], dtype=dict.fromkeys(texts, str))
    except OSError as error:
        raise unusable(path, error.strerror or str(error)) from error
    except ValueError as error:
        raise unusable(path, f"not a table: {error}") from error
    if missing := [column for column in columns if column not in frame.columns]:
        raise unusable(path, f"no column {missing[0]!r}")
    for column in columns:
        frame[column] = _checked(frame[column], path)
    key = [column for column in columns if column in KEY]
    if "metric" in key and frame.duplicated(key).any():
        raise unusable(path, f"row {_row(frame.duplicated(key))} gives the same score a second time")
    return frame[list(columns)]


def _checked(cells: pd.Series, path: Path) -> pd.Series:
    """A column with numbers where there should be some, and names where there should be names."""
    if cells.name in KEY and cells.isna().any():
        raise unusable(path, f"row {_row(cells.isna())} has no {cells.name}")
    if cells.name not in NUMBERS:
        return cells
    numbers = pd.to_numeric(cells, errors="coerce")
    wrong = numbers.isna() & cells.notna() | np.isinf(numbers)
    if wrong.any():
        raise unusable(path, f"row {_row(wrong)}, column {cells.name}: {str(cells[wrong].iloc[0])[:40]!r} is no number")
    return numbers


def _row(wrong: pd.Series) -> int:
    """Line of the file, the header being line 1."""
    return int(np.flatnonzero(wrong)[0]) + 2
