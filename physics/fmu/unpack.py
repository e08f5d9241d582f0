"""An FMU's files: what is in the archive, unpacked once, and the binary of this platform."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import sys
import tempfile
import zipfile
from pathlib import Path

from numba.core import config

from twinbench.physics.fmu.description import Description, describe

SUFFIX = {"linux": ".so", "win32": ".dll", "darwin": ".dylib"}
SYSTEM = {"linux": "linux", "win32": "win", "darwin": "darwin"}
LONG = {"linux": "linux", "win32": "windows", "darwin": "darwin"}


def digest(path: Path) -> str:
    """Of the archive's content; two FMUs with one digest are one."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def opened(path: Path) -> tuple[Description, Path]:
    """What an FMU says, and the folder of its files.

    Raises:
        ValueError: one line: no such file, no FMU.
    """
    if not path.is_file():
        raise ValueError("no such file; check the path")
    folder = _home() / f"twinbench_fmu_{digest(path)[:24]}"
    if not folder.is_dir():
        _extract(path, folder)
    return describe((folder / "modelDescription.xml").read_text(encoding="utf-8")), folder


def _extract(path: Path, folder: Path) -> None:
    """Unpack beside, then rename: two processes that come at once do not get in each other's way."""
    try:
        with zipfile.ZipFile(path) as archive:
            if "modelDescription.xml" not in archive.namelist():
                raise ValueError("holds no modelDescription.xml; is it an FMU?")
            folder.parent.mkdir(parents=True, exist_ok=True)
            part = Path(tempfile.mkdtemp(dir=folder.parent))
            archive.extractall(part)
    except zipfile.BadZipFile:
        raise ValueError("is no zip archive, so no FMU; export it again") from None
    try:
        os.rename(part, folder)
    except OSError:
        shutil.rmtree(part, ignore_errors=True)
        if not folder.is_dir():
            raise


def _home() -> Path:
    """Where compiled code is kept."""
    return Path(config.CACHE_DIR or Path(tempfile.gettempdir()) / "twinbench")  # type: ignore[attr-defined]


def platform_of(version: str) -> str:
    """What FMI 2 or 3 calls this platform."""
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower())
    old = f"{SYSTEM[sys.platform]}{'64' if sys.maxsize > 2**32 else '32'}"
    return old if version == "2" else f"{machine}-{LONG[sys.platform]}"


def binary(description: Description, folder: Path) -> Path:
    """The library to load.

    Raises:
        ValueError: one line: none for this platform; it says for which there are.
    """
    wanted = platform_of(description.version)
    file = folder / "binaries" / wanted / f"{description.identifier}{SUFFIX[sys.platform]}"
    if not file.is_file():
        there = sorted(p.name for p in (folder / "binaries").glob("*")) or ["no platform"]
        raise ValueError(f"has no binary for {wanted}, but for {', '.join(there)}; export it for this platform")
    return file
