"""Which kind of file is read by what, by the end of its name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from twinbench.data.formats import mat, mdf, parquet, ros, tdms, text
from twinbench.data.formats.holdings import Holdings

READERS: dict[str, Callable[[Path], Holdings]] = {
    ".csv": text.read,
    ".csv.gz": text.read,
    ".parquet": parquet.read,
    ".mat": mat.read,
    ".mf4": mdf.read,
    ".tdms": tdms.read,
    ".mcap": ros.read,
    ".bag": ros.read,
    ".db3": ros.read,
}
"""By the end of a file's name. The libraries are imported when a file of theirs is read."""


def kind_of(path: Path) -> str | None:
    """The end of a file's name that says what it is; None if it is no kind that is read."""
    return max((kind for kind in READERS if path.name.endswith(kind)), key=len, default=None)
