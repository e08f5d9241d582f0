"""What a machine obeys. Importing any of our packages first settles where compiled code is kept."""

from __future__ import annotations

import hashlib
import os
import shutil
from pathlib import Path

_KEPT_VERSIONS = 6


def _settle_compiled_code() -> None:
    """Give every version of our sources its own numba cache.

    numba notices that a file has changed, not that a function which the file calls has; a cache that
    outlives a change elsewhere would silently run the old code.
    """
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    root = Path(__file__).parent.parent
    digest = hashlib.sha256()
    for package in ("physics", "data", "methods", "baselines", "mismatch"):  # where compiled code lives
        for source in sorted((root / package).glob("*.py")):
            digest.update(source.read_bytes())
    base = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "twinbench"
    here = base / f"numba-{digest.hexdigest()[:16]}"
    try:
        here.mkdir(parents=True, exist_ok=True)
        versions = sorted(base.glob("numba-*"), key=lambda p: p.stat().st_mtime, reverse=True)
    except OSError:
        return  # no home to write to: numba falls back to its own choice
    for old in versions[_KEPT_VERSIONS:]:
        if old != here:
            shutil.rmtree(old, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(here)


_settle_compiled_code()
