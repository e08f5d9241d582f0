"""The binary of an FMU that is written: compiled equations linked with the wrapper that speaks FMI."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

HERE = Path(__file__).parent
SOURCES = (HERE / "wrapper.c", HERE / "numba_runtime.c")
COMPILER = "cc"
FLAGS = (
    "-std=c11", "-O2", "-fPIC", "-shared",
    "-ffp-contract=off",  # every multiplication is rounded, as numba rounds it
    "-Wl,--no-undefined",  # what is missing is missed here, and not where the FMU is loaded
    "-Xlinker", f"--version-script={HERE / 'exported.map'}",
    "-Wl,--strip-all",
)  # fmt: skip


def compiler() -> str:
    """The path of the C compiler.

    Raises:
        ValueError: one line: there is none, or this is no Linux.
    """
    if sys.platform != "linux":
        raise ValueError(f"an FMU is written on Linux only so far, and this is {sys.platform}; write it there")
    found = shutil.which(COMPILER)
    if found is None:
        raise ValueError(f"an FMU needs a C compiler, and there is no {COMPILER} here; install gcc or clang")
    return found


def link(objects: Mapping[str, bytes], folder: Path, name: str) -> Path:
    """Make ``folder/name.so`` of object files, the wrapper, and its header that is in the folder.

    Raises:
        ValueError: one line: the equations need what only Python has.
    """
    files = []
    for function, content in objects.items():
        files.append(folder / f"{function}.o")
        files[-1].write_bytes(content)
    library = folder / f"{name}.so"
    command = [compiler(), *FLAGS, "-I", str(folder), "-o", str(library), *map(str, (*SOURCES, *files)), "-lm"]
    done = subprocess.run(
        command, capture_output=True, text=True, errors="replace", check=False, env={**os.environ, "LC_ALL": "C"}
    )
    if done.returncode:
        raise ValueError(_refusal(done.stderr))
    return library


def _refusal(said: str) -> str:
    """Why the equations could not be linked, in one line."""
    missing = sorted(set(re.findall(r"undefined (?:reference to|symbol:?) [`'\"]?(\w+)", said)))
    if missing:
        return (
            f"its equations need {', '.join(missing)}, which is not to be had without Python; write them without "
            "matrix products, numpy.linalg, print and the like"
        )
    return f"the C compiler fails: {(said.strip().splitlines() or ['it does not say why'])[-1]}"
