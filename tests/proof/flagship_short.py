"""Recordings short enough for tests of the flagship study."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from twinbench.data.batch import Batch
from twinbench.machines.compressor import HEALTH
from twinbench.proof.flagship.plant import Item, draw
from twinbench.proof.flagship.record import HELD_OUT, PROOF, TRAINING, record

SHORT_TRAINING = replace(TRAINING, minutes=2.0, wear=((), HEALTH))
SHORT_PROOF, SHORT_HELD_OUT = (replace(part, minutes=4.0, wear=(HEALTH,)) for part in (PROOF, HELD_OUT))


@cache
def recorded() -> tuple[Batch, Batch, Batch]:
    """Recordings of plant 0 of seed 3: to learn from, to prove on, to filter."""
    plant = draw(Item("plain", 0), 3).simulator
    train, proof, held_out = (record(plant, part, 3, 0) for part in (SHORT_TRAINING, SHORT_PROOF, SHORT_HELD_OUT))
    return train, proof, held_out
