"""What a result depends on besides its configuration: the code, the libraries, the machine."""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.metadata
import importlib.util
import json
import os
import platform
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twinbench.common.store import write_text

PACKAGE = "twinbench"
_ROOT = Path(__file__).resolve().parents[1]
LIBRARIES = ("numpy", "scipy", "numba", "torch", "filterpy", "scikit-learn", "pandas")


def code_version(module: str) -> str:
    """sha256 over the source of a module and of all of ours that it imports, directly or not."""
    path = _file(module)
    # A plug-in's name may stand for another file by now, or for the same one edited.
    return _version(module, Path(path).read_bytes() if path else b"")


@functools.cache
def source_version(checkout: Path) -> str:
    """sha256 over all source of a checkout of Twinbench."""
    files = {str(path.relative_to(checkout)): path for path in checkout.glob("[!.]*/**/*.py")}
    return _hashed(files)


@functools.cache
def own_source() -> str:
    """sha256 over all source of this Twinbench, wherever it is installed, and its libraries' versions."""
    root = Path(sys.modules[PACKAGE].__file__ or "").parent
    rooms = [folder for folder in root.iterdir() if (folder / "__init__.py").is_file()]
    files = {str(path.relative_to(root)): path for room in rooms for path in room.rglob("*.py")}
    libraries = "".join(f"{name}=={importlib.metadata.version(name)}" for name in LIBRARIES)
    return _hashed(files, last=libraries.encode())


@functools.cache
def _version(module: str, source: bytes) -> str:
    libraries = "".join(f"{name}=={importlib.metadata.version(name)}" for name in LIBRARIES[:4])
    return _hashed({name: Path(path) for name, path in _closure(module).items()}, source, libraries.encode())


def _hashed(files: Mapping[str, Path], first: bytes = b"", last: bytes = b"") -> str:
    """sha256 over files and what each is called, with some bytes before and after them; its first 16 digits."""
    digest = hashlib.sha256(first)
    for name, path in sorted(files.items()):
        digest.update(name.encode())
        digest.update(path.read_bytes())
    digest.update(last)
    return digest.hexdigest()[:16]


def _closure(module: str) -> dict[str, str]:
    found: dict[str, str] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        path = _file(name)
        if path is None:
            continue
        found[name] = path
        waiting += [n for n in _imports(Path(path)) if n.partition(".")[0] == PACKAGE]
    return found


def _file(module: str) -> str | None:
    loaded = getattr(sys.modules.get(module), "__file__", None)
    if loaded:
        return str(loaded)
    spec = importlib.util.find_spec(module)
    return spec.origin if spec else None


def _imports(path: Path) -> list[str]:
    names = []
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.append(node.module)
    return names


def provenance() -> dict[str, Any]:
    """Commit, versions and machine, for a manifest."""
    return {
        "twinbench": importlib.metadata.version("twinbench"),
        **dict(zip(("commit", "uncommitted_changes"), _commit(), strict=True)),
        "python": platform.python_version(),
        "versions": {name: importlib.metadata.version(name) for name in LIBRARIES},
        "machine": {
            "system": f"{platform.system()} {platform.release()}",
            "processor": _processor(),
            "cores": os.cpu_count(),
            "load_1min": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        },
    }


def write_manifest(folder: Path, command: str, seed: int, **more: Any) -> None:
    """Write ``manifest.json``: the command that made the folder, its seed, more facts, and ``provenance``."""
    about = {"command": command, "seed": seed, **more, **provenance()}
    write_text(folder / "manifest.json", json.dumps(about, indent=2) + "\n")


def version() -> str:
    """``0.1.0``, and in a checkout the commit."""
    commit, changed = _commit()
    changes = ", with uncommitted changes" if changed else ""
    return importlib.metadata.version("twinbench") + (f", commit {commit}{changes}" if commit else "")


def _commit(root: Path = _ROOT) -> tuple[str | None, bool | None]:
    """Twinbench's own commit and whether files differ from it; None where ``root`` is not its own checkout.

    Files in ``results/`` do not count: they are what runs leave, and a run that writes there is no other run for it.
    Installed into somebody's repository, the code around it is theirs: their commit says nothing of ours.
    """
    own = root / "pyproject.toml"
    try:
        ours = tomllib.loads(own.read_text(encoding="utf-8"))["project"]["name"] == "twinbench"
    except (OSError, ValueError, KeyError, TypeError):
        return None, None
    top = _git(root, "rev-parse", "--show-toplevel")
    if not ours or top is None or Path(top).resolve() != root.resolve():
        return None, None
    if _git(root, "ls-files", "--error-unmatch", own.name) is None:
        return None, None
    commit = _git(root, "rev-parse", "HEAD")
    return commit, bool(_git(root, "status", "--porcelain", "--", ".", ":(exclude)results")) if commit else None


def _git(root: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
