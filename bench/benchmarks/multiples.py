"""Means of scores over recordings, and their paired multiples of one row's: numbers, and cells of a table."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import pandas as pd

from twinbench.bench.report.table_formats import Cell, number, span
from twinbench.bench.statistics.bootstrap import SequenceScores, means, ratios

INTERVALS = "In brackets: the 95 % interval over recordings. ×: the paired multiple of {of}, with its interval."


def compared(
    scores: pd.DataFrame, metrics: Mapping[str, str], names: Sequence[str], first: str
) -> tuple[pd.DataFrame, list[list[Cell]]]:
    """By name, the mean of each metric, and its multiple of that of the ``first`` row: all numbers, and cells.

    Args:
        scores: columns ``sequence, metric, value, row``.
        metrics: what each is called.
        names: of rows, in their order.
        first: one of them.
    """
    frames, columns = [], []
    for metric in metrics:
        table = _of(scores, metric, names)
        mean, times = means(table).set_index("estimator"), ratios(table, first).set_index("estimator")
        times = times[["ratio", "low", "high"]].add_prefix("times_")
        frame = mean[["mean", "low", "high"]].join(times)
        frames.append(frame.assign(metric=metric).reset_index(names="row"))
        columns.append([_cell(*row) for row in frame.to_numpy().tolist()])
    return pd.concat(frames, ignore_index=True), columns


def _of(scores: pd.DataFrame, metric: str, names: Sequence[str]) -> SequenceScores:
    wide = scores[scores["metric"] == metric].pivot(index="row", columns="sequence", values="value").loc[list(names)]
    return SequenceScores(metric, tuple(names), tuple(wide.columns), wide.to_numpy(), {}, ())


def _cell(mean: float, low: float, high: float, times: float, times_low: float, times_high: float) -> Cell:
    more = f"×{times:.2f} [{times_low:.2f}–{times_high:.2f}]" if math.isfinite(times) else ""
    return Cell(number(mean), span(low, high), more)
