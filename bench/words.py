"""What the statistics say, in sentences: the same numbers always give the same words."""

from __future__ import annotations

import math

from bench.ranks import Ranking
from bench.roster import FLOOR, PROPOSED, label
from bench.scores import IDEAL
from bench.summary import FORECAST, PARAMETERS, Summary
from bench.table_formats import number

ALPHA = 0.05
DOES = {PARAMETERS: "knows the machine's health best", FORECAST: "foretells the next minute best"}
ERROR = {PARAMETERS: "mean parameter error", FORECAST: "60 s forecast error"}


def headline(summary: Summary) -> str:
    """The answer in one sentence: which estimator keeps the twin true."""
    if len(summary.rankings) < len(DOES):
        return "Nothing to compare: fewer than two estimators finished on two sequences"
    winner, forecaster = (_by_mean(summary, question)[0] for question in (PARAMETERS, FORECAST))
    if winner != forecaster:
        return f"{label(winner)} knows the machine's health best, {label(forecaster)} foretells best"
    if any(_not_told_apart(ranking, winner) for ranking in summary.rankings.values()):
        return f"{label(winner)} keeps the twin truest, but not beyond doubt"
    return f"{label(winner)} keeps the twin truest"


def answer(summary: Summary) -> list[str]:
    """The answer in full, one paragraph per string."""
    said = [_best_at(summary, question) for question in summary.rankings]
    said += _proposed(summary)
    return said + [_honesty(summary, e) for e in dict.fromkeys(_by_mean(summary, q)[0] for q in summary.rankings)]


def certainty(summary: Summary) -> list[str]:
    """How sure the answer is: what the tests say, what these sequences can resolve, who is missing."""
    return [_friedman(ranking, question) for question, ranking in summary.rankings.items()] + summary.notes


def _by_mean(summary: Summary, question: str) -> list[str]:
    """The ranked estimators, the smallest mean error first."""
    return sorted(summary.rankings[question].estimators, key=lambda e: summary.value(e, question).mean)


def _pair(ranking: Ranking, one: str, other: str) -> tuple[float, bool]:
    """Holm-adjusted Wilcoxon p-value of two estimators, and whether it tells them apart."""
    pairs = ranking.pairs
    row = pairs[pairs["first"].isin((one, other)) & pairs["second"].isin((one, other))].iloc[0]
    return float(row["holm_p"]), bool(row["resolved"])


def _not_told_apart(ranking: Ranking, winner: str) -> list[str]:
    return [e for e in ranking.estimators if e != winner and not _pair(ranking, winner, e)[1]]


def _size(summary: Summary, estimator: str, question: str) -> str:
    """``4.1 % (95 % interval 3.5 to 4.9), 1.4 times the oracle's floor``, as far as it is known."""
    value = summary.value(estimator, question)
    text = f"{number(value.mean)} %"
    if math.isfinite(value.low):
        text += f" (95 % interval {number(value.low)} to {number(value.high)})"
    if math.isfinite(value.times):
        text += f", {number(value.times)} times the oracle's {number(summary.value(FLOOR, question).mean)} %"
    return text


def _best_at(summary: Summary, question: str) -> str:
    best, second = _by_mean(summary, question)[:2]
    ranking = summary.rankings[question]
    gap, low, high = summary.difference(second, best, question)
    scores = summary.by_sequence[question]
    wins = int((scores.row(best) < scores.row(second)).sum())
    p, resolved = _pair(ranking, best, second)
    verdict = (
        f"the two are told apart (Wilcoxon, {_p(p)} after Holm's correction for all pairs)" if resolved
        else f"after Holm's correction for all pairs these sequences do not tell the two apart (Wilcoxon, {_p(p)})"
    )
    return (
        f"{label(best)} {DOES[question]}: {ERROR[question]} {_size(summary, best, question)}. "
        f"Next comes {label(second)}, {number(gap)} percentage points worse (95 % interval {number(low)} to "
        f"{number(high)}) and beaten on {wins} of {len(scores.sequences)} sequences; {verdict}."
    )


def _proposed(summary: Summary) -> list[str]:
    """How the proposed method does wherever it is not the best, or not there at all."""
    if PROPOSED not in summary.estimators:
        return [f"The proposed method, {label(PROPOSED)}, took no part in this run."]
    said = []
    for question, ranking in summary.rankings.items():
        order = _by_mean(summary, question)
        if PROPOSED not in order:
            said.append(f"The proposed method, {label(PROPOSED)}, has no complete {ERROR[question]}: "
                        f"{ranking.dropped.get(PROPOSED, 'it failed')}.")  # fmt: skip
        elif order[0] != PROPOSED:
            said.append(
                f"The proposed method, {label(PROPOSED)}, is not the best by {ERROR[question]}: it is number "
                f"{order.index(PROPOSED) + 1} of {len(order)} with {_size(summary, PROPOSED, question)}."
            )
    return said


def _honesty(summary: Summary, estimator: str) -> str:
    value = summary.value(estimator, "coverage95_pct")
    ideal = IDEAL["coverage95_pct"]
    if not math.isfinite(value.mean):
        return f"Whether the intervals of {label(estimator)} are honest is not known: it has no coverage."
    judged = "too narrow: it is surer than it should be"
    if value.low <= ideal <= value.high:
        judged = "as wide as they should be, as far as these sequences can tell"
    elif value.mean > ideal:
        judged = "wider than they need be"
    spread = f" (95 % interval {number(value.low)} to {number(value.high)})" if math.isfinite(value.low) else ""
    return (
        f"The 95 % intervals of {label(estimator)} hold the truth {number(value.mean)} % of the time{spread}; "
        f"they are {judged}."
    )


def _friedman(ranking: Ranking, question: str) -> str:
    n = f"{len(ranking.estimators)} estimators on {len(ranking.sequences)} sequences"
    if not math.isfinite(ranking.friedman_p):
        return f"By {ERROR[question]}, {n} are too few for Friedman's test."
    differ = "do differ" if ranking.friedman_p < ALPHA else "cannot be told from alike"
    return f"By {ERROR[question]}, {n} {differ} as a group (Friedman, {_p(ranking.friedman_p)})."


def _p(p: float) -> str:
    return f"p = {p:.2g}" if p >= 1e-4 else "p < 0.0001"
