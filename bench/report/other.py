"""The report of a run on a machine that is not the paper's: its tables, and the sentences that their tests hold."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pandas as pd

from twinbench.bench.report import kept
from twinbench.bench.report.evidence import Evidence, gather
from twinbench.bench.report.figures import COVERAGE, FROM_ESTIMATES, draw_any
from twinbench.bench.report.main_table import extremes
from twinbench.bench.report.measured import (
    INTERVALS,
    MARKS,
    TIMES,
    Measure,
    definitions,
    full,
    measured,
    metric_cell,
    references,
    skill_cell,
)
from twinbench.bench.report.paired import ablation_table
from twinbench.bench.report.provenance import bullets, write_page, write_tables
from twinbench.bench.report.robustness_tables import robustness_tables
from twinbench.bench.report.table_formats import Cell, Column, Table, number, span
from twinbench.bench.report.tables import (
    CONSISTENT,
    FOLLOWED,
    calibrated_regimes,
    cost_table,
    latency_table,
    regime_table,
)
from twinbench.bench.report.verdicts import CALIBRATED_PCT, true_start, within_limit
from twinbench.bench.report.words import names_of
from twinbench.bench.results import Results
from twinbench.bench.roster import PROPOSED, REFERENCE, UNRANKED, is_ablation, label
from twinbench.bench.statistics.regimes import regimes_of
from twinbench.bench.statistics.subject import Subject
from twinbench.bench.statistics.summary import FORECAST, LIFE, Summary, summarise
from twinbench.common.page import write_bytes, write_figures

CALIBRATED = "calibrated_coverage"
"""What the names of calibrated coverages begin with."""


def write_other(results: Results) -> Table:
    """Write ``tables/``, ``figures/``, ``answer.md`` and ``report.html`` beside what the run left.

    Returns:
        The comparison of the estimators, for a terminal.
    """
    whole = ~results.scores["estimator"].map(is_ablation)
    failures = {name: why for name, why in results.failures.items() if not is_ablation(name)}
    summary = summarise(results.scores[whole], failures, subject=results.subject)
    evidence = Evidence()
    if (truth := results.truth()) is not None:
        evidence = gather(results.estimates(), truth, results.failures)
    tables, gone = tables_of(summary, results.cost), kept.lacking(summary, evidence)
    if truth is not None:
        known = regimes_of(truth.machine)
        evidence.coverage = kept.with_earlier_regimes(evidence.coverage, results.out / "tables", gone, known)
        tables += [regime_table(evidence.coverage, known), calibrated_regimes(evidence.coverage, known)]
    if not whole.all():
        tables.append(ablation_table(results.scores, results.failures, results.subject))
    tables += [latency_table(results.latency, summary.subject.period_s), cost_table(results.cost)]
    tables += robustness_tables(results.robustness, summary.subject)
    said = sentences(summary)
    write_tables(results.out, tables)
    write_bytes(results.out / "answer.md", bullets(*said).encode())
    earlier = dict.fromkeys(FROM_ESTIMATES, kept.lacks(gone)) if gone else {}
    if truth is None:
        earlier = dict.fromkeys((*FROM_ESTIMATES, *COVERAGE), "the store lacks the estimates")
    figures = write_figures(results.out / "figures", draw_any(summary, evidence, results.latency), earlier)
    write_page(results, (said[0], said[1:], summary.notes), summary.notes, tables, figures)
    return tables[0]


def tables_of(summary: Summary, cost: pd.DataFrame) -> list[Table]:
    """The comparison, then health, forecasts and calibrated intervals quantity by quantity.

    Args:
        cost: columns estimator, seed, stage, cpu_s.
    """
    subject = summary.subject
    health = [Measure(f"{h.name}_life_pct", h.label, "error, % of life") for h in subject.health]
    moving = [Measure(f"health_{kind}_pct", kind, "parameters, % of life") for kind in ("moving", "still")]
    foretold = [
        Measure(f"{o.key}_open{lead}_pct", o.reads, f"{lead} s ahead, %") for lead in (60, 10) for o in subject.outputs
    ]
    calibrated = [Measure(f"{CALIBRATED}_{q.name}_pct", q.label, "inside, %") for q in subject.quantities]
    title = "Coverage of the 95 % intervals after calibration"
    return [
        comparison(summary, cost),
        measured("health", "Health", [Measure(LIFE, "mean", "error, % of life"), *health, *moving], summary),
        measured("forecast", "Forecasts", foretold, summary),
        measured("calibrated", title, calibrated, summary),
        measured("following", "Following a change of health", FOLLOWED[-2:], summary),
        measured("consistency", "Consistency of the innovations and errors", CONSISTENT, summary),
    ]


def comparison(summary: Summary, cost: pd.DataFrame) -> Table:
    """Rows: the estimators. Health, what it is worth, filtered states, forecast, intervals, training.

    Args:
        cost: columns estimator, seed, stage, cpu_s.
    """
    subject, names = summary.subject, summary.estimators
    states = [Measure(m, o.says, "filtered, %") for m, o in zip(subject.state_errors, subject.outputs, strict=True)]
    measures = [Measure(LIFE, "% of life", "health"), *states, Measure(FORECAST, "mean, %", "60 s ahead")]
    parts = [(Column(m.head, m.group), [metric_cell(summary, e, m.metric) for e in names]) for m in measures]
    parts.insert(1, (Column("skill", "health"), [skill_cell(summary, e, LIFE) for e in names]))
    ends = [extremes(summary, e, CALIBRATED) for e in names]
    for i, head in enumerate(("lowest", "highest")):
        cells = [Cell(number(found[i][0]), found[i][1]) if found else Cell("–") for found in ends]
        parts.append((Column(head, "coverage, %"), cells))
    minutes = cost[cost["stage"] == "fit"].groupby("estimator")["cpu_s"].mean() / 60.0
    parts.append((Column("min", "training"), [Cell(number(float(minutes.get(e, np.nan)))) for e in names]))
    frame = full(measures, summary)
    for column in ("value", "low", "high"):
        frame[f"skill_{column}"] = [getattr(summary.skill(e, LIFE), column) for e in names]
    rows = zip([Cell(label(e)) for e in names], *(cells for _, cells in parts), strict=True)
    notes = (*summary.notes, INTERVALS, TIMES, MARKS, *references(summary))
    columns = (Column("estimator"), *(column for column, _ in parts))
    title = f"{subject.says or subject.machine}: comparison on the test recordings"
    return Table("comparison", title, frame, columns, tuple(rows), notes, definitions(measures, subject))


def sentences(summary: Summary) -> list[str]:
    """What the tables' tests hold: who leads in health and in the forecast, and how near the proposed method comes."""
    said = [_leader(summary, LIFE, "health"), _leader(summary, FORECAST, "the 60 s forecast")]
    return [*filter(None, said), *_proposed(summary, summary.subject), *true_start(summary)]


