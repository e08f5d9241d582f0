"""TOML that others wrote, read or refused in one line."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from twinbench.common.errors import BadInput

MOST_TOML_BYTES = 1 << 20
"""Of a file; the longest that we write have some ten thousand. Without it, a file of gigabytes fills the memory."""
MOST_NESTED = 16
"""Tables and lists inside each other; what we write has three. Without it, a message that shows a value has no end."""
MOST_BITS = 63
"""Of a whole number, the sign apart: so much TOML promises, and Python prints no number of thousands of figures."""


def read_toml(path: Path) -> dict[str, Any]:
    """What a TOML file holds.

    Raises:
        BadInput: unreadable, too large, not UTF-8, not TOML, nested too deep, or with a number too large.
    """
    try:
        if path.stat().st_size > MOST_TOML_BYTES:
            raise BadInput(f"{path}: has more than {MOST_TOML_BYTES:,} bytes; it cannot be what it is named, check it")
        content = tomllib.loads(path.read_text(encoding="utf-8-sig"))
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
    _check(content, path)
    return content


def _check(content: dict[str, Any], path: Path) -> None:
    """Refuse what is nested too deep to be looked at, and numbers too large to be printed."""
    waiting: list[tuple[Any, int]] = [(content, 0)]
    while waiting:
        value, depth = waiting.pop()
        if depth > MOST_NESTED:
            raise BadInput(f"{path}: nests tables or lists more than {MOST_NESTED} deep; check it, or remove it")
        if isinstance(value, int) and value.bit_length() > MOST_BITS:
            raise BadInput(f"{path}: a whole number must have {MOST_BITS} bits at most, one has {value.bit_length()}")
        if isinstance(value, dict | list):
            inside = value.values() if isinstance(value, dict) else value
            waiting += [(v, depth + 1) for v in inside]
