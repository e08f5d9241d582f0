"""What the report needs of the stored estimates themselves: coverage by regime, errors over time, example tracks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd

from bench.aligned import truth_at
from bench.coverage import coverage_by_regime, coverage_table
from bench.estimates import Estimates
from bench.scores import parameter_error_series
from bench.tracking import health_change
from data.batch import HEALTH, OUTPUTS, Array, Batch

SHOWN = ("capacity", "leakage", "heat_transfer", "T_bias_K")
"""The health parameters that degrade in the benchmark, as in the paper's Fig. 4."""


class Track(NamedTuple):
    """One estimator's answer over one sequence; each (M, 10), order ESTIMATED, physical units."""

    mean: Array
    low: Array
    high: Array


@dataclass
class Example:
    """One test sequence with everybody's estimates of it; truth (M, 10), order ESTIMATED."""

    sequence: str
    time_s: Array
    truth: Array
    tracks: dict[str, Track] = field(default_factory=dict)


@dataclass
class Evidence:
    """Gathered in one pass over the stored cells, so that only one of them is in memory at a time.

    Attributes:
        coverage: what ``bench.coverage.coverage_table`` returns; empty without any cell.
        errors: per estimator, the instantaneous mean relative parameter error in %, all seeds, (n,).
        trajectory: the test sequence whose load moves most.
        degradations: per degrading health parameter, the test sequence in which it moves most.
    """

    coverage: pd.DataFrame = field(default_factory=pd.DataFrame)
    errors: dict[str, Array] = field(default_factory=dict)
    trajectory: Example | None = None
    degradations: dict[str, Example] = field(default_factory=dict)


def gather(cells: Iterable[Estimates], truth: Batch, failures: Mapping[str, str]) -> Evidence:
    """Read what is needed of every cell; the examples show each estimator's first seed.

    Args:
        truth: the test recordings with their truth.
        failures: per estimator with failed cells, which and why.
    """
    wanted = _examples(truth)
    examples: dict[str, Example] = {}
    coverage, errors = [], dict[str, list[Array]]()
    for cell in cells:
        coverage.append(coverage_by_regime(cell, truth).assign(estimator=cell.estimator, seed=cell.seed))
        errors.setdefault(cell.estimator, []).append(parameter_error_series(cell, truth).ravel())
        for sequence in set(wanted.values()) & set(cell.names):
            if sequence not in examples:
                at = truth_at(truth, (sequence,), cell.time_s)
                examples[sequence] = Example(sequence, cell.time_s, at.estimated[0])
            b = cell.names.index(sequence)
            track = Track(cell.mean[b].copy(), cell.low[b].copy(), cell.high[b].copy())
            examples[sequence].tracks.setdefault(cell.estimator, track)
    return Evidence(
        coverage=coverage_table(pd.concat(coverage, ignore_index=True), failures) if coverage else pd.DataFrame(),
        errors={name: np.concatenate(parts) for name, parts in errors.items()},
        trajectory=examples.get(wanted["load"]),
        degradations={kind: examples[s] for kind, s in wanted.items() if kind in SHOWN and s in examples},
    )


def _examples(truth: Batch) -> dict[str, str]:
    """The sequence to show for ``load`` and for each health parameter that changes somewhere."""
    assert truth.truth is not None
    moves = truth.truth.outputs[..., OUTPUTS.index("p_dis_bar")].std(axis=1)
    wanted = {"load": truth.names[int(moves.argmax())]}
    largest: dict[str, float] = {}
    for name, health in zip(truth.names, truth.truth.health, strict=True):
        change = health_change(truth.time_s, health)
        if change is not None and change.size > largest.get(HEALTH[change.parameter], 0.0):
            largest[HEALTH[change.parameter]] = change.size
            wanted[HEALTH[change.parameter]] = name
    return wanted
