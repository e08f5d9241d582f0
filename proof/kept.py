"""What an earlier run of a proof found of a case, so that the same command goes on where it stopped."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def kept(path: Path, key: str = "") -> dict[str, Any] | None:
    """What is kept of a case; None if there is nothing, or by other code.

    Args:
        key: of the case and the code that it must have been made by; any will do if empty.
    """
    try:
        known = dict(json.loads(path.read_text()))
    except (OSError, ValueError):
        return None
    return known if not key or known.get("key") == key else None
