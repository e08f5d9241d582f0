"""What harder conditions cost: tables by condition, of the time after sensor faults, of noise and missing samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from twinbench.bench.report.table_formats import Cell, Column, Table, number, span
from twinbench.bench.roster import is_ablation, label, ordered
from twinbench.bench.statistics.bootstrap import ratios, sequence_scores
from twinbench.bench.statistics.health import in_words
from twinbench.bench.statistics.subject import PAPERS, Subject
from twinbench.data.disturb import DISTURBED_MINUTES, FAULT_BEGINS_S, UNDISTURBED, conditions_of, faults_of

NOTE = (
    "{what}, mean over fresh recordings of "
    f"{DISTURBED_MINUTES:g} minutes that no rule was made with, seeds averaged. × is the multiple of the error without "
    "the condition, in brackets its 95 % interval: bootstrap over whole recordings."
)
AFTER = (
    f"Each fault begins after {FAULT_BEGINS_S:g} s. What counts is the time from a minute after the longest of them on."
)
KINDS = "Of each recording the mean over the sensors that it happens to, one at a time."


def robustness_tables(scores: pd.DataFrame, subject: Subject = PAPERS) -> list[Table]:
    """Of ``robustness.csv``; none where it is empty.

    Args:
        scores: columns estimator, seed, group, condition, sequence, metric, value.
        subject: what the run was about.
    """
    if scores.empty:
        return []
    health = NOTE.format(
        what=f"Mean absolute error of the {in_words(len(subject.health))} health parameters, % of a life"
    )
    groups = _groups(scores, subject)
    noise, harder = groups["noise and dropout"], groups["pace"] + groups["envelope"]
    title = "Under faster wear and loads beyond the envelope" if groups["envelope"] else "Under faster wear"
    tables = [
        (("harder", title), harder, "health_life_pct", (health,)),
        (("faults", "After sensor faults"), groups["fault"], "health_after_fault_pct", (health, AFTER)),
    ]
    for name, says, metric in _states(subject):
        heading = (f"noise_{name}", f"{says.capitalize()} under noise and missing samples")
        tables.append((heading, noise, metric, (NOTE.format(what=f"RMSE of the {says}, %"),)))
    tables.append((("noise_health", "Health under noise and missing samples"), noise, "health_life_pct", (health,)))
    kinds = list(dict.fromkeys(subject.kind_and_sensor(name)[0] for name in groups["fault"]))
    by_kind = (("fault_kinds", "After sensor faults, by kind"), kinds, "health_after_fault_pct", (health, KINDS, AFTER))
    return [
        *(_table(scores, subject, *table) for table in tables),
        _turned(_table(mean_by_kind(scores, subject), subject, *by_kind)),
    ]


def mean_by_kind(scores: pd.DataFrame, subject: Subject) -> pd.DataFrame:
    """Means over the sensors that a kind of fault happens to; the condition is the kind.

    Args:
        scores: columns as ``robustness.csv`` has them.
        subject: what the run was about.
    """
    kinds = scores.assign(condition=[subject.kind_and_sensor(str(c))[0] for c in scores["condition"]])
    return kinds.groupby([c for c in scores.columns if c != "value"], sort=False)["value"].mean().reset_index()


def _turned(table: Table) -> Table:
    """The same with a row for each estimator, so that they are compared down a column."""
    names, rows = table.frame.columns[1:], zip(*table.rows, strict=True)
    conditions, *turned = rows
    heads = (Column("estimator"), *(Column(c.text) for c in conditions))
    frame = table.frame.set_index("condition").T.rename_axis("estimator").rename_axis(columns=None).reset_index()
    cells = tuple((Cell(label(n)), *row) for n, row in zip(names, turned, strict=True))
    return replace(table, frame=frame, columns=heads, rows=cells)


def _groups(scores: pd.DataFrame, subject: Subject) -> dict[str, list[str]]:
    """By group its conditions in their order, as far as somebody was tried under them."""
    inputs, readings = ([c.name for c in channels] for channels in (subject.inputs, subject.readings))
    known = conditions_of(faults_of(inputs, readings, inputs + readings), stretched=True)
    tried = set(scores["condition"])
    return {
        g: [c.name for c in known if c.group == g and c.name in tried] for g in dict.fromkeys(c.group for c in known)
    }


def _states(subject: Subject) -> list[tuple[str, str, str]]:
    """Of which states noise has a table: its name, what the state is, the metric. Of the paper's, the pressure."""
    if subject.machine == PAPERS.machine:
        return [("pressure", "pressure", subject.state_errors[0])]
    return [(o.key, o.says, m) for o, m in zip(subject.outputs, subject.state_errors, strict=True)]


def _table(
    scores: pd.DataFrame,
    subject: Subject,
    heading: tuple[str, str],
    conditions: list[str],
    metric: str,
    notes: tuple[str, ...],
) -> Table:
    chosen = scores[(scores["metric"] == metric) & scores["condition"].isin([UNDISTURBED.name, *conditions])]
    tried = chosen.loc[chosen["condition"] != UNDISTURBED.name, "estimator"]
    names = [n for n in ordered(tried.unique()) if not is_ablation(n)]
    columns = {n: _multiples(chosen[chosen["estimator"] == n]) for n in names}
    rows, lines = [], []
    for condition in (UNDISTURBED.name, *conditions):
        cells = [columns[n].get(condition, NOTHING) for n in names]
        lines.append({"condition": condition, **{n: c[0] for n, c in zip(names, cells, strict=True)}})
        rows.append((Cell(subject.condition_label(condition)), *(_cell(*c) for c in cells)))
    heads = (Column("condition"), *(Column(label(n)) for n in names))
    return Table(*heading, pd.DataFrame(lines), heads, tuple(rows), notes)


NOTHING = (np.nan, np.nan, np.nan, np.nan)


def _multiples(scores: pd.DataFrame) -> dict[str, tuple[float, float, float, float]]:
    """By condition, one estimator's mean and its multiple of the mean without the condition, with an interval."""
    if scores.empty:
        return {}
    mean = scores.groupby("condition")["value"].mean()
    found = {str(c): (float(v), np.nan, np.nan, np.nan) for c, v in mean.items()}
    if UNDISTURBED.name in found:
        # Conditions take the place of estimators: what is paired are the recordings.
        paired = sequence_scores(scores.assign(estimator=scores["condition"]), str(scores["metric"].iloc[0]))
        for condition, times, low, high in ratios(paired, UNDISTURBED.name).iloc[:, :4].itertuples(index=False):
            found[condition] = (found[condition][0], times, low, high)
    return found


def _cell(value: float, times: float, low: float, high: float) -> Cell:
    if not np.isfinite(value):
        return Cell("–")
    if not np.isfinite(times):
        return Cell(number(value))
    return Cell(number(value), times=f"×{number(times, 2)} [{span(low, high)}]")
