"""MATLAB files up to version 7: vectors of one length are columns, also inside structs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.shown import bare
from twinbench.data.formats import holdings
from twinbench.data.formats.holdings import Holdings, too_large

_DEEPEST = 8
"""Structs inside each other; what people save has two or three."""


def read(path: Path) -> Holdings:
    """The vectors of a MATLAB file, those that have the length that most have.

    A field of a struct is called ``struct.field``, a column of a matrix ``matrix[1]``, counted from one as MATLAB does.

    Raises:
        BadInput: version 7.3, too large, or no vector.
    """
    import pandas as pd
    import scipy.io

    if _is_hdf5(path):
        raise BadInput(f"{path}: is a MATLAB file of version 7.3; save it as version 7: save('{path.stem}.mat', '-v7')")
    cells = sum(int(np.prod(shape, dtype=float)) for _, shape, _ in scipy.io.whosmat(path))
    if cells > holdings.MOST_CELLS:
        raise too_large(path, cells, 1)
    content = scipy.io.loadmat(path, squeeze_me=True, chars_as_strings=True, appendmat=False)
    vectors = dict(_vectors({k: v for k, v in content.items() if not k.startswith("__")}))
    if not vectors:
        raise BadInput(f"{path}: holds no vector of numbers; save the time and each channel as a vector")
    lengths = Counter(map(len, vectors.values()))
    length = max(lengths, key=lambda n: (lengths[n], n))
    others = [bare(name) for name, vector in vectors.items() if len(vector) != length]
    left_out = (f"vectors that have not {length:,} samples as most have ({', '.join(others[:5])})",) if others else ()
    return Holdings(pd.DataFrame({n: v for n, v in vectors.items() if len(v) == length}), left_out=left_out)


def _is_hdf5(path: Path) -> bool:
    """MATLAB's version 7.3 says so in its first line; HDF5 itself begins behind it."""
    with path.open("rb") as file:
        begin = file.read(520)
    return begin.startswith((b"MATLAB 7.3", b"\x89HDF")) or begin[512:516] == b"\x89HDF"


def _vectors(content: Mapping[str, Any], before: str = "", depth: int = 0) -> Iterator[tuple[str, np.ndarray]]:
    """Every vector of numbers, and the columns of matrices; structs are gone into."""
    for key, value in content.items():
        name = f"{before}{key}"
        if isinstance(value, np.void | np.ndarray) and value.dtype.names and value.ndim == 0 and depth < _DEEPEST:
            fields = {field: value[field] for field in value.dtype.names}
            inside = {k: v.item() if isinstance(v, np.ndarray) and v.ndim == 0 else v for k, v in fields.items()}
            yield from _vectors(inside, f"{name}.", depth + 1)
        elif not isinstance(value, np.ndarray) or value.dtype.kind not in "fiub":
            continue
        elif value.ndim == 1 and len(value) > 1:
            yield name, value
        elif value.ndim == 2:
            yield from ((f"{name}[{k + 1}]", value[:, k]) for k in range(value.shape[1]))
