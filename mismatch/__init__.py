"""Simulator against recordings: calibrate, test, locate, name, model, prove. Knows no compressor.

from twinbench.mismatch import diagnose
verdict = diagnose(simulator, recordings, hold_out=others)
print(verdict.says)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from twinbench.data.recording import Recording
from twinbench.mismatch.guards import Guards
from twinbench.mismatch.joining import AUTO
from twinbench.mismatch.verdict import Finding, Verdict, conclude
from twinbench.mismatch.walk import examine
from twinbench.physics.simulator import Mechanism, Simulator

__all__ = ["Finding", "Guards", "Verdict", "diagnose"]


def diagnose(
    simulator: Simulator,
    recordings: Sequence[Recording],
    hold_out: Sequence[Recording] = (),
    catalogue: Sequence[Mechanism] | None = None,
    progress: Callable[[str, float], None] = lambda stage, share: None,
    guards: Guards = Guards(),
    faults: Sequence[Mechanism] = (),
    inputs: str = AUTO,
) -> Verdict:
    """Where a simulator and recordings of its machine disagree, and what was left out.

    Args:
        simulator: of the machine, as it is believed to be.
        recordings: of the machine, to learn from: channels are the simulator's inputs, then its outputs, in their
            units, as ``read_recordings`` gives them.
        hold_out: recordings of another operating regime, never learnt from; without any, the last
            recording is held out, or the last third of the only one.
        catalogue: what may be missing; everything that we know of if left out.
        progress: told the stage's name and the share of it that is done.
        guards: what keeps it from naming what is not there; all, but in an ablation.
        inputs: how they go between samples: "held" until the next, "linear" in lines, or "auto": lines where a short
            stretch of the recordings clearly says so.
        faults: of sensors and inputs that are known, of nominal size: those that a ``model.toml`` holds.

    Returns:
        The verdict: what was found, in words and numbers, and how sure it is.

    Raises:
        BadInput: recordings too short, a simulator that diverges.
    """
    return conclude(examine(simulator, recordings, hold_out, catalogue, progress, guards, faults, inputs))
