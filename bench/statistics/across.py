"""How estimators compare over several machines: ranks over all recordings, and on how many machines one is ahead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import rankdata

from twinbench.bench.roster import UNRANKED, WITHOUT_EQUATIONS, ordered
from twinbench.bench.statistics.apart import complete, distance
from twinbench.bench.statistics.bootstrap import SequenceScores
from twinbench.bench.statistics.ranks import Ranking, rank
from twinbench.bench.statistics.summary import LIFE, Summary
from twinbench.data.batch import Array


def pooled(tables: Mapping[str, SequenceScores]) -> SequenceScores:
    """Ranks by one metric over all machines, recording by recording. Reference rows are left out.

    Recordings of one name have the same wear on every machine, so they are one block: ranks are averaged over them.

    Who lacks a recording of any machine has a reason, and no rank.

    Args:
        tables: by machine, of the same metric.
    """
    names = ordered({e for table in tables.values() for e in table.estimators if e not in UNRANKED})
    reasons: dict[str, str] = {}
    for name in names:
        lost = [machine for machine, table in tables.items() if name not in complete(table)]
        if lost:
            reasons[name] = f"no complete scores on {', '.join(lost)}"
    whole = [name for name in names if name not in reasons]
    blocks: dict[str, list[Array]] = {}
    for table in tables.values():
        ranks = rankdata([distance(table, name) for name in whole], axis=0) if whole else np.empty((0, 0))
        for i, sequence in enumerate(table.sequences if whole else ()):
            blocks.setdefault(sequence, []).append(ranks[:, i])
    values = np.full((len(names), len(blocks)), np.nan)
    values[[names.index(name) for name in whole]] = np.transpose([np.mean(b, axis=0) for b in blocks.values()])
    metric = next(iter(tables.values())).metric
    return SequenceScores(metric, tuple(names), tuple(blocks), values, reasons, ())


def rank_across(summaries: Mapping[str, Summary], metric: str = LIFE) -> Ranking:
    """Ranks over the recordings of all machines, as ``pooled`` has them, by Friedman and Nemenyi as on one machine.

    Args:
        summaries: by machine.
        metric: what is ranked by.

    Raises:
        ValueError: fewer than two estimators are complete on every machine.
    """
    tables = {machine: s.by_sequence[metric] for machine, s in summaries.items() if metric in s.by_sequence}
    if len(tables) < len(summaries):
        raise ValueError(f"no scores of {metric} on {', '.join(set(summaries) - set(tables))}")
    return rank(pooled(tables))


def is_ahead(summary: Summary, estimator: str, metrics: Sequence[str] = (LIFE,)) -> bool | None:
    """Do the tests of one machine call it better, in each metric, than every other estimator without plant equations?

    Returns:
        None where there is nothing to say: a reference row, no complete scores, or nobody to be ahead of.
    """
    found = [_ahead(summary, estimator, metric) for metric in metrics]
    return None if None in found else all(found)


def _ahead(summary: Summary, estimator: str, metric: str) -> bool | None:
    table = summary.by_sequence.get(metric)
    known = complete(table) if table is not None else []
    others = [e for e in known if e in WITHOUT_EQUATIONS and e != estimator]
    if estimator in UNRANKED or estimator not in known or not others:
        return None
    return all(summary.better(estimator, other, metric) for other in others)
