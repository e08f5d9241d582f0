"""The engine with a plain rule in place of the learnt one: tests of what it finds must not hang on learnt weights."""

from __future__ import annotations

from collections.abc import Sequence

from helpers.documents import check_verdict
from twinbench.data.recording import Recording
from twinbench.mismatch import Verdict
from twinbench.mismatch.asked import Asked
from twinbench.mismatch.verdict import conclude
from twinbench.mismatch.walk import examine
from twinbench.physics.simulator import Mechanism, Simulator
from twinbench.proof.opponents.ablations import EVIDENCE_ALONE


def diagnosed(
    simulator: Simulator,
    recordings: Sequence[Recording],
    hold_out: Sequence[Recording] = (),
    catalogue: Sequence[Mechanism] | None = None,
) -> Verdict:
    """As ``diagnose``, but what is said is decided by the evidence alone; a program may read it."""
    verdict = conclude(examine(Asked(simulator, recordings, hold_out, catalogue), rule=EVIDENCE_ALONE))
    check_verdict(verdict)
    return verdict
