"""TOML that others wrote, read or refused in one line."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from data.errors import BadInput

MOST_BYTES = 1 << 20
"""Of a file; the longest that we write have some ten thousand. Without it, a file of gigabytes fills the memory."""


def read_toml(path: Path) -> dict[str, Any]:
    """What a TOML file holds.

    Raises:
        BadInput: unreadable, too large, not UTF-8, not TOML, or nested deeper than the parser goes.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise BadInput(f"{path}: has more than {MOST_BYTES:,} bytes; it cannot be what it is named, check it")
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: not TOML: it is not UTF-8 text; save it as UTF-8") from error
    except RecursionError as error:
        raise BadInput(f"{path}: not TOML: its brackets are nested too deep; mend it") from error
    except BadInput:
        raise
    except ValueError as error:  # a whole number of thousands of figures, too
        raise BadInput(f"{path}: not TOML: {str(error).splitlines()[0]}; mend it or remove it") from error
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}; check the file and its permissions") from error
