"""Since when something is there, recording by recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.tracks import Track
from twinbench.mismatch.words import listed


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
