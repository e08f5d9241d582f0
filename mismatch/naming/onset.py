"""Effects that begin while they are watched: the same columns, from a time on."""

from __future__ import annotations

import numpy as np

from twinbench.mismatch.began import STARTS, starts
from twinbench.mismatch.naming.picture import Painter, Picture
from twinbench.mismatch.naming.sets import LEFT_SHARE

WATCHED = 6
"""Effects that are tried for a later beginning: the likeliest from the beginning on, then those that show most."""
FINER, CLOSER = 12, 9.0
"""Times tried to either side of the best one; the second time so many times closer together."""


def with_late(painter: Painter) -> Picture:
    """The picture, searched; if a time is likely at which effects began, then with all as begun at that time too."""
    shown = painter.picture()
    shown.sets.search()
    likeliest = _likeliest(shown)
    tracks = painter.view.problem.tracks
    gap = STARTS[0] * max(float(np.ptp(t.time_s)) for t in tracks)
    late = painter.picture(starts(tracks), likeliest)
    since = _best_start(late)
    if since == -np.inf:
        return shown
    for near in (gap / FINER, gap / FINER / CLOSER):
        late = painter.picture([since + near * k for k in range(-FINER, FINER + 1)], likeliest)
        since = _best_start(late, since)
    # Then everything may have begun at that time.
    shown = painter.picture([since], likeliest_forms(shown))
    shown.sets.search()
    return shown


def likeliest_forms(shown: Picture) -> list[int]:
    """Of each candidate the variant, from the beginning on, that explains most: the others' shapes follow in a fit."""
    gains = np.where(shown.since == -np.inf, shown.sets.quick((), LEFT_SHARE * shown.sets.s), -np.inf)
    order = np.argsort(-gains)
    return shown.firsts(order[shown.since[order] == -np.inf])


def _likeliest(shown: Picture) -> list[int]:
    sets = shown.sets
    order = [i for s in sorted(sets.known.values(), key=lambda s: -s.log) for i in s.key]
    order += list(np.argsort(-sets.quick((), LEFT_SHARE * sets.s)))
    return shown.firsts(order)[:WATCHED]


def _best_start(late: Picture, default: float = -np.inf) -> float:
    best = late.sets.search(depth=1)
    return float(late.since[best.key[0]]) if best.key else default
