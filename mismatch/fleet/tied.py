"""Effects in the shape in which the fleet has them: a threshold that one machine never reached is known from others."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import TypeVar

from twinbench.mismatch.fleet.evidence import Known, likeliest, merged
from twinbench.physics.simulator import Mechanism, Term, Variable

T = TypeVar("T")
MARK = " as in the fleet"
"""Ends the name of such an effect as long as one machine is asked."""
HELD_WITHIN = 0.01
"""Share of a shape's range by which it may differ from machine to machine."""


def shapes(fleet: Iterable[Known], names: Iterable[str]) -> dict[str, tuple[float, ...]]:
    """By name, the shape on the machine that sees an effect's size best, each parameter in its unit.

    Effects without a shape, and those that no machine weighed, are not among them.
    """
    found = {}
    known = list(fleet)
    for name in names:
        seen = [one for k in known if (one := likeliest(k, name)) is not None]
        best = max(seen, key=lambda one: abs(one.sizes[name].mean) / one.sizes[name].sd, default=None)
        if best is not None and best.shapes[name]:
            found[name] = best.shapes[name]
    return found


def tied(mechanism: Mechanism, shape: tuple[float, ...]) -> Mechanism:
    """The mechanism in that shape.

    All that it brings gets names of its own. It stands beside the mechanism as it was, and what has the catalogue's
    names is sized anew for where one machine was.
    """
    size, *others = mechanism.parameters
    parameters = (_named(size), *(_held(_named(v), at) for v, at in zip(others, shape, strict=True)))
    if isinstance(mechanism, Term):
        mechanism = replace(mechanism, states=tuple(map(_named, mechanism.states)))
    return replace(mechanism, name=mechanism.name + MARK, parameters=parameters, contains=mechanism.name)


def _named(v: Variable) -> Variable:
    return replace(v, name=v.name + MARK)


def _held(v: Variable, at: float) -> Variable:
    apart = HELD_WITHIN * (v.high - v.low)
    return replace(v, low=at - apart, high=at + apart, nominal=at, scale=apart / 3.0)


def with_tied(sets: Iterable[frozenset[str]], names: Collection[str]) -> set[frozenset[str]]:
    """Sets of effects in the fleet's shape as far as it is known; sets without any such effect are left out."""
    found = {frozenset(name + MARK if name in names else name for name in some) for some in sets}
    return {some for some in found if any(name.endswith(MARK) for name in some)}


def untied(known: Known) -> Known:
    """What was weighed of effects in the fleet's shape, by the effects' own names."""
    return merged(
        {
            frozenset(map(_own, names)): tuple(
                one._replace(sizes=_plain(one.sizes), shapes=_plain(one.shapes)) for one in those
            )
        }
        for names, those in known.items()
    )


def _own(name: str) -> str:
    return name.removesuffix(MARK)


def _plain(by_name: Mapping[str, T]) -> dict[str, T]:
    return {_own(name): value for name, value in by_name.items()}
