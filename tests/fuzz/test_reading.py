"""Whatever a recording holds, it is finite numbers or refused in one line; what means the same reads the same."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from helpers.recording_kinds import WRITERS, maps_of
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzz.cases import SAME
from fuzz.given import TANK, Given, written
from fuzz.recording_cells import CELLS
from fuzz.recording_files import FILES, flipped
from fuzz.recording_names import NAMES
from fuzz.recording_time import CLOCK
from fuzz.world import tank_recording
from twinbench.common.errors import BadInput
from twinbench.common.shown import printable
from twinbench.data.look.whole import look
from twinbench.data.look.words import told
from twinbench.data.recording import Recording, read_recording

UNITS = {"pump_V": "V", "h_m": "m"}
TABLE = tank_recording(1, 40)
BESIDES = {
    "columns_in_another_order",
    "another_column_besides",
    "another_column_of_awkward_name",
    "truth_of_another_machine_besides",
    "clock_starts_elsewhere",
}
KINDS, NAMED = (
    {"nothing", "gzipped", "as_parquet"},
    {"nothing", "renamed_and_mapped", "renamed_by_a_sidecar"},
)
MUTATORS = {m.name: m for shelf in (FILES, CELLS, CLOCK, NAMES) for m in shelf.mutators}
LARGE = {"a_bomb_in_gzip", "a_cell_of_megabytes", "very_many_columns"}
"""Mutators that take long, and whose reading other tests see to."""
SPOILT = 12
"""Spoilt files of each kind."""
anything = settings(derandomize=True, deadline=None, max_examples=150)


@contextmanager
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


def read(path: Path, *mapping: str) -> Recording | None:
    """The recording; None where it is refused in one line."""
    try:
        recording = read_recording(path, mapping, units=UNITS, limits={})
    except BadInput as refusal:
        line = str(refusal)
    else:
        return _finite(recording)
    assert line
    assert "\n" not in line
    return None


def _finite(recording: Recording) -> Recording:
    assert np.isfinite(recording.time_s).all()
    assert (np.diff(recording.time_s) > 0).all()
    assert not np.isinf(recording.values).any()
    return recording


def good() -> Given:
    return Given(TANK, TABLE.copy())


@anything
@given(content=st.binary(max_size=2000), kind=st.sampled_from([".csv", ".csv.gz", ".parquet", *WRITERS]))
def test_any_bytes(content, kind):
    with folder() as here:
        (here / f"day{kind}").write_bytes(content)
        read(here / f"day{kind}")


@anything
@given(cells=st.lists(st.lists(st.text(max_size=12), min_size=3, max_size=3), max_size=8))
def test_any_cells(cells):
    with folder() as here:
        rows = ["time_s,pump_V,h_m", *(",".join(row) for row in cells), "90,1,1", "91,1,1"]
        (here / "day.csv").write_text("\n".join(rows), encoding="utf-8", errors="replace")
        read(here / "day.csv")


@anything
@given(numbers=st.lists(st.floats(width=64), min_size=2, max_size=12))
def test_any_numbers_as_stamps_and_readings(numbers):
    with folder() as here:
        rows = ["time_s,pump_V,h_m", *(f"{x!r},{x!r},{-x!r}" for x in numbers)]
        (here / "day.csv").write_text("\n".join(rows))
        read(here / "day.csv")


@anything
@given(unit=st.text(max_size=30) | st.text("mskgKVbar0123456789*/()^ .-", max_size=30))
def test_any_unit(unit):
    with folder() as here:
        read(good().write(here), f"h_m[{unit}]=h_m")


@anything
@given(mapping=st.text(max_size=30) | st.text("h_mpump_V=[]", max_size=20))
def test_any_map(mapping):
    with folder() as here:
        read(good().write(here), mapping)


@anything
@given(text=st.text(max_size=80) | st.text("[channels]\n=\"'{}h_m.0123456789", max_size=80))
def test_any_sidecar(text):
    with folder() as here:
        path = good().write(here)
        (here / "day.toml").write_bytes(text.encode("utf-8", "replace"))
        read(path)


@anything
@given(
    besides=st.lists(st.sampled_from(sorted(BESIDES)), unique=True),
    kind=st.sampled_from(sorted(KINDS)),
    named=st.sampled_from(sorted(NAMED)),
    seed=st.integers(0, 2**32),
)
def test_what_means_the_same_reads_the_same(besides, kind, named, seed):
    rng = np.random.default_rng(seed)
    changed = good()
    for name in (*besides, named, kind):
        assert MUTATORS[name].otherwise == SAME
        MUTATORS[name].spoil(changed, rng)
    with folder() as here:
        recording = read(changed.write(here), *changed.maps)
    assert recording is not None
    np.testing.assert_allclose(recording.values, TABLE[list(UNITS)], rtol=1e-12)
    np.testing.assert_allclose(np.diff(recording.time_s), np.diff(TABLE["time_s"]), rtol=1e-6)


@pytest.mark.parametrize("kind", WRITERS)
def test_a_file_of_another_kind_with_bits_turned_is_read_or_refused(kind):
    data = written(TABLE, kind)
    with folder() as here:
        for seed in range(SPOILT):
            rng = np.random.default_rng(seed)
            whole = flipped(data, rng) if seed % 3 else data[: int(rng.integers(1, len(data)))]
            (here / f"day{kind}").write_bytes(whole)
            read(here / f"day{kind}", *maps_of(kind, list(UNITS)))


@pytest.mark.parametrize("name", sorted(set(MUTATORS) - LARGE))
def test_whatever_is_looked_at_is_told_in_json_or_refused_in_one_line(name):
    spoilt = good()
    MUTATORS[name].spoil(spoilt, np.random.default_rng(1))
    with folder() as here:
        path, refused = spoilt.write(here), ""
        try:
            seen = look(path, spoilt.maps)
        except BadInput as refusal:
            refused = printable(str(refusal))
        assert refused or json.dumps(seen.to_json(), allow_nan=False)
        assert refused or all(told(seen))
