"""Nothing is ever missing: only parameters and start states are fitted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from twinbench.data.recording import Recording
from twinbench.physics.simulator import Mechanism, Simulator
from twinbench.proof.opponents.base import Progress, calibrate, quiet, told


def diagnose(
    simulator: Simulator,
    recordings: Sequence[Recording],
    hold_out: Sequence[Recording] = (),
    catalogue: Sequence[Mechanism] | None = None,
    progress: Progress = quiet,
) -> dict[str, Any]:
    """Calibrate and name nothing; arguments as for ``mismatch.diagnose``."""
    return told(calibrate(simulator, recordings, hold_out, progress), "The simulator was calibrated.")
