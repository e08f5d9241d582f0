"""CSV, packed or not: looked through before it is read, so that what is no table is told by its line."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.data.formats import holdings
from twinbench.data.formats.holdings import Holdings, too_large

MOST_TABLE_BYTES = 1 << 30
"""Of text, unpacked. Reading takes a few times as much memory, for which many machines would kill the command."""
LONGEST_LINE_BYTES = 1 << 20
"""Bytes of one line of text: a row of ten thousand columns has a tenth of that. Longer ones are no table."""
_CHUNK_BYTES = 1 << 22  # bytes looked at together
_OTHERS = {
    b"PK\x03\x04": "a zip or Excel file; export the table as CSV",
    b"\xd0\xcf\x11\xe0": "an old Excel file; export the table as CSV",
    b"PAR1": "a Parquet file; name it .parquet",
    b"\x1f\x8b": "a gzip file; name it .csv.gz",
    b"\x89HDF": "an HDF5 file; export the table as CSV",
    b"MATLAB": "a MATLAB file; name it .mat",
    b"MDF     ": "an MDF file; name it .mf4",
    b"TDSm": "a TDMS file; name it .tdms",
    b"\x89MCAP": "an MCAP file; name it .mcap",
    b"#ROSBAG": "a ROS bag; name it .bag",
    b"\xff\xfe": "UTF-16 text; save it as UTF-8",
    b"\xfe\xff": "UTF-16 text; save it as UTF-8",
}
"""What a file that is named .csv begins with if it is something else."""


def read(path: Path) -> Holdings:
    """A CSV file, its columns as they are named there.

    Raises:
        BadInput: something else than text, no table, or too large.
    """
    import pandas as pd

    lines = _scan(path)
    try:
        header = pd.read_csv(path, header=None, nrows=1, dtype=str, keep_default_na=False)
        names = [str(name) for name in header.iloc[0]]
        if len(names) < 3 and any(mark in name for name in names for mark in ";\t"):
            raise BadInput(f"{path}: separates its columns by semicolons or tabs; write commas, and points in numbers")
        if lines * len(names) > holdings.MOST_CELLS:
            raise too_large(path, lines, len(names))
        table = pd.read_csv(path, low_memory=False)
    except pd.errors.EmptyDataError as error:
        raise BadInput(f"{path}: is empty; record again or name another file") from error
    if not isinstance(table.index, pd.RangeIndex) or len(names) != table.shape[1]:
        raise BadInput(
            f"{path}: its rows have more cells than its header; name every column, and write points in numbers"
        )
    table.columns = pd.Index(names)  # pandas gives the second of a name another
    return Holdings(table)


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
