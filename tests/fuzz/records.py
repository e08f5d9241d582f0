"""Mutators of the record of an online run, which replay reads: a file of arrays."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from fuzz.cases import ORDERLY, REFUSED, SAME, TOLD, Shelf, pick

RECORDS: Shelf[Path] = Shelf()
mutator = RECORDS
ABOUT, MODEL = "about.json", "model.npz"
Parts = dict[str, np.ndarray]


def _parts(record: Path) -> Parts:
    with np.load(record, allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def _save(record: Path, parts: Parts) -> None:
    with open(record, "wb") as file:
        np.savez(file, allow_pickle=False, **parts)


def _change(record: Path, change: Callable[[Parts], Any]) -> None:
    parts = _parts(record)
    change(parts)
    _save(record, parts)


def _say(record: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Let the record say something else of itself."""

    def of(parts: Parts) -> None:
        about = json.loads(parts[ABOUT].tobytes())
        change(about)
        parts[ABOUT] = _as_bytes(json.dumps(about))

    _change(record, of)


def _as_bytes(text: str) -> np.ndarray:
    return np.frombuffer(text.encode(), np.uint8)


@mutator(SAME)
def nothing(record: Path, rng: np.random.Generator) -> None:
    """The control: it is stored again, and not packed."""
    _save(record, _parts(record))


@mutator(SAME)
def another_part_besides(record: Path, rng: np.random.Generator) -> None:
    _change(record, lambda parts: parts.update({"notes [x]": np.zeros(3)}))


@mutator(REFUSED)
def no_record(record: Path, rng: np.random.Generator) -> None:
    record.write_bytes(pick(rng, (b"", b"PK", b"time_s,p\n0,1\n", rng.bytes(400), b"PK\x03\x04" + rng.bytes(400))))


@mutator(REFUSED)
def a_folder_for_it(record: Path, rng: np.random.Generator) -> None:
    record.unlink()
    pick(rng, (record.mkdir, lambda: None))()


@mutator(REFUSED)
def cut_short(record: Path, rng: np.random.Generator) -> None:
    whole = record.read_bytes()
    record.write_bytes(whole[: int(rng.integers(0, len(whole)))])


@mutator(ORDERLY)
def bytes_flipped(record: Path, rng: np.random.Generator) -> None:
    data = bytearray(record.read_bytes())
    for at in rng.integers(len(data), size=int(rng.integers(1, 30))):
        data[at] ^= 1 << int(rng.integers(8))
    record.write_bytes(bytes(data))


@mutator(REFUSED)
def an_archive_of_other_things(record: Path, rng: np.random.Generator) -> None:
    with zipfile.ZipFile(record, "w") as archive:
        name = pick(rng, ("day.csv", "about.json", "../about.json.npy", "about.json.npy"))
        archive.writestr(zipfile.ZipInfo(name), rng.bytes(90))


@mutator(REFUSED)
def an_array_that_claims_to_be_huge(record: Path, rng: np.random.Generator) -> None:
    claimed = f"({10 ** int(rng.integers(11, 18))},)"
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {claimed}, }}".ljust(117) + "\n"
    with zipfile.ZipFile(record) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members["time_s.npy"] = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()
    with zipfile.ZipFile(record, "w") as archive:
        for name, data in members.items():
            archive.writestr(zipfile.ZipInfo(name), data)  # of no time, so that it is the same again


@mutator(REFUSED)
def a_pickle_for_a_part(record: Path, rng: np.random.Generator) -> None:
    """Nothing but Python files runs Python."""
    parts: dict[str, Any] = _parts(record)
    parts[pick(rng, sorted(parts))] = np.array([{"a": 1}], dtype=object)
    buffer = io.BytesIO()
    np.savez(buffer, **parts)
    record.write_bytes(buffer.getvalue())


@mutator(REFUSED)
def a_part_gone(record: Path, rng: np.random.Generator) -> None:
    _change(record, lambda parts: parts.pop(pick(rng, sorted(parts))))


@mutator(REFUSED)
def a_part_of_another_shape(record: Path, rng: np.random.Generator) -> None:
    def change(parts: Parts) -> None:
        name = pick(rng, sorted(set(parts) - {ABOUT, MODEL}))
        whole = parts[name]
        parts[name] = pick(rng, (whole[:-1], whole[None], whole[:0], np.zeros(()), np.concatenate((whole, whole))))

    _change(record, change)


