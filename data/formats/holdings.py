"""What a file of any kind holds, how much of it may be read, and how a library that reads it is asked for."""

from __future__ import annotations

import contextlib
import importlib
import io
import logging
import sys
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from twinbench.common.errors import BadInput

if TYPE_CHECKING:
    import pandas as pd

TIME = "time_s"
"""Name of the clock's column, in seconds."""
MOST_CELLS = 250_000_000
"""Rows times columns; fourteen days of the compressor at 20 Hz are 194 million. As numbers they take two gigabytes."""


class Zero(NamedTuple):
    """The moment at which a clock shows 0.

    Attributes:
        ns: nanoseconds since 1970.
        utc: counted in UTC; else on a clock in a zone that nobody told.
    """

    ns: int
    utc: bool


@dataclass(frozen=True)
class Holdings:
    """What a file holds.

    Attributes:
        table: its columns, each as it is there, one row a sample.
        units: of the columns for which the file states one; a column may be missing.
        zero: when ``time_s`` is 0; None where the file does not say.
        left_out: what it holds besides, that is no column.
    """

    table: pd.DataFrame
    units: Mapping[str, str] = field(default_factory=dict)
    zero: Zero | None = None
    left_out: tuple[str, ...] = ()


def too_large(path: Path, rows: int, columns: int) -> BadInput:
    """The refusal of a table that has too many cells."""
    return BadInput(
        f"{path}: holds {rows:,} rows of {columns:,} columns, at most {MOST_CELLS:,} cells can be read; "
        "split it, keep every tenth row, or only the columns that are read"
    )


def library(module: str, package: str, extra: str, path: Path) -> Any:
    """A module that not everybody has installed.

    Raises:
        BadInput: it is not there.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise BadInput(
            f"{path}: reading such files needs {package}; install it with: pip install 'twinbench[{extra}]'"
        ) from error


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Libraries say nothing of what they stumble over in a file: what comes of it is told in one line."""
    before, unraisable = logging.root.manager.disable, sys.unraisablehook
    logging.disable(logging.CRITICAL)
    sys.unraisablehook = lambda _: None
    nowhere = io.StringIO()
    try:
        with contextlib.redirect_stdout(nowhere), contextlib.redirect_stderr(nowhere), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        sys.unraisablehook = unraisable
        logging.disable(before)