def _leader(summary: Summary, metric: str, what: str) -> str:
    known = {e: summary.value(e, metric).mean for e in summary.estimators if e not in UNRANKED}
    known = {e: value for e, value in known.items() if math.isfinite(value) and e not in summary.failures}
    if not known:
        return f"Nobody has an error in {what}."
    best = min(known, key=known.__getitem__)
    value = summary.value(best, metric)
    told = [label(e) for e in known if e != best and summary.told_apart(best, e, metric)]
    same = [label(e) for e in known if e != best and not summary.told_apart(best, e, metric)]
    text = f"{label(best)} has the least error in {what}: {number(value.mean)} %"
    if math.isfinite(value.low):
        text += f" (95 % interval {span(value.low, value.high, to=True)})"
    if told:
        text += f"; Wilcoxon's test with Holm's correction tells it from {names_of(told)}"
    return text + (f"; it is not told from {names_of(same)}." if same else ".")


def _proposed(summary: Summary, subject: Subject) -> Iterator[str]:
    if PROPOSED not in summary.estimators:
        return
    skill = summary.skill(PROPOSED, LIFE)
    if math.isfinite(skill.low):
        yield (
            f"{label(PROPOSED)} has a skill of {number(skill.value, 2)} in health over {label(skill.against)} "
            f"({span(skill.low, skill.high, to=True)})."
        )
    wanted = {LIFE: "health", **{m: o.says for m, o in zip(subject.state_errors, subject.outputs, strict=True)}}
    times = [(says, summary.value(PROPOSED, m)) for m, says in wanted.items()]
    if REFERENCE in summary.estimators and all(math.isfinite(v.times) for _, v in times):
        listed = "; ".join(f"{s} {number(v.times)} ({span(v.times_low, v.times_high, to=True)})" for s, v in times)
        yield (
            f"It errs this many times as much as the reference (95 % interval): {listed}. {within_limit(dict(times))}"
        )
    ends = extremes(summary, PROPOSED, CALIBRATED)
    if ends is not None:
        (low, of_low), (high, of_high) = ends
        right = CALIBRATED_PCT[0] <= low and high <= CALIBRATED_PCT[1]
        yield (
            f"Its calibrated 95 % intervals hold the truth {number(low)} % of the time at least ({of_low}) and "
            f"{number(high)} % at most ({of_high}). All between {CALIBRATED_PCT[0]:g} and {CALIBRATED_PCT[1]:g} %: "
            f"{'yes' if right else 'no'}."
        )
