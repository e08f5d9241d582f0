"""Who is best in a column, and who cannot be told from that: what a table may mark."""

from __future__ import annotations

from itertools import combinations

from twinbench.bench.roster import UNRANKED
from twinbench.bench.statistics.apart import FAMILY_LEVEL, adjusted, complete
from twinbench.bench.statistics.bootstrap import SequenceScores
from twinbench.bench.statistics.scores import ideal


def marked(table: SequenceScores, alpha: float = FAMILY_LEVEL) -> tuple[str, ...]:
    """The estimator with the best mean, then all that paired tests do not tell from it.

    Wilcoxon's signed-rank test over the sequences, Holm's correction over all pairs of the ranked estimators
    that have a score on every sequence; calibration metrics by their distance to the ideal. Empty where
    nobody is told from the best, and with fewer than two estimators or sequences.
    """
    names = [n for n in complete(table) if n not in UNRANKED]
    if len(names) < 2 or len(table.sequences) < 2:
        return ()
    # As the column shows it: a calibration metric's mean may be right where no sequence's is.
    best = min(names, key=lambda n: abs(float(table.row(n).mean()) - (ideal(table.metric) or 0.0)))
    apart = {pair for pair, p in adjusted(table, list(combinations(names, 2))).items() if p < alpha}
    group = (best, *(n for n in names if n != best and frozenset((best, n)) not in apart))
    return group if len(group) < len(names) else ()
