"""Records: what a compiled function needs, in one argument each and in one place, so that nothing is allocated."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

KINDS = {"f": "f8", "i": "i8", "b": "u1"}
"""How numbers of a kind are kept in a record; truth is a byte there."""


def record(fields: Mapping[str, tuple[Any, tuple[int, ...]]]) -> np.dtype[np.void]:
    """An aligned record type of arrays, by name their type and shape; a shape of () is a single value."""
    return _interned(np.dtype([(name, kind, shape) for name, (kind, shape) in fields.items()], align=True))


@functools.cache
def _interned(kind: np.dtype[np.void]) -> np.dtype[np.void]:
    """The first of equal types: a compiled function knows at once the very type that it was called with before."""
    return kind


def record_of(values: Any) -> np.dtype[np.void]:
    """The record type that holds such a tuple with names, records for tuples within."""
    fields: dict[str, tuple[Any, tuple[int, ...]]] = {}
    for name, value in values._asdict().items():
        if hasattr(value, "_asdict"):
            fields[name] = record_of(value), ()
        else:
            fields[name] = KINDS[np.asarray(value).dtype.kind], np.shape(value)
    return record(fields)


def one_record(kind: np.dtype[np.void], values: Mapping[str, Any]) -> np.ndarray:
    """A record (1,) of that type; tuples with names fill records within."""
    out = np.zeros(1, kind)
    _fill(out, values)
    return out


def _fill(out: np.ndarray, values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        if hasattr(value, "_asdict"):
            _fill(out[name], value._asdict())
        else:
            out[name][0] = value
