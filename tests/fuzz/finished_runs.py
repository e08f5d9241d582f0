"""Mutators of a finished run's folder, which report, estimate, export and latency read."""

from __future__ import annotations

import hashlib
import io
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fuzz.cases import ORDERLY, REFUSED, SAME, Shelf, pick

RUNS: Shelf[Path] = Shelf()
mutator = RUNS
TABLES = ("scores.csv", "failures.csv", "latency.csv", "cost.csv")
FILES = (*TABLES, "manifest.json")
READ = {"report": REFUSED}
"""Of the files at its top only the report reads all; the others use them for what they say, if at all."""


def _some_file(run: Path, rng: np.random.Generator) -> Path:
    return run / str(pick(rng, FILES))


def _parts(run: Path) -> list[Path]:
    return sorted(run.glob("store/*/*/part.npz"))


def _manifest(run: Path, change: Any) -> None:
    path = run / "manifest.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))


def _table(run: Path, name: str, change: Any) -> None:
    frame = pd.read_csv(run / name).astype(object)
    changed = change(frame)
    (frame if changed is None else changed).to_csv(run / name, index=False)


@mutator(SAME)
def other_files_besides(run: Path, rng: np.random.Generator) -> None:
    (run / "notes [x].txt").write_text("mine")
    (run / "store" / "mine").mkdir()
    (run / "tables").mkdir(exist_ok=True)


@mutator(ORDERLY, **READ)
def a_file_gone(run: Path, rng: np.random.Generator) -> None:
    _some_file(run, rng).unlink()


@mutator(ORDERLY, **READ)
def a_file_empty(run: Path, rng: np.random.Generator) -> None:
    _some_file(run, rng).write_bytes(b"")


@mutator(ORDERLY, **READ)
def a_file_of_garbage(run: Path, rng: np.random.Generator) -> None:
    _some_file(run, rng).write_bytes(rng.bytes(int(rng.integers(1, 3000))))


@mutator(ORDERLY, **READ)
def a_folder_for_a_file(run: Path, rng: np.random.Generator) -> None:
    path = _some_file(run, rng)
    path.unlink()
    path.mkdir()


@mutator(ORDERLY)
def a_file_cut_short(run: Path, rng: np.random.Generator) -> None:
    path = _some_file(run, rng)
    data = path.read_bytes()
    path.write_bytes(data[: int(rng.integers(1, len(data)))])


@mutator(ORDERLY)
def bytes_flipped(run: Path, rng: np.random.Generator) -> None:
    path = _some_file(run, rng)
    data = bytearray(path.read_bytes())
    for at in rng.integers(0, len(data), 3):
        data[int(at)] ^= 1 << int(rng.integers(8))
    path.write_bytes(bytes(data))


@mutator(ORDERLY, **READ)
def a_column_lost(run: Path, rng: np.random.Generator) -> None:
    name = pick(rng, TABLES)
    _table(run, name, lambda frame: frame.drop(columns=str(rng.choice(frame.columns))))


@mutator(ORDERLY, **READ)
def text_for_a_number(run: Path, rng: np.random.Generator) -> None:
    def change(frame: pd.DataFrame) -> None:
        frame.iloc[int(rng.integers(len(frame))), frame.columns.get_loc("value")] = pick(
            rng, ("x", "[red]", "1,5", "--")
        )

    _table(run, "scores.csv", change)


@mutator(ORDERLY)
def absurd_scores(run: Path, rng: np.random.Generator) -> None:
    def change(frame: pd.DataFrame) -> None:
        frame.iloc[int(rng.integers(len(frame))), frame.columns.get_loc("value")] = pick(
            rng, (np.inf, -1e308, 1e308, np.nan, -5.0)
        )

    _table(run, "scores.csv", change)


@mutator(ORDERLY, **READ)
def scores_without_rows(run: Path, rng: np.random.Generator) -> None:
    _table(run, "scores.csv", lambda frame: frame.head(0))


@mutator(ORDERLY)
def scores_that_lack_rows(run: Path, rng: np.random.Generator) -> None:
    _table(run, "scores.csv", lambda frame: frame.sample(frac=rng.uniform(0.02, 0.9), random_state=1))


@mutator(ORDERLY)
def scores_twice(run: Path, rng: np.random.Generator) -> None:
    _table(run, "scores.csv", lambda frame: pd.concat([frame, frame]))


