"""Recordings short enough for tests of the flagship study."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from twinbench.data.batch import HEALTH, Batch
from twinbench.proof.flagship.plant import Item, draw
from twinbench.proof.flagship.record import HELD_OUT, TRAINING, record

SHORT_TRAINING = replace(TRAINING, minutes=2.0, wear=((), HEALTH))
SHORT_HELD_OUT = replace(HELD_OUT, minutes=4.0, wear=(HEALTH,))


@cache
def recorded() -> tuple[Batch, Batch]:
    """Training and held-out recordings of plant 0 of seed 3."""
    plant = draw(Item("plain", 0), 3).simulator
    return record(plant, SHORT_TRAINING, 3, 0), record(plant, SHORT_HELD_OUT, 3, 0)
