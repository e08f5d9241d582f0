"""What a diagnosis is asked, and who is told how far it is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from twinbench.data.recording import Recording
from twinbench.mismatch.joining import AUTO
from twinbench.mismatch.told import Told
from twinbench.physics.simulator import Mechanism, Series, Simulator

Progress = Callable[[str, float], None]
"""Told a stage's name and the share of it that is done."""


@dataclass(frozen=True)
class Asked:
    """A simulator and recordings of its machine; ``mismatch.diagnose`` says what each is."""

    simulator: Simulator
    recordings: Sequence[Recording]
    hold_out: Sequence[Recording] = ()
    catalogue: Sequence[Mechanism] | None = None
    faults: Sequence[Series] = ()
    inputs: str = AUTO
    told: Told = field(default_factory=Told)


def silent(stage: str, share: float) -> None:
    """Progress that nobody is told of."""


def forward(progress: Progress) -> Progress:
    """Progress that never goes back: a stage that was done is not told of again."""
    told: dict[str, float] = {}

    def report(stage: str, share: float) -> None:
        if told.get(stage, -1.0) < min(share, 1.0):
            told[stage] = min(share, 1.0)
            progress(stage, told[stage])

    return report
