"""Who is best in a column, and who cannot be told from that: what a table may mark."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from twinbench.bench.roster import UNRANKED
from twinbench.bench.statistics.bootstrap import SequenceScores
from twinbench.bench.statistics.ranks import holm, wilcoxon_p
from twinbench.bench.statistics.scores import IDEAL

FAMILY_LEVEL = 0.05
"""Family-wise level of all tests. A smaller one tells fewer estimators apart, and marks more of them."""


def marked(table: SequenceScores, alpha: float = FAMILY_LEVEL) -> tuple[str, ...]:
    """The estimator with the best mean, then all that paired tests do not tell from it.

    Wilcoxon's signed-rank test over the sequences, Holm's correction over all pairs of the ranked estimators
    that have a score on every sequence; calibration metrics by their distance to the ideal. Empty where
    nobody is told from the best, and with fewer than two estimators or sequences.
    """
    names = [n for n in table.estimators if n not in UNRANKED and n not in table.reasons]
    if len(names) < 2 or len(table.sequences) < 2:
        return ()
    off = {n: np.abs(table.row(n) - IDEAL.get(table.metric, 0.0)) for n in names}
    # As the column shows it: a calibration metric's mean may be right where no sequence's is.
    best = min(names, key=lambda n: abs(float(table.row(n).mean()) - IDEAL.get(table.metric, 0.0)))
    pairs = list(combinations(names, 2))
    adjusted = holm(np.array([wilcoxon_p(off[b] - off[a]) for a, b in pairs]))
    apart = {frozenset(pair) for pair, p in zip(pairs, adjusted, strict=True) if p < alpha}
    group = (best, *(n for n in names if n != best and frozenset((best, n)) not in apart))
    return group if len(group) < len(names) else ()
