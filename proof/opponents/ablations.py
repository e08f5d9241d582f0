"""The engine with one thing left out at a time: to see what each is for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from unittest.mock import patch

from twinbench.data.recording import Recording
from twinbench.mismatch.asked import Asked, Progress, silent
from twinbench.mismatch.naming import marginal, settle
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
EXACT_PCT = 1e-3
"""Prior sd of a discrepancy that is none, in per cent of what commonly acts at its port. The least ripple of the proof
is two hundred times as large."""


def _engine(
    rule: Rule | None = None, without: Callable[[], AbstractContextManager[object]] = nullcontext
) -> Callable[..., Verdict]:
    """An engine that is called as ``mismatch.diagnose``.

    Args:
        rule: by which it decides what is said.
        without: what is left out while it runs.
    """

    def diagnose(
        simulator: Simulator,
        recordings: Sequence[Recording],
        hold_out: Sequence[Recording] = (),
        catalogue: Sequence[Mechanism] | None = None,
        progress: Progress = silent,
    ) -> Verdict:
        with without():
            return conclude(examine(Asked(simulator, recordings, hold_out, catalogue), progress, rule))

    return diagnose


no_learnt_decision = _engine(EVIDENCE_ALONE)
"""What is said is decided by the evidence alone."""
no_discrepancy = _engine(without=lambda: patch.object(marginal, "DISCREPANCY_PCT", EXACT_PCT))
"""The simulator's equations are taken for exact."""
no_relinearisation = _engine(without=lambda: patch.object(settle, "TURNS", 1))
"""Each hypothesis is linearised once, where it is proposed."""
