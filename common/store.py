"""A content-addressed store that survives kill -9: a part exists once its ``.done`` does.

``OUT/store/<kind>/<key>/part`` is written beside and renamed; ``.done`` holds its sha256 and is
written last, the same way. A part without a matching ``.done`` is as good as none.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twinbench.common.attempts import AT_WORK
from twinbench.common.errors import BadInput

if TYPE_CHECKING:
    import pandas as pd

PARTIAL = ".part"
log = logging.getLogger(__name__)


def key_of(**axes: Any) -> str:
    """The name of a part: a hash of everything its content depends on."""
    text = json.dumps(axes, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:24]


class CannotWrite(BadInput):
    """The folder cannot be written to, or the disk is full."""


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a file beside ``path``, then rename it there; nothing half-written is left.

    Raises:
        CannotWrite: the folder cannot be written to, or the disk is full.
    """
    beside: Path | None = None
    made: list[Path] = []
    try:
        made = [folder for folder in path.parents if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=PARTIAL)
        os.close(handle)
        beside = Path(name)
        write(beside)
        with open(beside, "rb+") as file:
            os.fsync(file.fileno())
        os.chmod(beside, 0o644)
        os.replace(beside, path)
        log.info("wrote %s", path)
    except BaseException as error:
        if beside is not None:
            beside.unlink(missing_ok=True)
        for folder in made:
            # Another process may have put something there by now.
            with contextlib.suppress(OSError):
                folder.rmdir()
        if isinstance(error, OSError):
            raise CannotWrite(
                f"cannot write {path}: {error.strerror or error}; give --out a folder with room that you may write to"
            ) from error
        raise


def write_text(path: Path, text: str) -> None:
    """Write text atomically."""
    write_atomically(path, lambda beside: beside.write_text(text, encoding="utf-8"))


def write_csv(path: Path, table: pd.DataFrame) -> None:
    """Write a table atomically, without its index."""
    write_atomically(path, lambda beside: table.to_csv(beside, index=False))


def check_writable(folder: Path) -> None:
    """See that a folder takes files and has room for one, and leave nothing: what comes next may refuse its input.

    Raises:
        CannotWrite: they cannot.
    """

    def leave_nothing(beside: Path) -> None:
        with open(beside, "wb") as file:
            file.write(b"room?")
            file.flush()
            os.fsync(file.fileno())
        raise _Writable

    with contextlib.suppress(_Writable):
        write_atomically(folder / ".writable", leave_nothing)


class _Writable(Exception):
    """A file could be made."""


def sweep(out: Path) -> None:
    """Remove what a killed run was writing into ``out``. Not while another run writes to the same folder."""
    for folder in ("", "tables/", "figures/", "store/*/*/"):
        for beside in out.glob(f"{folder}.*{PARTIAL}"):
            beside.unlink(missing_ok=True)
    for marks in out.glob(f".{AT_WORK}*"):
        shutil.rmtree(marks, ignore_errors=True)


@contextlib.contextmanager
def reading(part: Path) -> Iterator[None]:
    """Whatever goes wrong where a part is read, it is not what a run wrote.

    Raises:
        BadInput: one line that names the file.
    """
    try:
        yield
    except BadInput:
        raise
    except Exception as error:
        why = f"{type(error).__name__}: {error}".splitlines()[0]
        raise BadInput(f"cannot use {part}: {why}; remove it, and twinbench run makes it again") from error


class Store:
    """Parts under one folder."""

    def __init__(self, root: Path) -> None:
        # Workers may have been started in another folder.
        self.root = root.absolute()

    def path(self, kind: str, key: str, suffix: str = ".npz") -> Path:
        """Where a part lives, finished or not."""
        return self.root / kind / key / f"part{suffix}"

    def has(self, kind: str, key: str, suffix: str = ".npz") -> bool:
        """Is the part there, whole?"""
        part = self.path(kind, key, suffix)
        done = part.with_name(".done")
        try:
            return done.read_bytes() == sha256_of(part).encode()
        except OSError:
            return False

    def put(self, kind: str, key: str, write: Callable[[Path], None], suffix: str = ".npz") -> Path:
        """Write a part and mark it done."""
        part = self.path(kind, key, suffix)
        write_atomically(part, write)
        write_text(part.with_name(".done"), sha256_of(part))
        return part

    def forget(self, kind: str, key: str) -> None:
        """Remove a part and what stands beside it."""
        shutil.rmtree(self.root / kind / key, ignore_errors=True)

    def clear(self) -> None:
        """Forget everything."""
        shutil.rmtree(self.root, ignore_errors=True)


def sha256_of(path: Path) -> str:
    """Hexadecimal digest of a file, read in parts."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