@mutator(REFUSED)
def a_part_of_another_type(record: Path, rng: np.random.Generator) -> None:
    def change(parts: Parts) -> None:
        name = pick(rng, sorted(set(parts) - {ABOUT, MODEL}))
        parts[name] = parts[name].astype(pick(rng, ("U8", "S8", "c16", "M8[s]")))

    _change(record, change)


@mutator(REFUSED)
def it_says_nothing_of_itself(record: Path, rng: np.random.Generator) -> None:
    texts = ("", "[]", "null", "3", "{}", '"x"', "{", "[" * 100_000, "\x00", "NaN", '{"record_version": 1}')
    _change(record, lambda parts: parts.update({ABOUT: _as_bytes(pick(rng, texts))}))


@mutator(REFUSED)
def it_says_too_little_of_itself(record: Path, rng: np.random.Generator) -> None:
    _say(record, lambda about: about.pop(pick(rng, sorted(about))))


@mutator(REFUSED)
def it_says_something_else_of_itself(record: Path, rng: np.random.Generator) -> None:
    fields = ("record_version", "estimator", "machine", "channels", "outputs", "quantities", "every", "model_sha256")
    values = (None, [], {}, "", "[red]", "gone.py", "../x.py:Mine", -1, 0, 7.5, 10**30, ["p"], [[]], "x" * 5000)
    _say(record, lambda about: about.update({pick(rng, fields): pick(rng, values)}))


@mutator(ORDERLY)
def it_says_something_else_of_its_making(record: Path, rng: np.random.Generator) -> None:
    values = (None, [], {}, "", "[red]", 7, [7], {"a": []}, {"settings": 7, "files": 7}, {"numpy": {"a": "\x1b[31m"}})
    _say(record, lambda about: about.update({pick(rng, ("code", "place", "provenance")): pick(rng, values)}))


@mutator(REFUSED)
def another_model(record: Path, rng: np.random.Generator) -> None:
    """Its checksum does not hold, or does, and the model is none."""

    def change(parts: Parts) -> None:
        parts[MODEL] = np.frombuffer(pick(rng, (b"", rng.bytes(50), parts[MODEL].tobytes()[:-9], b"PK")), np.uint8)
        if rng.random() < 0.5:
            about = json.loads(parts[ABOUT].tobytes())
            about["model_sha256"] = sha256(parts[MODEL].tobytes()).hexdigest()
            parts[ABOUT] = _as_bytes(json.dumps(about))

    _change(record, change)


@mutator(TOLD)
def a_checksum_changed(record: Path, rng: np.random.Generator) -> None:
    def change(parts: Parts) -> None:
        parts["checksums"][int(rng.integers(len(parts["checksums"])))] ^= np.uint64(1 << int(rng.integers(64)))

    _change(record, change)


@mutator(TOLD)
def a_reading_changed(record: Path, rng: np.random.Generator) -> None:
    """One that was used, by a thousandth."""

    def change(parts: Parts) -> None:
        read = np.argwhere(np.isfinite(parts["measured"]) & (parts["measured"] != 0.0))
        parts["measured"][tuple(pick(rng, read))] *= 1.001

    _change(record, change)


@mutator(ORDERLY)
def readings_of_all_kinds(record: Path, rng: np.random.Generator) -> None:
    def change(parts: Parts) -> None:
        name = pick(rng, ("measured", "lag_s", "time_s"))
        at = rng.integers(parts[name].size, size=int(rng.integers(1, 20)))
        parts[name].flat[at] = pick(rng, (np.nan, np.inf, -np.inf, 1e308, -1e308, 0.0, -1.0, 5e-324))

    _change(record, change)


@mutator(ORDERLY)
def what_came_out_of_all_kinds(record: Path, rng: np.random.Generator) -> None:
    def change(parts: Parts) -> None:
        name = pick(rng, sorted(n for n in parts if n.startswith("said.")))
        parts[name] = np.full(parts[name].shape, pick(rng, (np.nan, np.inf, 1e308, 0.0, -1.0)))

    _change(record, change)


@mutator(ORDERLY)
def time_goes_back(record: Path, rng: np.random.Generator) -> None:
    _change(record, lambda parts: parts.update(time_s=parts["time_s"][::-1].copy()))
