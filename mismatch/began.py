"""Since when something is there, recording by recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.tracks import Track
from twinbench.mismatch.words import listed

BEGINS_LATE = 0.15
"""Prior probability that an effect begins while it is watched."""
STARTS = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9)
"""Shares of a recording after which an effect may have begun; also at its beginning, but for the first's."""


class Onset(NamedTuple):
    """Since when an effect is there in one recording.

    Attributes:
        there: "throughout", "from" or "not".
        since_s: on the recording's clock, if it begins in it; ``into_s`` after its first sample.
    """

    recording: str
    there: str
    since_s: float | None = None
    into_s: float | None = None


def starts(tracks: Sequence[Track]) -> list[float]:
    """Times on the recordings' clock, s, at which an effect may have begun."""
    return [
        float(t.time_s[0] + share * np.ptp(t.time_s))
        for j, t in enumerate(tracks)
        for share in ((0.0,) if j else ()) + STARTS
    ]


def late_odds(tracks: Sequence[Track]) -> float:
    """Log prior odds that what is missing began about one of these times."""
    return float(np.log(BEGINS_LATE / len(starts(tracks))))


def told_onsets(since_s: float, tracks: Sequence[Track]) -> tuple[Onset, ...]:
    """Recording by recording, where something begins on their clock; nothing if it was always there."""
    if since_s == -np.inf:
        return ()
    found = []
    for track in tracks:
        first, last = float(track.time_s[0]), float(track.time_s[-1])
        if first < since_s < last:
            found.append(Onset(track.name, "from", since_s, since_s - first))
        else:
            found.append(Onset(track.name, "throughout" if since_s <= first else "not"))
    return tuple(found)


def begins(onsets: tuple[Onset, ...]) -> str:
    """In which recordings an effect is, and from when on."""
    words = {"throughout": "all through {0}", "not": "not in {0}", "from": "in {0} from {1:.0f} s on"}
    ordered = sorted(onsets, key=lambda o: o.there == "not")
    return "it is there " + listed([words[o.there].format(o.recording, o.since_s or 0.0) for o in ordered])
