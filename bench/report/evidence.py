"""What the report needs of the stored estimates themselves: coverage by regime, errors over time, tracks, scenes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd

from twinbench.bench.estimates import Estimates
from twinbench.bench.roster import PROPOSED
from twinbench.bench.statistics.aligned import truth_at
from twinbench.bench.statistics.coverage import coverage_by_regime, coverage_table
from twinbench.bench.statistics.scores import parameter_error_series
from twinbench.bench.statistics.strata import in_stratum, select
from twinbench.bench.statistics.tracking import health_change
from twinbench.data.batch import Array, Batch
from twinbench.data.scenes import ONSET_S
from twinbench.machines.compressor import COMPRESSOR, OUTPUTS

SHOWN = {COMPRESSOR.name: ("capacity", "leakage", "heat_transfer", "T_bias_K")}
"""By machine, the health parameters that are drawn; all of any other. The compressor's are those of the paper's Fig. 4.
"""
PARITY_POINTS = 8000
"""As many as the paper's Fig. 3c shows."""
AFTERMATH_S = 300.0
"""How long after something abrupt the innovations of Fig. 6c are looked at."""
CHANNELS_READ = len(OUTPUTS)
NIS_WINDOWS_S = {"normal": (0.0, np.inf), **dict.fromkeys(("fouling", "bias"), (ONSET_S, ONSET_S + AFTERMATH_S))}
"""By scene: the time of the innovations of Fig. 6c."""


class Track(NamedTuple):
    """One estimator's answer over one sequence.

    Attributes:
        mean: (M, n) in the quantities' units.
        low: (M, n) likewise.
        high: (M, n) likewise.
    """

    mean: Array
    low: Array
    high: Array


@dataclass
class Example:
    """One test sequence with everybody's estimates of it.

    Attributes:
        time_s: (M,) seconds.
        truth: (M, n) in the quantities' units.
        tracks: by estimator.
    """

    sequence: str
    time_s: Array
    truth: Array
    tracks: dict[str, Track] = field(default_factory=dict)


@dataclass
class Evidence:
    """Gathered in one pass over the stored cells, so that only one of them is in memory at a time.

    Attributes:
        coverage: what ``bench.statistics.coverage.coverage_table`` returns; empty without any cell.
        errors: per estimator, the instantaneous mean relative parameter error in %, all seeds, (n,).
        trajectory: the test sequence whose load moves most.
        degradations: per degrading health parameter, the test sequence in which it moves most.
        flow: (2, n) true and estimated mass flow of the proposed method, kg/s, all over the test split.
        scenes: the paper's own, ``data.scenes``, by name; empty where the run has none.
        nis: (n,) dimensionless, of the proposed method's updates with all channels, in the scenes ``normal``,
            ``fouling`` and ``bias``, the latter two from their onset on.
    """

    coverage: pd.DataFrame = field(default_factory=pd.DataFrame)
    errors: dict[str, Array] = field(default_factory=dict)
    trajectory: Example | None = None
    degradations: dict[str, Example] = field(default_factory=dict)
    flow: Array = field(default_factory=lambda: np.empty((2, 0)))
    scenes: dict[str, Example] = field(default_factory=dict)
    nis: dict[str, Array] = field(default_factory=dict)


def gather(cells: Iterable[Estimates], truth: Batch, failures: Mapping[str, str]) -> Evidence:
    """Read what is needed of every cell, on worn machines; the examples show each estimator's first seed.

    Args:
        truth: the test recordings with their truth.
        failures: per estimator with failed cells, which and why.
    """
    wanted, shown = _examples(truth), SHOWN.get(truth.machine.name, truth.machine.health_names)
    examples: dict[str, Example] = {}
    coverage, errors = [], dict[str, list[Array]]()
    flow = np.empty((2, 0))
    for all_of_it in cells:
        cell = select(all_of_it, "worn")
        coverage.append(coverage_by_regime(cell, truth).assign(estimator=cell.estimator, seed=cell.seed))
        errors.setdefault(cell.estimator, []).append(parameter_error_series(cell, truth).ravel())
        if cell.estimator == PROPOSED and truth.machine is COMPRESSOR and not flow.size:
            flow = _flow(cell, truth)
        _add_tracks(examples, cell, truth, set(wanted.values()))
    return Evidence(
        coverage=coverage_table(pd.concat(coverage, ignore_index=True), failures) if coverage else pd.DataFrame(),
        errors={name: np.concatenate(parts) for name, parts in errors.items()},
        trajectory=examples.get(wanted["load"]),
        degradations={name: examples[wanted[name]] for name in shown if wanted.get(name) in examples},
        flow=flow,
    )


def add_scenes(evidence: Evidence, takes: Iterable[tuple[Batch, Estimates]]) -> None:
    """Put what the estimators made of the paper's scenes in ``evidence``.

    Args:
        takes: recordings of a scene with their truth, and one estimator's estimates of them.
    """
    for truth, estimates in takes:
        _add_tracks(evidence.scenes, estimates, truth, set(estimates.names))
        if estimates.estimator == PROPOSED:
            for name, (since_s, until_s) in NIS_WINDOWS_S.items():
                if name in estimates.names:
                    b = estimates.names.index(name)
                    shown = (since_s <= estimates.time_s) & (estimates.time_s < until_s)
                    shown &= estimates.nis_dof[b] == CHANNELS_READ
                    evidence.nis[name] = estimates.nis[b, shown].astype(np.float64)


def _add_tracks(examples: dict[str, Example], estimates: Estimates, truth: Batch, sequences: set[str]) -> None:
    """One estimator's tracks of those sequences; those of its first seed stay."""
    for b, sequence in enumerate(estimates.names):
        if sequence not in sequences:
            continue
        if sequence not in examples:
            at = truth_at(truth, (sequence,), estimates.time_s)
            examples[sequence] = Example(sequence, estimates.time_s, at.estimated[0])
        track = Track(estimates.mean[b].copy(), estimates.low[b].copy(), estimates.high[b].copy())
        examples[sequence].tracks.setdefault(estimates.estimator, track)


def _flow(estimates: Estimates, truth: Batch) -> Array:
    """(2, n): true and estimated flow, kg/s, at points spread evenly over all sequences."""
    at = truth_at(truth, estimates.names, estimates.time_s)
    i = OUTPUTS.index("m_flow_kg_s")
    both = np.stack(
        [COMPRESSOR.observe(of)[..., i].ravel() for of in (at.estimated, estimates.mean.astype(np.float64))]
    )
    return both[:, np.linspace(0, both.shape[1] - 1, min(PARITY_POINTS, both.shape[1])).astype(int)]


def _examples(truth: Batch) -> dict[str, str]:
    """The sequence to show for ``load`` and for each health parameter that changes somewhere."""
    assert truth.truth is not None
    moves = truth.truth.outputs[..., 0].std(axis=1)
    moves = np.where([in_stratum(name, "worn") for name in truth.names], moves, -1.0)
    wanted = {"load": truth.names[int(moves.argmax())]}
    largest: dict[str, float] = {}
    for name, health in zip(truth.names, truth.truth.health, strict=True):
        if not in_stratum(name, "worn"):
            continue
        change = health_change(truth.machine, truth.time_s, health)
        if change is None:
            continue
        parameter = truth.machine.health_names[change.parameter]
        if change.size > largest.get(parameter, 0.0):
            largest[parameter] = change.size
            wanted[parameter] = name
    return wanted
