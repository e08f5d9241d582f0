"""The paper's numbers beside ours and the oracle's, claim by claim."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from twinbench.bench.report.evidence import CHANNELS_READ, Evidence, Example
from twinbench.bench.report.figures.scenes import RAMP_ERRORS, r_squared
from twinbench.bench.report.figures.tracks import states
from twinbench.bench.report.main_table import quickest
from twinbench.bench.report.paper import MEASURED, REPORTED_COVERAGE_PCT, STRONGEST
from twinbench.bench.report.table_formats import Cell, Column, Table, number
from twinbench.bench.roster import ABLATION, PROPOSED, REFERENCE, label
from twinbench.bench.statistics.coverage import nis_median_ratio
from twinbench.bench.statistics.health import TERMINAL_S
from twinbench.bench.statistics.scores import STATE_ERRORS
from twinbench.bench.statistics.summary import PARAMETERS, Summary
from twinbench.bench.statistics.tracking import effective_delay, health_change, recovery_time
from twinbench.data.disturb import CONDITIONS
from twinbench.data.scenes import RAMP_BEGINS_S, RAMP_NAMES, RAMP_S
from twinbench.machines.compressor import COMPRESSOR, ESTIMATED, HEALTH, STATES

SETTLED_S = 30.0
"""After a scene begins: what a filter finds out in this time is not what the paper's figures show."""
RECOVERY = "Fig. 4c, recovery of heat transfer"


class Claim(NamedTuple):
    """One number of the paper, and what this run has in its place; NaN where the run does not tell."""

    says: str
    unit: str
    paper: float
    ours: float
    reference: float = np.nan


def claims(
    summary: Summary, evidence: Evidence, scores: pd.DataFrame, robustness: pd.DataFrame, latency: pd.DataFrame
) -> list[Claim]:
    """All of them, in the paper's order.

    Args:
        scores: columns ``estimator, seed, sequence, metric, value``, of whole methods and ablations.
        robustness: ``robustness.csv``; may be empty.
        latency: ``latency.csv``; may be empty.
    """
    return [
        *_ramps(evidence),
        Claim("Fig. 3c, R² of the mass flow", "1", 0.994, r_squared(evidence.flow) if evidence.flow.size else np.nan),
        *_wear(evidence),
        *_compared(summary),
        *_ablated(scores, robustness),
        *_robust(robustness, evidence),
        *_timed(latency),
    ]


def claims_table(found: list[Claim], of_single: bool) -> Table:
    """A line per claim: the paper's number, ours, the oracle's.

    Args:
        of_single: are they of the paper's kind of recordings? A run without any has worn machines instead.
    """
    rows = tuple(
        (Cell(f"{c.says}{'' if c.unit == '1' else f', {c.unit}'}"), *(Cell(v) for v in _numbers(c, found)))
        for c in found
    )
    notes = (
        f"Ours is {label(PROPOSED)} unless the line says otherwise. A dash: this run does not tell (the oracle has "
        "none, or --ablations or --robustness were left out).",
        "Not reached: the error did not come to stay below a fifth of the change while the scene lasted.",
        "Figures and errors without a scene of their own are of the "
        + (
            "test recordings of the paper's kind."
            if of_single
            else "test recordings, which are not of the paper's kind."
        ),
    )
    columns = (Column("claim"), Column("paper"), Column("ours"), Column(label(REFERENCE)))
    return Table(
        "claims", "The paper's numbers and ours", pd.DataFrame(found, columns=Claim._fields), columns, rows, notes
    )


def _numbers(claim: Claim, found: Sequence[Claim]) -> list[str]:
    """The paper's, ours and the oracle's. Where a scene was tracked and nothing recovered in it, that."""
    texts = [number(claim.paper)]
    for own in ("ours", "reference"):
        tracked = any(c.says.startswith("Fig. 4") and np.isfinite(getattr(c, own)) for c in found)
        never = claim.says == RECOVERY and tracked and np.isnan(getattr(claim, own))
        texts.append("not reached" if never else number(getattr(claim, own)))
    return texts


def _compared(summary: Summary) -> Iterator[Claim]:
    def means(estimator: str, *metrics: str) -> float:
        return float(np.mean([summary.value(estimator, m).mean for m in metrics]))

    names = ("discharge pressure", "temperature", "mass flow", "mean parameter")
    metrics = (*STATE_ERRORS, PARAMETERS)
    for name, metric, paper in zip(names, metrics, (0.72, 0.88, 1.05, 2.6), strict=True):
        yield Claim(f"{name} error", "%", paper, means(PROPOSED, metric), means(REFERENCE, metric))
    for name, metric, paper in zip(names, metrics, (1.34, 1.57, 1.62, 5.9), strict=True):
        yield Claim(f"{label(STRONGEST)}, {name} error", "%", paper, means(STRONGEST, metric))
    yield Claim("DeepONet alone, mean state error", "%", 1.01, means("deeponet", *STATE_ERRORS))
    for name, metric, paper in (
        ("median parameter error", "parameter_median_pct", 2.2),
        ("90th percentile of the parameter error", "parameter_p90_pct", 4.8),
    ):
        yield Claim(name, "%", paper, means(PROPOSED, metric), means(REFERENCE, metric))
    inside = means(PROPOSED, *MEASURED), means(REFERENCE, *MEASURED)
    yield Claim("coverage of measured states' 95 % intervals", "%", REPORTED_COVERAGE_PCT, *inside)


