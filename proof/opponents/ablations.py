"""The engine with one thing left out at a time: to see what each is for."""

from __future__ import annotations

from collections.abc import Sequence

from twinbench.data.recording import Recording
from twinbench.mismatch.asked import Asked, Progress, silent
from twinbench.mismatch.naming.decision import FEATURES, Rule
from twinbench.mismatch.verdict import Verdict, conclude
from twinbench.mismatch.walk import examine
from twinbench.physics.simulator import Mechanism, Simulator

SAID = 0.95
"""Probability that the evidence alone must give a name, or the names of a set, to be said."""
CERTAIN = 100.0
"""Constant of a rule by which the right name is always among those weighed."""
EVIDENCE_ALONE = Rule(weights=dict.fromkeys(FEATURES, 0.0) | {"constant": CERTAIN}, say_name=SAID, say_set=0.0)
"""A name's probability is its weight among all that could stand in its place; a set is always said."""


def no_learnt_decision(
    simulator: Simulator,
    recordings: Sequence[Recording],
    hold_out: Sequence[Recording] = (),
    catalogue: Sequence[Mechanism] | None = None,
    progress: Progress = silent,
) -> Verdict:
    """What is said is decided by the evidence alone; arguments as for ``mismatch.diagnose``."""
    return conclude(examine(Asked(simulator, recordings, hold_out, catalogue), progress, EVIDENCE_ALONE))
