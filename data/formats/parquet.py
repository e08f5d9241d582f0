"""Parquet: its own record of its size is looked at before anything is unpacked."""

from __future__ import annotations

from pathlib import Path

from twinbench.data.formats import holdings
from twinbench.data.formats.holdings import Holdings, too_large


def read(path: Path) -> Holdings:
    """A Parquet file's columns.

    Raises:
        BadInput: too large.
    """
    import pandas as pd
    import pyarrow.parquet

    about = pyarrow.parquet.ParquetFile(path).metadata
    size = sum(about.row_group(i).total_byte_size for i in range(about.num_row_groups))
    if about.num_rows * about.num_columns > holdings.MOST_CELLS or size > 8 * holdings.MOST_CELLS:
        raise too_large(path, about.num_rows, about.num_columns)
    return Holdings(pd.read_parquet(path))
