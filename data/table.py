"""A recording's file as a table: what is no table, or larger than can be read, is refused in one line."""

from __future__ import annotations

import gzip
import logging
import os
import re
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, cast

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.shown import bare, printable, shown
from twinbench.machines.coordinates import Array

if TYPE_CHECKING:
    import pandas as pd

KINDS = (".csv", ".csv.gz", ".parquet")
TRUTH_PREFIX = "true_"
MOST_TABLE_BYTES = 1 << 30
"""Of text, unpacked. Reading takes a few times as much memory, for which many machines would kill the command."""
MOST_CELLS = 250_000_000
"""Rows times columns; fourteen days of the compressor at 20 Hz are 194 million. As numbers they take two gigabytes."""
LONGEST_LINE_BYTES = 1 << 20
"""Bytes of one line of text: a row of ten thousand columns has a tenth of that. Longer ones are no table."""
LARGEST_READING = 1e30
"""No reading in any unit is larger, and sums of squares of this are still numbers."""
_CHUNK_BYTES = 1 << 22  # bytes looked at together
_OTHERS = {
    b"PK\x03\x04": "a zip or Excel file; export the table as CSV",
    b"\xd0\xcf\x11\xe0": "an old Excel file; export the table as CSV",
    b"PAR1": "a Parquet file; name it .parquet",
    b"\x1f\x8b": "a gzip file; name it .csv.gz",
    b"\x89HDF": "an HDF5 file; export the table as CSV",
    b"MATLAB": "a MATLAB file; export the table as CSV",
    b"\xff\xfe": "UTF-16 text; save it as UTF-8",
    b"\xfe\xff": "UTF-16 text; save it as UTF-8",
}
"""What a file that is named .csv begins with if it is something else."""
_DATE = re.compile(r"\d{4}-\d\d?-\d\d?|\d\d?[./]\d\d?[./]\d{2,4}|\d\d?:\d\d")
_LOG = logging.getLogger("twinbench")


def read_table(path: Path) -> pd.DataFrame:
    """The file's columns but for the truth that simulated data hold, names without blanks around them.

    Two columns may have one name: ``numbers`` refuses them if asked for.

    Raises:
        BadInput: no such file, no table, or too large.
    """
    if not os.path.exists(path):  # unlike Path's, false for what can be no name
        raise BadInput(f"{path}: no such file; check the path")
    if path.is_dir():
        raise BadInput(f"{path}: is a folder; name the recording's file")
    if not os.path.isfile(path):
        raise BadInput(f"{path}: is no ordinary file; write what comes out of it to a file first")
    if not path.name.endswith(KINDS):
        raise BadInput(f"{path}: unknown kind of file; a recording is {', '.join(KINDS)}")
    if path.stat().st_size == 0:
        raise BadInput(f"{path}: is empty; record again or name another file")
    try:
        table = _parquet(path) if path.suffix == ".parquet" else _text(path)
    except BadInput:
        raise
    except UnicodeDecodeError as error:
        odd = error.object[error.start]
        raise BadInput(
            f"{path}: is no UTF-8 text (byte 0x{odd:02x}; Latin-1 and Windows-1252 have such); save it as UTF-8"
        ) from error
    except PermissionError as error:
        raise BadInput(f"{path}: cannot be read: {_first(error)}; check its permissions") from error
    except (OSError, EOFError, ValueError, zlib.error) as error:
        if path.suffix == ".csv":
            raise BadInput(f"{path}: is no table: {_first(error)}; write it as CSV with one header line") from error
        raise BadInput(f"{path}: cannot be read, it may be cut short ({_first(error)}); copy it again") from error
    names = [str(c) for c in table.columns]
    table.columns = [name.strip() for name in names]
    if trimmed := [name for name in names if name != name.strip() and not name.strip().startswith(TRUTH_PREFIX)]:
        listed = ", ".join(map(shown, trimmed[:5]))
        _LOG.warning("twinbench: %s", printable(f"{path}: blanks around column names are left out ({listed})"))
    table = table.loc[:, [not c.startswith(TRUTH_PREFIX) for c in table.columns]]
    if table.empty:
        raise BadInput(f"{path}: has no rows; record again or name another file")
    return table