def _ramps(evidence: Evidence) -> Iterator[Claim]:
    def worst(estimator: str, column: int, settled: bool) -> float:
        found = []
        for name, ramp_s in zip(RAMP_NAMES, RAMP_S, strict=True):
            if name in evidence.scenes and estimator in evidence.scenes[name].tracks:
                example = evidence.scenes[name]
                since = example.time_s >= RAMP_BEGINS_S + (ramp_s if settled else 0.0)
                error = states(example.tracks[estimator].mean) - states(example.truth)
                found.append(np.abs(error[since, column]).max())
        return float(max(found, default=np.nan))

    yield Claim(
        "Fig. 3a, largest pressure error after a load ramp",
        "bar",
        RAMP_ERRORS[0],
        worst(PROPOSED, 0, True),
        worst(REFERENCE, 0, True),
    )
    yield Claim(
        "Fig. 3b, largest temperature error in and after a load ramp",
        "K",
        RAMP_ERRORS[1],
        worst(PROPOSED, 1, False),
        worst(REFERENCE, 1, False),
    )


def _wear(evidence: Evidence) -> Iterator[Claim]:
    def tracked(scene: str, parameter: str, estimator: str) -> dict[str, float]:
        example = evidence.scenes.get(scene)
        if example is None or estimator not in example.tracks:
            return {}
        return _tracking(example, parameter, estimator)

    for says, unit, paper, scene, parameter, measure in (
        ("Fig. 4a, terminal error of capacity", "%", 0.9, "capacity", "capacity", "terminal_pct"),
        ("Fig. 4a, effective delay of capacity", "s", 22.0, "capacity", "capacity", "delay_s"),
        ("Fig. 4b, leakage inside its 95 % band", "%", 93.7, "leakage", "leakage", "inside_pct"),
        (RECOVERY, "s", 31.0, "cooling", "heat_transfer", "recovery_s"),
    ):
        ours, reference = (tracked(scene, parameter, e).get(measure, np.nan) for e in (PROPOSED, REFERENCE))
        yield Claim(says, unit, paper, ours, reference)


def _tracking(example: Example, parameter: str, estimator: str) -> dict[str, float]:
    """Terminal error, delay, coverage and recovery of one parameter in one scene."""
    i = ESTIMATED.index(parameter)
    track, true = example.tracks[estimator], example.truth[:, i]
    estimate = track.mean[:, i].astype(np.float64)
    change = health_change(COMPRESSOR, example.time_s, example.truth[:, len(STATES) : len(STATES) + len(HEALTH)])
    assert change is not None, "every scene of Fig. 4 has a change"
    last = example.time_s > example.time_s[-1] - TERMINAL_S
    settled = example.time_s >= SETTLED_S
    inside = (track.low[:, i] <= true) & (true <= track.high[:, i])
    return {
        "terminal_pct": 100.0 * float(np.mean(np.abs(estimate - true)[last] / true[last])),
        "delay_s": effective_delay(example.time_s, estimate, true, change),
        "inside_pct": 100.0 * float(inside[settled].mean()),
        "recovery_s": recovery_time(example.time_s, estimate, true, change),
    }


def _ablated(scores: pd.DataFrame, robustness: pd.DataFrame) -> Iterator[Claim]:
    means = scores.groupby(["estimator", "metric"])["value"].mean()

    def of(ablation: str, metric: str) -> float:
        return float(means.get((f"{PROPOSED}{ABLATION}{ablation}", metric), np.nan))

    yield Claim("without covariance adaptation, parameter error", "%", 4.3, of("no_covariance_adaptation", PARAMETERS))
    yield Claim("without the feasibility penalty, pressure error", "%", 0.96, of("no_feasibility", "p_nrmse_pct"))
    beyond = [c.name for c in CONDITIONS if c.group == "envelope"]
    for says, name, paper in (
        ("worst error beyond the envelope", PROPOSED, 3.4),
        ("the same without the trust coefficient", f"{PROPOSED}{ABLATION}no_trust", 7.9),
    ):
        chosen = robustness[(robustness["estimator"] == name) & robustness["condition"].isin(beyond)]
        worst = chosen[chosen["metric"].isin(STATE_ERRORS)].groupby(["condition", "metric"])["value"].mean()
        yield Claim(says, "%", paper, float(worst.max()) if len(worst) else np.nan)
    slower = of("update_10_hz", "p_nrmse_pct") - float(means.get((PROPOSED, "p_nrmse_pct"), np.nan))
    yield Claim("pressure error more at 10 Hz than at 20", "%", 0.06, slower)


def _robust(robustness: pd.DataFrame, evidence: Evidence) -> Iterator[Claim]:
    mild = {
        c.name
        for c in CONDITIONS
        if c.group == "noise and dropout" and c.corruption.noise <= 1.5 and c.corruption.dropout <= 0.10
    }
    chosen = robustness[(robustness["estimator"] == PROPOSED) & (robustness["metric"] == "p_nrmse_pct")]
    worst = chosen[chosen["condition"].isin(mild)].groupby("condition")["value"].mean()
    yield Claim(
        "Fig. 6a, pressure error up to 1.5 times the noise and 10 % dropout, at most",
        "%",
        1.2,
        float(worst.max()) if len(worst) else np.nan,
    )
    after = evidence.nis.get("fouling")
    ratio = np.nan if after is None else nis_median_ratio(after, CHANNELS_READ)
    yield Claim("Fig. 6c, median innovation after abrupt fouling, of what is expected", "1", 1.06, ratio)


def _timed(latency: pd.DataFrame) -> Iterator[Claim]:
    p50, p99, kB = (quickest(latency, c).get(PROPOSED, np.nan) for c in ("p50_us", "p99_us", "memory_kB"))
    yield Claim("Fig. 7a, median update", "ms", 17.6, p50 / 1e3)
    yield Claim("Fig. 7b, 99th percentile of the update", "ms", 31.0, p99 / 1e3)
    yield Claim("weights, tensors and buffers", "MB", 45.0, kB / 1e3)
