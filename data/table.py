"""A recording's file as a table: what is no table, or larger than can be read, is refused in one line."""

from __future__ import annotations

import logging
import os
import re
import zlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.shown import bare, printable, shown
from twinbench.data.formats.holdings import Holdings, quiet
from twinbench.data.formats.kinds import READERS, kind_of
from twinbench.machines.coordinates import Array

if TYPE_CHECKING:
    import pandas as pd

TRUTH_PREFIX = "true_"
LARGEST_READING = 1e30
"""No reading in any unit is larger, and sums of squares of this are still numbers."""
_TEXT = (".csv", ".csv.gz")
_DATE = re.compile(r"\d{4}-\d\d?-\d\d?|\d\d?[./]\d\d?[./]\d{2,4}|\d\d?:\d\d")
_LOG = logging.getLogger("twinbench")


def read_table(path: Path) -> Holdings:
    """The file's columns but for the truth that simulated data hold, names without blanks around them.

    Two columns may have one name: ``numbers`` refuses them if asked for.

    Raises:
        BadInput: no such file, no table, too large, or a library that reads it is not installed.
    """
    held = _read(path, check_file(path))
    names = [str(c) for c in held.table.columns]
    held.table.columns = [name.strip() for name in names]
    if trimmed := [name for name in names if name != name.strip() and not name.strip().startswith(TRUTH_PREFIX)]:
        tell(path, f"blanks around column names are left out ({', '.join(map(shown, trimmed[:5]))})")
    table = held.table.loc[:, [not c.startswith(TRUTH_PREFIX) for c in held.table.columns]]
    if table.empty:
        raise BadInput(f"{path}: has no rows; record again or name another file")
    return replace(held, table=table)


def check_file(path: Path) -> str:
    """The kind of a recording's file, as the end of its name says it.

    Raises:
        BadInput: no such file, none that can be read, or empty.
    """
    if not os.path.exists(path):  # unlike Path's, false for what can be no name
        raise BadInput(f"{path}: no such file; check the path")
    if path.is_dir():
        raise BadInput(f"{path}: is a folder; name the recording's file (of a ROS 2 bag its .mcap or .db3)")
    if not os.path.isfile(path):
        raise BadInput(f"{path}: is no ordinary file; write what comes out of it to a file first")
    kind = kind_of(path)
    if kind is None:
        raise BadInput(f"{path}: unknown kind of file; a recording is {', '.join(READERS)}")
    if path.stat().st_size == 0:
        raise BadInput(f"{path}: is empty; record again or name another file")
    return kind


def tell(path: Path, what: str) -> None:
    """Say on stderr what a reader should know of a recording that can be used all the same."""
    _LOG.warning("twinbench: %s", printable(f"{path}: {what}"))


def _read(path: Path, kind: str) -> Holdings:
    try:
        if kind in _TEXT:
            return READERS[kind](path)
        with quiet():
            return READERS[kind](path)
    except BadInput:
        raise
    except PermissionError as error:
        raise BadInput(f"{path}: cannot be read: {_first(error)}; check its permissions") from error
    except Exception as error:  # libraries let through whatever a damaged file leads them to
        if kind in _TEXT and not isinstance(error, OSError | EOFError | ValueError | zlib.error):
            raise
        raise _refusal(path, kind, error) from error


def _refusal(path: Path, kind: str, error: Exception) -> BadInput:
    if kind in _TEXT and isinstance(error, UnicodeDecodeError):
        odd = error.object[error.start]
        return BadInput(
            f"{path}: is no UTF-8 text (byte 0x{odd:02x}; Latin-1 and Windows-1252 have such); save it as UTF-8"
        )
    if kind == ".csv":
        return BadInput(f"{path}: is no table: {_first(error)}; write it as CSV with one header line")
    return BadInput(f"{path}: cannot be read, it may be cut short ({bare(_first(error))}); copy it again")


def numbers(table: pd.DataFrame, column: str, path: Path) -> Array:
    """A column as numbers (N,), NaN where a cell is empty.

    Raises:
        BadInput: the name stands for two columns, or a cell is no number.
    """
    import pandas as pd

    where = f"{path}, column {bare(column)}"
    cells = one_column(table, column, path)
    if pd.api.types.is_datetime64_any_dtype(cells):
        raise BadInput(f"{where}: {_no_date(str(cells.iloc[0]))}")
    if not (pd.api.types.is_numeric_dtype(cells) or cells.dtype == object or pd.api.types.is_string_dtype(cells)):
        raise BadInput(f"{where}: holds {bare(cells.dtype)}, not numbers; write numbers")
    try:
        values = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=float)
    except OverflowError as error:
        raise BadInput(f"{where}: a whole number has too many figures for a reading; leave the cell empty") from error
    wrong = (np.isnan(values) & cells.notna().to_numpy()) | (np.abs(values) > LARGEST_READING)
    if wrong.any():
        text = str(cells.iloc[int(np.flatnonzero(wrong)[0])])
        raise BadInput(f"{path}, row {row(wrong)}, column {bare(column)}: {_no_number(text)}")
    return values


def one_column(table: pd.DataFrame, column: str, path: Path) -> pd.Series:
    """A column's cells as they are.

    Raises:
        BadInput: the name stands for two columns.
    """
    if list(table.columns).count(column) > 1:
        raise BadInput(f"{path}, column {bare(column)}: two columns have that name; rename one")
    return table[column]


def row(wrong: np.ndarray) -> int:
    """Line of the file, the header being line 1.

    Args:
        wrong: (N,) bool, one per row; the first that is set is told.
    """
    return int(np.flatnonzero(wrong)[0]) + 2


def stem(path: Path) -> str:
    """The file's name without its kind; dots inside it stay."""
    return path.name.removesuffix(kind_of(path) or "")


def _no_number(text: str) -> str:
    if _DATE.match(text.strip()):
        return _no_date(text)
    if re.fullmatch(r"\s*-?\d+,\d+\s*", text):
        return f"{shown(text)} is no number; write a point for the decimal comma"
    try:
        float(text)
    except ValueError:
        return f"{shown(text)} is no number; leave the cell empty if missing"
    return (
        f"{shown(text)} is no number that a sensor shows (at most {LARGEST_READING:g}); leave the cell empty if missing"
    )


def _no_date(text: str) -> str:
    return (
        f"{shown(text)} is a date or a time of day, no number; write seconds since the start, "
        "or all times like 2026-03-01T12:00:00Z"
    )


def _first(error: Exception) -> str:
    return printable((str(error).splitlines() or [type(error).__name__])[0])
