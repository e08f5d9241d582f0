"""The engine with one thing left out at a time: to see what each is for."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any
from unittest.mock import patch

from twinbench.mismatch import Verdict, diagnose
from twinbench.mismatch.naming import decision, marginal, settle
from twinbench.mismatch.naming.decision import FEATURES, Rule

SAID = 0.95
"""Probability that the evidence alone must give a name, or the names of a set, to be said."""
CERTAIN = 100.0
"""Constant of a rule by which the right name is always among those weighed."""
EVIDENCE_ALONE = Rule(weights=dict.fromkeys(FEATURES, 0.0) | {"constant": CERTAIN}, say_name=SAID, say_set=0.0)
"""A name's probability is its weight among all that could stand in its place; a set is always said."""
EXACT_PCT = 1e-3
"""Prior sd of a discrepancy that is none, in per cent of what commonly acts at its port. The least ripple of the proof
is two hundred times as large."""


def _without(module: ModuleType, name: str, value: object) -> Callable[..., Verdict]:
    """``mismatch.diagnose`` with another value of something that it uses."""

    def diagnosed(*asked: Any, **options: Any) -> Verdict:
        with patch.object(module, name, value):
            return diagnose(*asked, **options)

    return diagnosed


no_learnt_decision = _without(decision, "learnt_rule", lambda: EVIDENCE_ALONE)
"""What is said is decided by the evidence alone."""
no_discrepancy = _without(marginal, "DISCREPANCY_PCT", EXACT_PCT)
"""The simulator's equations are taken for exact."""
no_relinearisation = _without(settle, "TURNS", 1)
"""Each hypothesis is linearised once, where it is proposed."""
