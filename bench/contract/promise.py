"""What a promise of the contract is: a function that measures, under a name in plain language."""

from __future__ import annotations

from collections.abc import Callable

from twinbench.bench.contract.subject import Subject

Promise = Callable[[Subject], str]
"""Tries one promise; returns what it measured, raises where it is not kept."""
DECLARED: dict[str, Promise] = {}
"""Every promise by its plain-language name."""


def promise(name: str) -> Callable[[Promise], Promise]:
    """Decorator: make a promise part of the battery under its name."""

    def add(function: Promise) -> Promise:
        DECLARED[name] = function
        return function

    return add
