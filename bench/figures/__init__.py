"""The benchmark's figures, named as in the paper where it has them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bench.evidence import Evidence
from bench.figures.coverage import coverage_by_quantity, coverage_by_regime
from bench.figures.errors import critical_difference, error_bars, parameter_violins
from bench.figures.latency import latency_percentiles
from bench.figures.tracks import parameter_tracking, state_trajectories
from bench.roster import PROPOSED, label
from bench.summary import FORECAST, PARAMETERS, QUESTIONS, Summary


class Drawing(NamedTuple):
    """A figure with its caption, or why it could not be drawn."""

    name: str
    caption: str
    figure: Figure | None
    missing: str = ""


def draw(summary: Summary, evidence: Evidence, latency: pd.DataFrame) -> Iterator[Drawing]:
    """All figures of a run, one at a time.

    Args:
        latency: columns estimator, mode, implementation, window, p50_us, p95_us, p99_us, max_us.
    """
    no_estimates = "the store holds no estimates of this run"
    trajectory, degradations, coverage = evidence.trajectory, evidence.degradations, evidence.coverage
    yield _drawing(
        "fig5a_errors",
        "State errors with their 95 % intervals over the test sequences, on a logarithmic scale: equal distances are "
        "equal factors. The dashed line is the floor, the oracle that knows the exact plant.",
        lambda: error_bars(summary),
        "" if summary.values else "no cell finished",
    )
    for question, name in ((PARAMETERS, "fig5b_ranks_parameters"), (FORECAST, "fig5b_ranks_forecast")):
        yield _ranks(summary, question, name)
    yield _drawing(
        "fig5c_parameter_errors",
        "Mean relative error of capacity, efficiency, leakage and heat transfer over all test time. Violin: density; "
        "box: quartiles with the median; line: 5th to 95th percentile; ticks: means of the single sequences; dashed: "
        "the oracle's median.",
        lambda: parameter_violins(evidence.errors, _by_sequence(summary)),
        "" if any(np.isfinite(e).any() for e in evidence.errors.values()) else no_estimates,
    )
    yield _drawing(
        "coverage",
        "How often the 95 % interval of each quantity holds the truth. Dashed: 95 %, which is right; left of it an "
        "estimator is surer than it should be. Grey: where an exact filter could lie if each sequence counted as one "
        "trial. Bars: 95 % interval over the sequences.",
        lambda: coverage_by_quantity(_known(coverage)),
        "" if coverage is not None else no_estimates,
    )
    yield _drawing(
        "coverage_regimes",
        "The same by operating regime, mean of the ten quantities: thirds of speed and of pressure ratio, and before, "
        "during and after a change of health.",
        lambda: coverage_by_regime(_known(coverage)),
        "" if coverage is not None else no_estimates,
    )
    yield _drawing(
        "fig3_states",
        f"States over the test sequence whose load moves most. Left: truth (broad grey) and estimates; right: estimate "
        f"minus truth, with the 95 % band of {label(PROPOSED)}.",
        lambda: state_trajectories(_known(trajectory)),
        "" if trajectory is not None else no_estimates,
    )
    yield _drawing(
        "fig4_parameters",
        "Health parameters, each on the test sequence in which it changes most: truth (broad grey), estimates, and the "
        f"95 % band of {label(PROPOSED)}.",
        lambda: parameter_tracking(degradations),
        "" if degradations else "no estimates of a test sequence whose health changes",
    )
    yield _drawing(
        "latency",
        "Time of one online update of one machine, measured serially.",
        lambda: latency_percentiles(latency),
        "" if len(latency) else "no latency was measured in this run",
    )
