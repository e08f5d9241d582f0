"""The benchmark's figures, named as in the paper where it has them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from twinbench.bench.report.evidence import Evidence
from twinbench.bench.report.figures.coverage import coverage_by_quantity, coverage_by_regime
from twinbench.bench.report.figures.errors import (
    LEAST_SHOWN_PCT,
    critical_difference,
    error_bars,
    parameter_violins,
)
from twinbench.bench.report.figures.latency import accuracy_and_time, latency_percentiles
from twinbench.bench.report.figures.robustness import after_faults, beyond_the_envelope, noise_and_dropout
from twinbench.bench.report.figures.scenes import flow_parity, innovations, ramps, wear
from twinbench.bench.report.figures.tracks import parameter_tracking, state_trajectories
from twinbench.bench.roster import PROPOSED, label
from twinbench.bench.statistics.subject import Subject
from twinbench.bench.statistics.summary import FORECAST, LIFE, PARAMETERS, QUESTIONS, Summary
from twinbench.common.page import Drawing
from twinbench.data.scenes import RAMP_NAMES

NO_ESTIMATES = "the store holds no estimates of this run"

FROM_ESTIMATES = (
    "fig5c_parameter_errors", "fig3_states", "fig3a_pressure_ramps", "fig3b_temperature_ramps", "fig3c_parity",
    "fig4_parameters", "fig4a_capacity", "fig4b_leakage", "fig4c_heat_transfer", "fig6c_innovations",
)  # fmt: skip
"""Figures that are drawn from the estimates themselves."""

COVERAGE = ("coverage", "coverage_regimes")
"""Figures of what intervals hold."""
WEAR = {
    "fig4a_capacity": ("capacity", "capacity", "Capacity falls from 1.00 to 0.88 in 18 minutes"),
    "fig4b_leakage": ("leakage", "leakage", "Leakage grows from 0.015 to 0.052 in 18 minutes"),
    "fig4c_heat_transfer": ("cooling", "heat_transfer", "Cooling is impaired in two stages"),
}
"""By figure: the scene, the health parameter, and what happens."""


def draw(summary: Summary, evidence: Evidence, latency: pd.DataFrame, robustness: pd.DataFrame) -> Iterator[Drawing]:
    """All figures of a run, one at a time.

    Args:
        latency: columns estimator, mode, implementation, window, p50_us, p95_us, p99_us, max_us.
        robustness: columns estimator, seed, group, condition, sequence, metric, value; empty where no
            harder conditions were tried.
    """
    yield from _errors(summary)
    yield _spread(summary, evidence)
    yield from _coverage(evidence.coverage, summary.subject)
    yield from _states(evidence)
    yield _health(evidence, summary.subject)
    yield from _scenes_of_wear(evidence)
    yield from _harder(evidence, robustness)
    yield from _times(summary, latency)


def draw_any(summary: Summary, evidence: Evidence, latency: pd.DataFrame) -> Iterator[Drawing]:
    """The figures that a run on any machine has; arguments as of ``draw``."""
    yield from _errors(summary)
    yield _health(evidence, summary.subject)
    yield from _coverage(evidence.coverage, summary.subject)
    yield from _times(summary, latency)


def _errors(summary: Summary) -> Iterator[Drawing]:
    """Fig. 5: errors and ranks."""
    yield Drawing(
        "fig5a_errors",
        "State errors with their 95 % intervals over the test sequences, on a logarithmic scale: equal distances are "
        "equal factors. The dashed line is the reference, the oracle, which knows the exact plant and the "
        "sensors, but not how health moves.",
        error_bars(summary) if summary.values else None,
        "no cell finished",
        "State errors",
    )
    yield _ranks(summary, LIFE, "fig5b_ranks_parameters")
    yield _ranks(summary, FORECAST, "fig5b_ranks_forecast")


def _spread(summary: Summary, evidence: Evidence) -> Drawing:
    """Fig. 5c."""
    known_errors = any(np.isfinite(errors).any() for errors in evidence.errors.values())
    return Drawing(
        "fig5c_parameter_errors",
        "Mean relative error of capacity, efficiency, leakage and heat transfer over all test time. Violin: density; "
        "box: quartiles with the median; line: 5th to 95th percentile; ticks: means of the single sequences; dashed: "
        f"the oracle's median. Errors below {LEAST_SHOWN_PCT:g} % count as that.",
        parameter_violins(evidence.errors, _by_sequence(summary)) if known_errors else None,
        NO_ESTIMATES,
        "How parameter errors spread",
    )


def _coverage(coverage: pd.DataFrame, subject: Subject) -> Iterator[Drawing]:
    """What the intervals hold, by quantity and by regime."""
    yield Drawing(
        "coverage",
        "How often the 95 % interval of each quantity holds the truth. Dashed: 95 %, which is right; below it an "
        "estimator is surer than it should be. Grey: where an exact filter could lie if each sequence counted as one "
        "trial. Bars: 95 % interval over the sequences.",
        coverage_by_quantity(coverage, subject) if len(coverage) else None,
        NO_ESTIMATES,
        "What the 95 % intervals hold, by quantity",
    )
    yield Drawing(
        "coverage_regimes",
        "The same by operating regime, mean of all quantities: thirds of the operating point, and before, during and "
        "after a change of health.",
        coverage_by_regime(coverage) if len(coverage) else None,
        NO_ESTIMATES,
        "What the 95 % intervals hold, by regime",
    )


def _states(evidence: Evidence) -> Iterator[Drawing]:
    """Fig. 3: states over time, load ramps, mass flow."""
    trajectory = evidence.trajectory
    yield Drawing(
        "fig3_states",
        "States over the test sequence whose load moves most. Left: truth (broad grey) and estimates; right: estimate "
        f"minus truth, with the 95 % band of {label(PROPOSED)}.",
        state_trajectories(trajectory) if trajectory else None,
        NO_ESTIMATES,
        "States over one recording",
    )
    yield from _ramps(evidence)
    yield Drawing(
        "fig3c_parity",
        f"Mass flow of {label(PROPOSED)} against the truth at {evidence.flow.shape[1]:,} points spread evenly over the "
        "test sequences. Dashed: equal.",
        flow_parity(evidence.flow) if evidence.flow.size else None,
        NO_ESTIMATES if not evidence.errors else f"no estimates of {label(PROPOSED)}",
        "Mass flow against the truth",
    )


def _health(evidence: Evidence, subject: Subject) -> Drawing:
    """Fig. 4: health over time on test sequences."""
    return Drawing(
        "fig4_parameters",
        "Health parameters, each on the test sequence in which it changes most: truth (broad grey), estimates, and the "
        f"95 % band of {label(PROPOSED)}.",
        parameter_tracking(evidence.degradations, subject) if evidence.degradations else None,
        "no estimates of a test sequence whose health changes",
        "Health parameters over time",
    )


def _scenes_of_wear(evidence: Evidence) -> Iterator[Drawing]:
    """Figs. 4a to c: health over time in the scenes of wear."""
    for name, (scene, parameter, says) in WEAR.items():
        yield Drawing(
            name,
            f"{says}: truth (broad grey), estimates, and the 95 % band of {label(PROPOSED)}.",
            wear(evidence.scenes[scene], parameter) if scene in evidence.scenes else None,
            "",
            says,
        )


def _harder(evidence: Evidence, robustness: pd.DataFrame) -> Iterator[Drawing]:
    """Fig. 6: under harder conditions, where they were tried, and after something abrupt."""
    if PROPOSED in set(robustness["estimator"]):
        yield Drawing(
            "fig6a_noise_dropout",
            f"Error of the filtered pressure of {label(PROPOSED)} under so many times the sensors' noise and with so "
            "many samples missing.",
            noise_and_dropout(robustness),
            "",
            "Under noise and dropout",
        )
        yield Drawing(
            "fig6b_envelope",
            "Loads beyond the training envelope: what the 95 % intervals hold, and the health error, by what is "
            "done about sensitivities and process noise there.",
            beyond_the_envelope(robustness),
            "",
            "Beyond the training envelope",
        )
    yield Drawing(
        "fig6c_innovations",
        f"Normalised innovation squared of {label(PROPOSED)} at updates with all three channels: in normal "
        "operation, in the five minutes after capacity and heat transfer fell at once, and in those after the "
        "temperature sensor went off by 5 K.",
        innovations(evidence.nis) if evidence.nis else None,
        "",
        "Innovations after something abrupt",
    )
    if "health_after_fault_pct" in set(robustness["metric"]):
        yield Drawing(
            "faults",
            "Health error from a minute after sensor faults on, by kind of fault: the mean over the sensors that have "
            "it, one at a time. The first column is the same time without a fault.",
            after_faults(robustness),
            "",
            "After sensor faults",
        )


def _times(summary: Summary, latency: pd.DataFrame) -> Iterator[Drawing]:
    """What one update takes, and what accuracy comes with it."""
    yield Drawing(
        "latency",
        "Time of one update of one machine, measured serially. Dashed: the sample period, within which a twin must "
        "be done.",
        latency_percentiles(latency, summary.subject.period_s) if len(latency) else None,
        "no latency was measured in this run",
        "Time of one update",
    )
    yield Drawing(
        "fig7c_accuracy_time",
        "Error against the time of one update, both on logarithmic scales; down and left is better. Dashed: who, the "
        "reference rows apart, is beaten by nobody in both.",
        accuracy_and_time(summary, latency) if len(latency) and summary.values else None,
        "no latency was measured in this run" if not len(latency) else "no cell finished",
        "Accuracy and time",
    )


def _ramps(evidence: Evidence) -> Iterator[Drawing]:
    """Figs. 3a and b, where the run has the scenes."""
    there = any(PROPOSED in evidence.scenes[name].tracks for name in RAMP_NAMES if name in evidence.scenes)
    for name, column, quantity in (
        ("fig3a_pressure_ramps", 0, "exhaust pressure"),
        ("fig3b_temperature_ramps", 1, "gas temperature"),
    ):
        caption = (
            f"{quantity.capitalize()} over five load ramps and what {label(PROPOSED)} makes of it; dashed: the error "
            "that the paper reports at most."
        )
        title = f"{quantity.capitalize()} over load ramps"
        yield Drawing(name, caption, ramps(evidence.scenes, column) if there else None, "", title)


def _ranks(summary: Summary, question: str, name: str) -> Drawing:
    """Fig. 5b for one question."""
    caption = (
        f"Mean ranks by {QUESTIONS[question]}; 1 is best, the reference rows are left out. A bar joins estimators that "
        "these sequences cannot tell apart: mean ranks within Nemenyi's critical difference, or all where Friedman's "
        "test finds no difference at the 5 % level."
    )
    ranking = summary.rankings.get(question)
    title = f"Mean ranks by {QUESTIONS[question]}"
    if ranking is None:
        return Drawing(name, caption, None, summary.unranked[question], title)
    ranks = dict(zip(ranking.estimators, map(float, ranking.mean_ranks), strict=True))
    says = f"mean rank by {QUESTIONS[question]}, {len(ranking.sequences)} sequences"
    figure = critical_difference(ranks, ranking.cliques, ranking.critical_difference, says)
    return Drawing(name, caption, figure, "", title)


def _by_sequence(summary: Summary) -> dict[str, np.ndarray]:
    scores = summary.by_sequence.get(PARAMETERS)
    return dict(zip(scores.estimators, scores.values, strict=True)) if scores else {}
