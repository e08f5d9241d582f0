"""The store: a part is there whole or not at all."""

from __future__ import annotations

import errno
import hashlib
import os
from pathlib import Path

import pytest

from twinbench.common.store import CannotWrite, Store, check_writable, key_of, sweep, write_atomically, write_text


def full_disk(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def listing(folder: Path) -> list[str]:
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))


def write_hello(path: Path) -> None:
    path.write_text("hello")


def test_a_part_is_marked_done_with_its_sha256(tmp_path: Path) -> None:
    store = Store(tmp_path)
    part = store.put("fit", "k", write_hello)
    assert part.read_text() == "hello"
    assert (part.parent / ".done").read_text() == hashlib.sha256(b"hello").hexdigest()
    assert listing(tmp_path) == ["fit", "fit/k", "fit/k/.done", "fit/k/part.npz"]
    assert store.has("fit", "k")


@pytest.mark.parametrize(
    "damage",
    [
        lambda part: part.write_text("hellp"),
        lambda part: part.write_text("hell"),
        lambda part: part.unlink(),
        lambda part: (part.parent / ".done").unlink(),
        lambda part: (part.parent / ".done").write_text(""),
    ],
)
def test_a_damaged_part_counts_as_none_until_it_is_put_again(tmp_path: Path, damage) -> None:
    store = Store(tmp_path)
    damage(store.put("fit", "k", write_hello))
    assert not store.has("fit", "k")
    store.put("fit", "k", write_hello)
    assert store.has("fit", "k")


def test_an_exception_in_write_leaves_the_old_file_and_nothing_beside(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    write_text(target, "old")

    def half(path: Path) -> None:
        path.write_text("ne")
        raise RuntimeError("power cut")

    with pytest.raises(RuntimeError, match="power cut"):
        write_atomically(target, half)
    assert target.read_text() == "old"
    with pytest.raises(RuntimeError, match="power cut"):
        write_atomically(tmp_path / "new" / "folder" / "b.txt", half)
    assert listing(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
    monkeypatch.setattr(os, call, full_disk)
    with pytest.raises(CannotWrite, match="No space left on device; give --out") as caught:
        Store(tmp_path).put("fit", "k", write_hello)
    assert "\n" not in str(caught.value)
    assert listing(tmp_path) == []


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CannotWrite, match=r"cannot write .*: Not a directory; give --out") as caught:
        check_writable(tmp_path / "file" / "out")
    assert "\n" not in str(caught.value)


def test_check_writable_leaves_nothing(tmp_path: Path) -> None:
    check_writable(tmp_path / "out" / "deeper")
    assert listing(tmp_path) == []


@pytest.mark.parametrize("name", ["a" * 300, "file/x"])
def test_a_folder_that_cannot_be_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CannotWrite):
        check_writable(tmp_path / name)
    assert listing(tmp_path) == ["file"]


def test_sweep_takes_what_a_kill_left_and_no_more(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    part = store.put("fit", "k", write_hello)
    write_text(tmp_path / "tables" / "comparison.md", "")
    write_text(tmp_path / "figures" / "bars.svg", "")
    write_text(tmp_path / "elsewhere" / ".theirs.part", "")
    whole = listing(tmp_path)
    for folder in (part.parent, tmp_path, tmp_path / "tables", tmp_path / "figures"):
        (folder / ".part.npz.abc.part").write_text("half")
    sweep(tmp_path)
    assert listing(tmp_path) == whole
    store.clear()
    assert not store.has("fit", "k")


def test_keys_depend_on_every_axis_and_not_on_their_order() -> None:
    assert key_of(a=1, b=2) == key_of(b=2, a=1)
    assert len({key_of(a=1), key_of(a=2), key_of(b=1), key_of(a="1"), key_of(a=1, b=None)}) == 5
