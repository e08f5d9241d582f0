"""All statistics that the tables, the figures and the report's words are made of, computed once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd

from twinbench.bench.roster import REFERENCE, UNRANKED, ordered
from twinbench.bench.statistics.apart import told_apart
from twinbench.bench.statistics.bootstrap import (
    SequenceScores,
    differences,
    means,
    ratios,
    score_tables,
    sequence_scores,
)
from twinbench.bench.statistics.censored import CENSORED, Waiting, restricted, waiting, watched
from twinbench.bench.statistics.marks import marked
from twinbench.bench.statistics.ranks import Ranking, rank
from twinbench.bench.statistics.scores import definitions_of, ideal
from twinbench.bench.statistics.skill import Skill, skills
from twinbench.bench.statistics.strata import Stratum, of_stratum
from twinbench.bench.statistics.subject import PAPERS, Subject

LIFE = "health_life_pct"
PARAMETERS = "parameter_error_pct"
"""The paper's measure of health. A small leakage decides it; LIFE weighs the five alike."""
FORECAST = "forecast60_pct"
QUESTIONS = {LIFE: "error of health in % of life", FORECAST: "60 s forecast error"}
"""What the estimators are ranked by: knowing the machine's health, and foretelling what it does."""


class Value(NamedTuple):
    """A metric's mean over the sequences and its multiple of the reference, with 95 % intervals; NaN: none.

    Of a time that may not have come, ``mean`` is the median over the changes of health in all runs, inf where it lies
    beyond what was watched; ``happened`` of ``runs`` changes did come.
    """

    mean: float = np.nan
    low: float = np.nan
    high: float = np.nan
    times: float = np.nan
    times_low: float = np.nan
    times_high: float = np.nan
    happened: float = np.nan
    runs: float = np.nan


@dataclass(frozen=True)
class Summary:
    """What the benchmark found on the recordings of one stratum.

    Attributes:
        estimators: everyone who took part, failed ones included, in the roster's order.
        values: by (estimator, metric).
        skills: by (estimator, metric) of every error, against the best row that costs nothing.
        by_sequence: per metric, scores by sequence.
        marked: per metric, whom its column marks, as ``bench.statistics.marks.marked`` finds them.
        rankings: per question; reference rows are left out. Missing where nothing could be ranked.
        unranked: per question without a ranking, why.
        failures: per estimator with failed cells, which and why.
        subject: what the run was about.
    """

    estimators: tuple[str, ...]
    values: dict[tuple[str, str], Value]
    skills: dict[tuple[str, str], Skill]
    by_sequence: dict[str, SequenceScores]
    marked: dict[str, tuple[str, ...]]
    rankings: dict[str, Ranking]
    unranked: dict[str, str]
    failures: dict[str, str]
    subject: Subject = PAPERS
    _tested: dict[tuple[str, ...], bool] = field(default_factory=dict, repr=False, compare=False)

    @property
    def notes(self) -> list[str]:
        """What must be said beside any ranking: its resolution, and who is missing from it and why."""
        said = [f"Ranked by {QUESTIONS[q]}: {note}" for q, r in self.rankings.items() for note in r.notes]
        said += [f"Not ranked by {QUESTIONS[q]}: {why}." for q, why in self.unranked.items()]
        return said + [f"Failed: {name}: {why}." for name, why in self.failures.items()]

    def value(self, estimator: str, metric: str) -> Value:
        """All NaN where the estimator has no such score."""
        return self.values.get((estimator, metric), Value())

    def skill(self, estimator: str, metric: str) -> Skill:
        """All NaN where the estimator has none."""
        return self.skills.get((estimator, metric), Skill())

    def difference(self, estimator: str, reference: str, metric: str) -> tuple[float, float, float]:
        """Mean paired difference, estimator minus reference, with its 95 % interval."""
        frame = differences(self.by_sequence[metric], reference).set_index("estimator")
        mean, low, high = frame.loc[[estimator], ["difference", "low", "high"]].to_numpy(dtype=float)[0]
        return float(mean), float(low), float(high)

    def ratio(self, estimator: str, reference: str, metric: str) -> tuple[float, float, float]:
        """The estimator's mean over the reference's, paired by sequence, with its 95 % interval."""
        frame = ratios(self.by_sequence[metric], reference).set_index("estimator")
        ratio, low, high = frame.loc[[estimator], ["ratio", "low", "high"]].to_numpy(dtype=float)[0]
        return float(ratio), float(low), float(high)

    def told_apart(self, first: str, second: str, question: str) -> bool:
        """Do paired tests, Holm-corrected, tell two estimators apart by a metric? Not where a score is missing.

        No sentence may call one better without it. ``bench.statistics.apart.family`` says which pairs are tested
        together.
        """
        table = self.by_sequence.get(question)
        key = (*sorted((first, second)), question)
        if key not in self._tested:
            self._tested[key] = table is not None and told_apart(table, first, second)
        return self._tested[key]

    def better(self, first: str, second: str, question: str) -> bool:
        """Is the first told apart from the second by an error, and errs less?"""
        mean = self.value(first, question).mean
        return self.told_apart(first, second, question) and mean < self.value(second, question).mean