@mutator(ORDERLY)
def names_nobody_knows(run: Path, rng: np.random.Generator) -> None:
    name = pick(
        rng,
        ("[red]x[/]", "$x^2$", "<b>x</b>", "a_b", "null", "x" * 300, "nan", "", "7", "\\frac", "&amp;", "_x", "a\nb"),
    )
    column = pick(rng, ("estimator", "sequence", "metric"))

    def change(frame: pd.DataFrame) -> None:
        frame[column] = name

    _table(run, "scores.csv", change)


@mutator(ORDERLY)
def reasons_of_all_kinds(run: Path, rng: np.random.Generator) -> None:
    reason = pick(rng, ("[/red]", "$\\frac{$", "<script>alert(1)</script>", "x" * 5000, "a\nb", "{{ x }}", "{% raw %}"))
    pd.DataFrame([("mine", 0, "fit", reason)], columns=["estimator", "seed", "stage", "reason"]).to_csv(
        run / "failures.csv", index=False
    )


@mutator(ORDERLY, **READ)
def a_manifest_of_another_type(run: Path, rng: np.random.Generator) -> None:
    (run / "manifest.json").write_text(
        pick(rng, ("[]", "null", "3", '"x"', "true", "[[]]", "NaN", "{}}", "[" * 100_000, ""))
    )


@mutator(ORDERLY)
def a_manifest_of_wrong_fields(run: Path, rng: np.random.Generator) -> None:
    def change(manifest: dict[str, Any]) -> None:
        manifest[pick(rng, sorted(manifest))] = pick(
            rng, (None, 7, "x", [], {}, [1, 2], {"a": "b"}, "[red]", 1e308, True, ["../../../etc/passwd"])
        )

    _manifest(run, change)


@mutator(ORDERLY)
def a_manifest_that_lacks_fields(run: Path, rng: np.random.Generator) -> None:
    def change(manifest: dict[str, Any]) -> None:
        for name in rng.choice(sorted(manifest), int(rng.integers(1, len(manifest))), replace=False):
            del manifest[str(name)]

    _manifest(run, change)


@mutator(ORDERLY)
def a_part_gone(run: Path, rng: np.random.Generator) -> None:
    pick(rng, _parts(run)).unlink()


@mutator(ORDERLY)
def a_part_cut_short(run: Path, rng: np.random.Generator) -> None:
    part = pick(rng, _parts(run))
    part.write_bytes(part.read_bytes()[: int(rng.integers(0, 400))])


@mutator(ORDERLY)
def a_part_of_garbage_with_its_seal(run: Path, rng: np.random.Generator) -> None:
    """Its hash is right: somebody wrote it so."""
    part = pick(rng, _parts(run))
    part.write_bytes(pick(rng, (b"", b"PK\x03\x04", rng.bytes(300), part.read_bytes()[:900])))
    _seal(part)


@mutator(ORDERLY)
def a_part_that_lacks_arrays(run: Path, rng: np.random.Generator) -> None:
    part = pick(rng, _parts(run))
    with np.load(part, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    del arrays[pick(rng, sorted(arrays))]
    _save(part, arrays)


@mutator(ORDERLY)
def a_part_of_other_arrays(run: Path, rng: np.random.Generator) -> None:
    part = pick(rng, _parts(run))
    with np.load(part, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    arrays[pick(rng, sorted(arrays))] = pick(
        rng, (np.zeros(0), np.zeros((2, 2)), np.array("x"), np.full(7, np.nan), np.array(3))
    )
    _save(part, arrays)


@mutator(ORDERLY)
def a_pickle_for_a_part(run: Path, rng: np.random.Generator) -> None:
    """Nothing but Python files runs Python."""
    part = pick(rng, _parts(run))
    buffer = io.BytesIO()
    np.savez(buffer, x=np.array([{"a": 1}], dtype=object))
    part.write_bytes(buffer.getvalue())
    _seal(part)


@mutator(ORDERLY)
def seals_broken(run: Path, rng: np.random.Generator) -> None:
    for seal in run.glob("store/*/*/.done"):
        if rng.random() < 0.5:
            seal.write_bytes(pick(rng, (b"", b"x", b"\xff")))


@mutator(ORDERLY)
def the_store_gone(run: Path, rng: np.random.Generator) -> None:
    shutil.rmtree(pick(rng, [run / "store", *sorted(run.glob("store/*"))]))


@mutator(REFUSED)
def everything_gone(run: Path, rng: np.random.Generator) -> None:
    shutil.rmtree(run)
    pick(rng, (run.mkdir, lambda: None, lambda: run.write_text("a file")))()


def _save(part: Path, arrays: dict[str, np.ndarray]) -> None:
    with open(part, "wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
    _seal(part)


def _seal(part: Path) -> None:
    part.with_name(".done").write_text(hashlib.sha256(part.read_bytes()).hexdigest())
