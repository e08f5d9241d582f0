"""Simulator against recordings: calibrate, test, locate, name, model, prove. Knows no compressor.

from twinbench.mismatch import diagnose
verdict = diagnose(simulator, recordings, hold_out=others)
print(verdict.says)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Unpack

from twinbench.data.recording import Recording
from twinbench.mismatch.asked import Asked, Progress, silent
from twinbench.mismatch.findings import Finding
from twinbench.mismatch.joining import AUTO
from twinbench.mismatch.told import Knowledge, Told
from twinbench.mismatch.verdict import Verdict, conclude
from twinbench.mismatch.walk import examine
from twinbench.physics.simulator import Mechanism, Series, Simulator

__all__ = ["Finding", "Verdict", "diagnose"]


def diagnose(
    simulator: Simulator,
    recordings: Sequence[Recording],
    hold_out: Sequence[Recording] = (),
    catalogue: Sequence[Mechanism] | None = None,
    progress: Progress = silent,
    faults: Sequence[Series] = (),
    inputs: str = AUTO,
    **told: Unpack[Knowledge],
) -> Verdict:
    """Where a simulator and recordings of its machine disagree, and what was left out.

    Args:
        simulator: of the machine, as it is believed to be.
        recordings: of the machine, to learn from: channels are the simulator's inputs, then its outputs, in their
            units, as ``read_recordings`` gives them.
        hold_out: recordings of another operating regime. No parameter is learnt from them, but how each starts and
            drifts is, and they choose nothing: they may refuse what was found. Without any, the last recording is
            held out, or the last 30 % of the only one.
        catalogue: what may be missing; everything that we know of if left out.
        progress: told the stage's name and the share of it that is done.
        faults: of sensors and inputs that are known, of nominal size: those that a ``model.toml`` holds.
        inputs: how they go between samples: "held" until the next, "linear" in lines, or "auto": lines where a short
            stretch of the recordings clearly says so.
        told: what is known beforehand: ``leave_out=("offset*",)``, ``prior={"leak@h1_cm": 0.1}`` (odds) and
            ``measured={"p_suc_bar": 0.01}`` (standard deviation in the input's unit), the fields of ``mismatch.told``.

    Returns:
        The verdict: what was found, in words and numbers, and how sure it is.

    Raises:
        BadInput: recordings too short, a simulator that diverges, or what is told does not fit.
    """
    asked = Asked(simulator, recordings, hold_out, catalogue, faults, inputs, Told(**told))
    return conclude(examine(asked, progress))
