"""What a promise of the contract is: a function that measures, and how it says no."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from bench.contract.subject import Subject


class Broken(Exception):
    """The promise is not kept; the message says by how much."""


class NotOffered(Exception):
    """The estimator does not make this promise; the message says why."""


Promise = Callable[["Subject"], str]
"""Tries one promise; returns what it measured, raises where it is not kept."""
DECLARED: dict[str, Promise] = {}
"""Every promise by its plain-language name."""


def promise(name: str) -> Callable[[Promise], Promise]:
    """Decorator: make a promise part of the battery under its name."""

    def add(function: Promise) -> Promise:
        DECLARED[name] = function
        return function

    return add


def at_most(value: float, limit: float, says: str) -> str:
    """The detail of a measured number; broken where it is above the limit or NaN."""
    line = f"{says} {value:.2g}, at most {limit:g} allowed"
    if not value <= limit:
        raise Broken(line)
    return line


def need(kept: bool | np.bool_, otherwise: str) -> None:
    """Broken unless kept."""
    if not kept:
        raise Broken(otherwise)
