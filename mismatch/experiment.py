"""The experiment that a verdict carries."""

from __future__ import annotations

from typing import NamedTuple


class Suggested(NamedTuple):
    """The best of a few experiments.

    Attributes:
        rivals: names of what it would tell apart.
        says: the experiment in words.
        probability: that the right name then stands alone.
        nats: what it adds for the closest pair.
    """

    rivals: tuple[str, ...]
    says: str
    probability: float
    nats: float
