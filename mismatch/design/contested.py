"""The rivals of a verdict where they stand: what one finding may be, all else as it was found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twinbench.mismatch.naming.answer import SAME, Found
from twinbench.mismatch.naming.decision import Claim
from twinbench.mismatch.naming.name import Naming
from twinbench.mismatch.naming.settle import Settled, settled

MOST_RIVALS = 3
"""Rivals that are set against each other: a set holds no more that say something."""


def contested(claims: Sequence[Claim]) -> Claim | None:
    """The first claim that holds several names."""
    return next((c for c in claims if len(c.names) > 1 and c.found is not None), None)


def rivals_at(naming: Naming, chosen: Settled, claim: Claim) -> tuple[list[Settled], list[str]]:
    """The hypotheses that a claim cannot tell apart, and their names, likeliest first.

    A name that was told from the picture alone is brought to its own fixed point.
    """
    found = claim.found
    assert found is not None
    rest = frozenset(name for k, name in enumerate(chosen.names) if k != found.place)
    made = []
    for name in claim.names[:MOST_RIVALS]:
        several = [h for h in naming.hypotheses if frozenset(h.names) == rest | {name} and not h.given_up]
        made.append((max(several, key=lambda h: h.log) if several else _settled(naming, chosen, found, name), name))
    made = sorted((one for one in made if one[0] is not None), key=lambda one: -one[0].log)  # type: ignore[union-attr]
    return [h for h, _ in made if h is not None], [name for _, name in made]


def _settled(naming: Naming, chosen: Settled, found: Found, name: str) -> Settled | None:
    """A name in the place of the finding's own effect; None where no variant of it can stand there.

    Where one of its variants does the same as the effect, the verdict means that one, and not the likeliest.
    """
    painter = naming.without(chosen, found.place)
    shown = painter.picture()
    of_name = np.array([n == name for n in shown.names])
    alike = np.where(of_name, painter.cosines(chosen.sizes[found.place]), 0.0)
    gains = np.where(of_name, shown.sets.quick((), chosen.learnt.s), -np.inf)
    k = int(np.argmax(alike)) if alike.max() > SAME else int(np.argmax(gains))
    if not np.isfinite(gains[k]):
        return None
    there, sizes = painter.start(shown, [k], chosen.learnt.s)
    others = [e for i, e in enumerate(chosen.effects_at(there)) if i != found.place]
    effects = [*others, *shown.effects([k], sizes)]
    return settled(chosen.bare, there[: chosen.first], effects, naming.ground, chosen.learnt.s, naming.far)
