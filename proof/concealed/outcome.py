"""What a verdict comes to: one word."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

OUTCOMES = ("name", "class", "set", "located", "abstained", "wrong", "false")
"""All that ``outcome`` may say."""
SOUND = ("clean", "parameters", "poor_excitation")
"""Cells of machines that lack nothing."""
UNKNOWN = ("left_out", "foreign")
"""Cells of effects that the catalogue has no name for."""
LARGEST_SET = 3
"""Names that a set may hold and still say something."""
WRONG_NAMES = 0.02
"""Promised rate of wrong names among all verdicts."""


def outcome(truth: Mapping[str, Any], names: Sequence[Sequence[str]], ports: Sequence[Sequence[str]]) -> str:
    """What a verdict's claims come to.

    - false: a name or a set on a sound machine.
    - wrong: a single name outside every effect's class, or a set that holds no effect of the case. Where the catalogue
      has no name for the effect, any name and any set is wrong.
    - name: every effect named alone by its own name.
    - class: every effect by a name, or a set, out of its class.
    - set: every effect so, or inside a set of at most ``LARGEST_SET`` names.
    - located: a claim points to every effect's place.
    - abstained: all else.

    Args:
        names: of each claim; one is a single name, none is something unnamed.
        ports: of each claim.
    """
    effects = truth["effects"]
    if not effects:
        return "false" if any(names) else "abstained"
    classes = [set() if truth["cell"] in UNKNOWN else set(e["class"]) for e in effects]
    everything = set().union(*classes)
    if any(len(claim) > 0 and not everything & set(claim) for claim in names):
        return "wrong"
    if truth["cell"] not in UNKNOWN:
        if all([e["name"]] in [list(claim) for claim in names] for e in effects):
            return "name"
        if all(any(claim and set(claim) <= same for claim in names) for same in classes):
            return "class"
        if all(any(_holds(set(claim), same) for claim in names) for same in classes):
            return "set"
    pointed = {port for claim in ports for port in claim}
    return "located" if all(pointed & set(e["ports"]) for e in effects) else "abstained"


def _holds(claim: set[str], same: set[str]) -> bool:
    """Does a claim say something of an effect with this class?"""
    return bool(claim) and (claim <= same or (len(claim) <= LARGEST_SET and bool(claim & same)))


def wrong_names(cell: str, classes: Sequence[set[str]], named: Sequence[str]) -> list[str]:
    """Single names that are wrong: any on a sound machine or of an effect that the catalogue lacks.

    Args:
        classes: of each effect.
        named: single names.
    """
    right = set() if cell in (*SOUND, *UNKNOWN) else set().union(*classes)
    return [name for name in named if name not in right]