def numbers(table: pd.DataFrame, column: str, path: Path) -> Array:
    """A column as numbers, NaN where a cell is empty.

    Raises:
        BadInput: the name stands for two columns, or a cell is no number.
    """
    import pandas as pd

    where = f"{path}, column {bare(column)}"
    if list(table.columns).count(column) > 1:
        raise BadInput(f"{where}: two columns have that name; rename one")
    cells = table[column]
    if pd.api.types.is_datetime64_any_dtype(cells):
        raise BadInput(f"{where}: {_no_date(str(cells.iloc[0]))}")
    if not (pd.api.types.is_numeric_dtype(cells) or cells.dtype == object or pd.api.types.is_string_dtype(cells)):
        raise BadInput(f"{where}: holds {bare(cells.dtype)}, not numbers; write numbers")
    values = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=float)
    wrong = (np.isnan(values) & cells.notna().to_numpy()) | (np.abs(values) > LARGEST_READING)
    if wrong.any():
        text = str(cells.iloc[int(np.flatnonzero(wrong)[0])])
        raise BadInput(f"{path}, row {row(wrong)}, column {bare(column)}: {_no_number(text)}")
    return values


def row(wrong: np.ndarray) -> int:
    """Line of the file, the header being line 1.

    Args:
        wrong: (N,) bool, one per row; the first that is set is told.
    """
    return int(np.flatnonzero(wrong)[0]) + 2


def stem(path: Path) -> str:
    """The file's name without its kind; dots inside it stay."""
    return next(path.name.removesuffix(kind) for kind in KINDS if path.name.endswith(kind))


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
    return f"{shown(text)} is a date or a time of day, no number; write seconds since the start"


def _text(path: Path) -> pd.DataFrame:
    """A CSV file, its columns as they are named there."""
    import pandas as pd

    lines = _scan(path)
    try:
        header = pd.read_csv(path, header=None, nrows=1, dtype=str, keep_default_na=False)
        names = [str(name) for name in header.iloc[0]]
        if len(names) < 3 and any(mark in name for name in names for mark in ";\t"):
            raise BadInput(f"{path}: separates its columns by semicolons or tabs; write commas, and points in numbers")
        if lines * len(names) > MOST_CELLS:
            raise _too_large(path, lines, len(names))
        table = pd.read_csv(path, low_memory=False)
    except pd.errors.EmptyDataError as error:
        raise BadInput(f"{path}: is empty; record again or name another file") from error
    if not isinstance(table.index, pd.RangeIndex) or len(names) != table.shape[1]:
        raise BadInput(
            f"{path}: its rows have more cells than its header; name every column, and write points in numbers"
        )
    table.columns = pd.Index(names)  # pandas gives the second of a name another
    return table


def _scan(path: Path) -> int:
    """Lines of a text file, gone through once without keeping it.

    Raises:
        BadInput: something else than text, or more of it than can be read.
    """
    size = lines = begun = 0  # bytes of the line that the last block left unfinished
    with cast(BinaryIO, gzip.open(path) if path.suffix == ".gz" else path.open("rb")) as file:
        while block := file.read(_CHUNK_BYTES):
            if not size:
                _check_beginning(path, block)
            letters = np.frombuffer(block, dtype=np.uint8)
            ends = np.flatnonzero((letters == 10) | (letters == 13))
            lengths = np.append(ends, len(block)) - np.append(-begun, ends + 1)
            if (nul := block.find(b"\0")) >= 0:
                at = lines + int((ends < nul).sum()) + 1
                raise BadInput(f"{path}, line {at}: holds a NUL byte; it is damaged or no text, export it again")
            if lengths.max() > LONGEST_LINE_BYTES:
                at = lines + int(np.argmax(lengths > LONGEST_LINE_BYTES)) + 1
                raise BadInput(
                    f"{path}, line {at}: is longer than {LONGEST_LINE_BYTES:,} bytes; that is no row of a table, "
                    "mend it"
                )
            size, lines, begun = size + len(block), lines + len(ends), int(lengths[-1])
            if size > MOST_TABLE_BYTES:
                raise BadInput(
                    f"{path}: holds more than {MOST_TABLE_BYTES / 1e9:.2g} GB of text; "
                    "split it, keep every tenth row, or only the columns that are read"
                )
    return lines


def _check_beginning(path: Path, block: bytes) -> None:
    for magic, what in _OTHERS.items():
        if block.startswith(magic):
            raise BadInput(f"{path}: is {what}")


def _parquet(path: Path) -> pd.DataFrame:
    import pandas as pd
    import pyarrow.parquet

    about = pyarrow.parquet.ParquetFile(path).metadata
    size = sum(about.row_group(i).total_byte_size for i in range(about.num_row_groups))
    if about.num_rows * about.num_columns > MOST_CELLS or size > 8 * MOST_CELLS:
        raise _too_large(path, about.num_rows, about.num_columns)
    return pd.read_parquet(path)


def _too_large(path: Path, rows: int, columns: int) -> BadInput:
    return BadInput(
        f"{path}: holds {rows:,} rows of {columns:,} columns, at most {MOST_CELLS:,} cells can be read; "
        "split it, keep every tenth row, or only the columns that are read"
    )


def _first(error: Exception) -> str:
    return printable((str(error).splitlines() or [type(error).__name__])[0])
