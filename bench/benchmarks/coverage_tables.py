"""What the study of coverage shows: where intervals are right, errors beside the reference's, an exact posterior."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd

from twinbench.bench.benchmarks.exact_posterior import REGIMES_SHOWN
from twinbench.bench.benchmarks.multiples import INTERVALS, compared
from twinbench.bench.report.table_formats import Cell, Column, Table, number, span
from twinbench.bench.report.verdicts import CALIBRATED_PCT, within_limit
from twinbench.bench.report.words import p_value
from twinbench.bench.roster import PROPOSED, REFERENCE, label, ordered
from twinbench.bench.statistics.ranks import holm, wilcoxon_p
from twinbench.bench.statistics.subject import Subject
from twinbench.bench.statistics.summary import LIFE, Value

KINDS = ("all samples", "by operating point", "by what health did")
"""Of regimes; the last ones only the truth tells apart."""


def right_pairs(table: pd.DataFrame) -> Table:
    """Of each estimator, in how many pairs of quantity and regime the calibrated coverage is right.

    Args:
        table: what ``coverage_table`` returns.
    """
    pairs = table[table["quantity"] != "mean"]
    pairs = pairs.assign(right=pairs["calibrated_pct"].between(*CALIBRATED_PCT), kind=pairs["regime"].map(_kind))
    found = pairs.groupby(["estimator", "kind"])["right"].agg(["sum", "count"]).reset_index()
    said = {(e, kind): f"{right} of {of}" for e, kind, right, of in found.itertuples(index=False)}
    names = ordered(pairs["estimator"].unique())
    rows = tuple((Cell(label(name)), *(Cell(said[name, kind]) for kind in KINDS)) for name in names)
    title = f"Pairs of quantity and regime with {CALIBRATED_PCT[0]:g} to {CALIBRATED_PCT[1]:g} % inside"
    return Table("right_pairs", title, found, (Column("estimator"), *map(Column, KINDS)), rows)


def _kind(regime: str) -> str:
    """All samples, an operating point that inputs and readings tell, or what only the truth tells."""
    if regime == "all":
        return KINDS[0]
    return KINDS[2] if regime.startswith(("after_", "steady_")) else KINDS[1]


def errors_table(scores: pd.DataFrame, subject: Subject) -> Table:
    """Errors of each estimator beside the reference's, and of the proposed method against the others.

    Args:
        scores: columns ``sequence, metric, value, row``, a row being an estimator.
        subject: what is estimated.
    """
    metrics = {**dict(zip(subject.state_errors, (o.says for o in subject.outputs), strict=True)), LIFE: "health"}
    names = ordered(scores["row"].unique())
    frame, columns = compared(scores, metrics, names, REFERENCE)
    cells = [[Cell(label(name)) for name in names], *columns]
    group = {LIFE: "% of life"}
    heads = (Column("estimator"), *(Column(says, group.get(m, "filtered, %")) for m, says in metrics.items()))
    ours = _times(frame, PROPOSED)
    listed = "; ".join(f"{metrics[m]} {number(ratio)} ({span(low, high, to=True)})" for m, ratio, low, high in ours)
    limit = within_limit({metrics[m]: Value(times_low=low, times_high=high) for m, _, low, high in ours})
    count = scores["sequence"].nunique()
    notes = (
        f"{count} fresh recordings, networks of the first seed. {INTERVALS.format(of='the reference')}",
        f"{label(PROPOSED)} errs this many times as much as the reference (95 % interval): {listed}. {limit}",
        *_against(scores, metrics, [n for n in names if n not in (PROPOSED, REFERENCE)]),
    )
    return Table("errors", "Errors beside the reference's", frame, heads, tuple(zip(*cells, strict=True)), notes)


def _times(frame: pd.DataFrame, row: str) -> list[tuple[str, float, float, float]]:
    """By metric, the multiple of one row, and its interval."""
    own = frame[frame["row"] == row]
    columns = own["metric"], own["times_ratio"], own["times_low"], own["times_high"]
    return [(str(m), float(ratio), float(low), float(high)) for m, ratio, low, high in zip(*columns, strict=True)]


def _against(scores: pd.DataFrame, metrics: Mapping[str, str], rivals: Sequence[str]) -> Iterator[str]:
    """Of each rival, how many times as much as the proposed method it errs, with Wilcoxon's test."""
    wide = scores.pivot(index="sequence", columns=["row", "metric"], values="value")
    tests = [wilcoxon_p((wide[r, m] - wide[PROPOSED, m]).dropna().to_numpy()) for r in rivals for m in metrics]
    adjusted = iter(holm(np.array(tests)))
    for rival in rivals:
        frame = compared(scores, metrics, [PROPOSED, rival], PROPOSED)[0]
        parts = [
            f"{metrics[m]} {number(ratio)} ({span(low, high, to=True)}; {p_value(next(adjusted))})"
            for m, ratio, low, high in _times(frame, rival)
        ]
        yield (
            f"{label(rival)} errs this many times as much as {label(PROPOSED)} (95 % interval; Wilcoxon's test, Holm's "
            f"correction for all of them): {', '.join(parts)}."
        )


def exact_table(found: pd.DataFrame) -> Table:
    """What an exact posterior holds, by noise and regime.

    Args:
        found: what ``exact_posterior.table`` returns.
    """
    wide = found.pivot(index="reading_sd_lives", columns="regime", values="coverage_pct")[list(REGIMES_SHOWN)]
    rows = tuple((Cell(f"{sd:g}"), *(Cell(f"{pct:.1f}") for pct in row)) for sd, row in wide.iterrows())
    columns = (Column("sd of a reading, lives"), *(Column(says) for says in REGIMES_SHOWN.values()))
    title = "What an exact posterior's 95 % intervals hold, %: one parameter that jumps, one reading a second"
    return Table("exact_posterior", title, found, columns, rows)