def summarise(
    scores: pd.DataFrame, failures: Mapping[str, str], stratum: Stratum = "worn", subject: Subject = PAPERS
) -> Summary:
    """The statistics of a whole run, on the recordings of one stratum.

    Args:
        scores: columns ``estimator, seed, sequence, metric, value``.
        failures: per estimator with failed cells, which and why.
        stratum: the worn machines, which the benchmark ranks by, or the paper's recordings.
        subject: what the run was about.
    """
    scores = of_stratum(scores, stratum)
    scores = pd.concat([scores, _forecast_scores(scores, subject)], ignore_index=True)
    there = set(scores["metric"])
    metrics = [m for m in (*definitions_of(subject), FORECAST) if m in there and m not in CENSORED]
    # A table finds its rows and estimators by name: as categories three times as quickly.
    quick = scores.astype(dict.fromkeys(("estimator", "sequence", "metric"), "category"))
    tables = score_tables(quick, metrics, failures)
    values = {key: value for table in tables.values() for key, value in _values(table).items()}
    won = {(e, m): s for m, table in tables.items() if ideal(m) is None for e, s in skills(table).items()}
    for metric in CENSORED:
        times_s = watched(scores, metric)
        if times_s.empty:
            continue
        values |= {(str(e), metric): _waited(waiting(own)) for e, own in times_s.groupby("estimator")}
        tables[metric] = sequence_scores(restricted(times_s, metric), metric, failures)
    rankings, unranked = {}, {}
    ranked = scores[~scores["estimator"].isin(UNRANKED)]
    lost = {name: why for name, why in failures.items() if name not in UNRANKED}
    for question in QUESTIONS:
        try:
            rankings[question] = rank(sequence_scores(ranked, question, lost))
        except ValueError as error:
            unranked[question] = str(error)
    return Summary(
        estimators=tuple(ordered({*scores["estimator"], *failures})),
        values=values,
        skills=won,
        by_sequence=tables,
        marked={metric: marked(table) for metric, table in tables.items()},
        rankings=rankings,
        unranked=unranked,
        failures=dict(failures),
        subject=subject,
    )


def _waited(w: Waiting) -> Value:
    return Value(w.median_s, w.low_s, w.high_s, happened=w.happened, runs=w.runs)


def _forecast_scores(scores: pd.DataFrame, subject: Subject) -> pd.DataFrame:
    """The mean of the outputs' forecast errors, per estimator, seed and sequence."""
    key = ["estimator", "seed", "sequence"]
    parts = scores[scores["metric"].isin(subject.forecast_errors)].pivot(index=key, columns="metric", values="value")
    return parts.mean(axis=1, skipna=False).rename("value").reset_index().assign(metric=FORECAST)


def _values(table: SequenceScores) -> dict[tuple[str, str], Value]:
    own = means(table).set_index("estimator")[["mean", "low", "high"]]
    values = {(str(e), table.metric): Value(*row) for e, row in zip(own.index, own.to_numpy(), strict=True)}
    if REFERENCE in table.estimators and ideal(table.metric) is None:
        above = ratios(table).set_index("estimator")[["ratio", "low", "high"]]
        for e, (times, low, high) in zip(above.index, above.to_numpy(), strict=True):
            key = (str(e), table.metric)
            values[key] = values[key]._replace(times=times, times_low=low, times_high=high)
    return values
