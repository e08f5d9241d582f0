"""Where machine code is kept from process to process."""

from __future__ import annotations

import hashlib
import os
import shutil
from pathlib import Path

ROOMS = ("common", "physics", "data", "methods", "baselines", "mismatch", "proof")
"""Where compiled functions live."""
KEPT_VERSIONS = 6
"""Of the sources; older ones' machine code is thrown away. Each takes some 50 MB."""


def settle() -> None:
    """Give every version of our sources its own numba cache.

    numba notices that a file has changed. It does not notice that a function which the file calls has changed. So a
    cache that outlives a change elsewhere would silently run the old code.
    """
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    root = Path(__file__).parent.parent
    digest = hashlib.sha256()
    for room in ROOMS:
        for source in sorted((root / room).rglob("*.py")):
            digest.update(source.read_bytes())
    base = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "twinbench"
    here = base / f"numba-{digest.hexdigest()[:16]}"
    try:
        here.mkdir(parents=True, exist_ok=True)
        versions = sorted(base.glob("numba-*"), key=lambda p: p.stat().st_mtime, reverse=True)
    except OSError:
        return  # no home to write to: numba falls back to its own choice
    for old in versions[KEPT_VERSIONS:]:
        if old != here:
            shutil.rmtree(old, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(here)
