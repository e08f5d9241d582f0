"""The engine with one thing left out at a time: to see what each is for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from twinbench.data.recording import Recording
from twinbench.mismatch.asked import Asked, Progress, silent
from twinbench.mismatch.verdict import Verdict, conclude
from twinbench.mismatch.walk import examine
from twinbench.physics.simulator import Mechanism, Simulator

Engine = Callable[..., Verdict]


def _without(**switches: Any) -> Engine:
    def diagnose(
        simulator: Simulator,
        recordings: Sequence[Recording],
        hold_out: Sequence[Recording] = (),
        catalogue: Sequence[Mechanism] | None = None,
        progress: Progress = silent,
    ) -> Verdict:
        return conclude(examine(Asked(simulator, recordings, hold_out, catalogue), progress, **switches))

    return diagnose

