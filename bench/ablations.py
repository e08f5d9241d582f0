"""What each part of a method is worth: the method without it, against the whole, sequence by sequence."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from bench.bootstrap import differences, sequence_scores
from bench.roster import ABLATION, is_ablation, label, ordered
from bench.scores import DEFINITIONS, IDEAL
from bench.summary import PARAMETERS
from bench.table_formats import Cell, Column, Table, number

METRICS = {
    "p_nrmse_pct": ("p", "filtered, %"),
    "T_nrmse_pct": ("T", "filtered, %"),
    "m_nrmse_pct": ("m", "filtered, %"),
    "p_open60_pct": ("p", "60 s ahead, %"),
    "T_open60_pct": ("T", "60 s ahead, %"),
    "m_open60_pct": ("m", "60 s ahead, %"),
    PARAMETERS: ("parameters", "error, %"),
    "coverage95_pct": ("95 % interval", "inside, %"),
}
NOTES = (
    "Paired difference, without the part minus with it, mean over the test sequences; in brackets its 95 % interval: "
    "bootstrap over whole sequences, seeds averaged inside each first. Of errors more than 0 says that the part helps; "
    "marked is what differs from 0 for sure.",
)


def ablation_table(scores: pd.DataFrame, failures: Mapping[str, str]) -> Table:
    """Rows: ablations. Columns: how much worse than the whole method.

    Args:
        scores: columns ``estimator, seed, sequence, metric, value``, of whole methods and ablations.
        failures: per estimator with failed cells, which and why.
    """
    names = [n for n in ordered(scores["estimator"].unique()) if is_ablation(n)]
    against: dict[tuple[str, str, str], tuple[float, ...]] = {}
    for metric in METRICS:
        table = sequence_scores(scores, metric, failures)
        for whole in {name.partition(ABLATION)[0] for name in names} & set(table.estimators):
            found = differences(table, whole)[["estimator", "difference", "low", "high"]].to_numpy().tolist()
            against |= {(name, whole, metric): tuple(values) for name, *values in found}
    lines = []
    for name in names:
        line: dict[str, Any] = {"estimator": name}
        for metric in METRICS:
            values = against.get((name, name.partition(ABLATION)[0], metric), (np.nan,) * 3)
            line |= dict(zip((metric, f"{metric}_low", f"{metric}_high"), values, strict=True))
        lines.append(line | {"failed": failures.get(name, "")})
    frame = pd.DataFrame(lines)
    rows = tuple((Cell(_says(line["estimator"])), *(_cell(line, metric) for metric in METRICS)) for line in lines)
    columns = (Column("without"), *(Column(head, group) for head, group in METRICS.values()))
    definitions = tuple(f"{group} {head}: {DEFINITIONS[m]}" for m, (head, group) in METRICS.items())
    return Table("ablations", "Ablations: what each part is worth", frame, columns, rows, NOTES, definitions)


def _says(name: str) -> str:
    whole, _, part = name.partition(ABLATION)
    return f"{label(whole)}, {part.replace('_', ' ')}"


def _cell(line: Mapping[str, Any], metric: str) -> Cell:
    value, low, high = line[metric], line[f"{metric}_low"], line[f"{metric}_high"]
    if not np.isfinite(value):
        return Cell("failed" if line["failed"] else "–")
    sure = metric not in IDEAL and bool(low > 0.0 or high < 0.0)
    return Cell(f"{'+' if value > 0 else ''}{number(value)}", f"{number(low)}–{number(high)}", best=sure)
