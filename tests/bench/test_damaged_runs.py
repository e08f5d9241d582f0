"""A run's folder that was damaged is refused in one line that names the file."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.sample_run import write_run

from twinbench.bench.results import load_results
from twinbench.common.errors import BadInput


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return write_run(tmp_path, {"oracle": 1.0, "gru_kf": 2.0}, sequences=3, seconds=120)


def read_all(out: Path) -> None:
    results = load_results(out)
    results.truth()
    list(results.estimates())


def refusal(out: Path) -> str:
    """The line that everything that a report reads ends in."""
    with pytest.raises(BadInput) as caught:
        read_all(out)
    line = str(caught.value)
    assert "\n" not in line
    return line


def change(path: Path, column: str, value: object, row: int = 4) -> None:
    frame = pd.read_csv(path).astype(object)
    frame.loc[row, column] = value
    frame.to_csv(path, index=False)


def test_the_sample_is_whole(out):
    results = load_results(out)
    assert results.truth() is not None
    assert len(list(results.estimates())) == 2


@pytest.mark.parametrize(("column", "value"), [("value", "x"), ("value", np.inf), ("seed", "zero"), ("seed", "")])
def test_a_score_that_is_no_number_is_told_by_its_row(out, column, value):
    change(out / "scores.csv", column, value)
    assert "scores.csv: row 6" in refusal(out)


def test_a_score_without_a_name_and_one_given_twice(out):
    change(out / "scores.csv", "metric", "")
    assert "row 6 has no metric" in refusal(out)
    scores = write_run(out, {"oracle": 1.0}, sequences=3, seconds=120) / "scores.csv"
    frame = pd.read_csv(scores)
    pd.concat([frame, frame.tail(1)]).to_csv(scores, index=False)
    assert f"row {len(frame) + 2} gives the same score a second time" in refusal(out)


def test_a_table_without_rows(out):
    (out / "scores.csv").write_text("estimator,seed,sequence,metric,value\n")
    assert "has no rows" in refusal(out)


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("profile", True, "profile is True, must be a table"),
        ("seeds", [0, "x"], "an entry of seeds is 'x', must be a whole number"),
        ("estimates_keys", [7], "must be text"),
        ("data_key", None, "data_key is None"),
        ("wall_s", {"fit": "long"}, "wall_s.fit is 'long', must be a number"),
        ("scenes", {"takes": [[1, 2]]}, "must be text"),
        ("made", {"oracle": {"estimates": "k"}}, "made.oracle.estimates is 'k', must be a list"),
    ],
)
def test_a_field_of_the_manifest_of_another_kind(out, name, value, says):
    path = out / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {name: value}))
    assert says in refusal(out)


@pytest.mark.parametrize("text", ["[]", "null", "3", "{", "[" * 100_000, ""])
def test_a_manifest_that_is_none(out, text):
    (out / "manifest.json").write_text(text)
    assert "manifest.json" in refusal(out)


def sealed(part: Path) -> None:
    part.with_name(".done").write_text(hashlib.sha256(part.read_bytes()).hexdigest())


@pytest.mark.parametrize("kind", ["data", "estimate"])
@pytest.mark.parametrize("spoilt", ["garbage", "lacks", "shape"])
def test_a_part_of_the_store_whose_seal_is_right_and_whose_arrays_are_not(out, kind, spoilt):
    part = sorted(out.glob(f"store/{kind}/*/part.npz"))[0]
    with np.load(part, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    name = {"data": "test.measured", "estimate": "mean"}[kind]
    arrays = {n: a for n, a in arrays.items() if n != name} | ({name: np.zeros(3)} if spoilt == "shape" else {})
    with open(part, "wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
    if spoilt == "garbage":
        part.write_bytes(b"PK\x03\x04 and no more")
    sealed(part)
    assert f"cannot use {part}" in refusal(out)


def test_a_seal_that_is_no_text_is_a_broken_one(out):
    next(out.glob("store/data/*/.done")).write_bytes(b"\xff")
    assert load_results(out).truth() is None
