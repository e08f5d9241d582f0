"""What the statistics say, in sentences: the same numbers always give the same words."""

from __future__ import annotations

import math

from twinbench.bench.report.table_formats import number, span
from twinbench.bench.roster import PROPOSED, REFERENCE, label
from twinbench.bench.statistics.apart import FAMILY_LEVEL
from twinbench.bench.statistics.ranks import Ranking
from twinbench.bench.statistics.summary import FORECAST, LIFE, Summary

WHERE = {LIFE: "in health", FORECAST: "in the forecast"}
BEST = {LIFE: "knows the machine's health best", FORECAST: "foretells the next minute best"}
ERROR = {LIFE: "health error", FORECAST: "60 s forecast error"}
COUNT = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def headline(summary: Summary) -> str:
    """The answer in one sentence: which estimator keeps the twin true, if the tests tell any apart."""
    if len(summary.rankings) < len(BEST):
        return "Nothing to compare: fewer than two estimators finished on two sequences"
    alike = {q: _alike(summary, q) for q in BEST}
    leader = {q: _by_mean(summary, q)[0] for q in BEST}
    if len(set(leader.values())) == 1 and not any(alike.values()):
        return f"{label(leader[LIFE])} keeps the twin truest"
    first, then = BEST
    if leader[first] == leader[then] and all(alike.values()):
        return (
            f"{label(leader[first])} cannot be told apart from {_count(len(alike[first]))} {WHERE[first]}, nor from "
            f"{_count(len(alike[then]))} {WHERE[then]}"
        )
    who = {first: label(leader[first]), then: "it" if leader[then] == leader[first] else label(leader[then])}
    said = [
        f"{who[q]} cannot be told apart from {_count(len(alike[q]))} {WHERE[q]}" if alike[q] else f"{who[q]} {BEST[q]}"
        for q in BEST
    ]
    return "; ".join(said)


def answer(summary: Summary) -> list[str]:
    """The answer in full, one paragraph per string."""
    said = [_best_at(summary, question) for question in summary.rankings]
    return said + _proposed(summary)


def certainty(summary: Summary) -> list[str]:
    """How sure the answer is: what the tests say, what these sequences can resolve, who is missing."""
    return [_friedman(ranking, question) for question, ranking in summary.rankings.items()] + summary.notes


def _by_mean(summary: Summary, question: str) -> list[str]:
    """The ranked estimators, the smallest mean error first."""
    return sorted(summary.rankings[question].estimators, key=lambda e: summary.value(e, question).mean)


def _alike(summary: Summary, question: str) -> list[str]:
    """Who cannot be told from the best by its mean, in order of their means."""
    best, *others = _by_mean(summary, question)
    return [e for e in others if not summary.better(best, e, question)]


def _holm_p(ranking: Ranking, one: str, other: str) -> float:
    """Holm-adjusted Wilcoxon p-value of two estimators."""
    pairs = ranking.pairs
    return float(pairs[pairs["first"].isin((one, other)) & pairs["second"].isin((one, other))].iloc[0]["holm_p"])


def _size(summary: Summary, estimator: str, question: str) -> str:
    """``4.1 % (95 % interval 3.5 to 4.9), 1.4 times the oracle's 2.9 %``, as far as it is known."""
    value = summary.value(estimator, question)
    text = f"{number(value.mean)} %"
    if math.isfinite(value.low):
        text += f" (95 % interval {number(value.low)} to {number(value.high)})"
    if math.isfinite(value.times):
        text += f", {number(value.times)} times the oracle's {number(summary.value(REFERENCE, question).mean)} %"
    return text


def _best_at(summary: Summary, question: str) -> str:
    best, second, *_ = _by_mean(summary, question)
    ranking = summary.rankings[question]
    alike = _alike(summary, question)
    apart = [e for e in _by_mean(summary, question)[1:] if e not in alike]
    size = _size(summary, best, question)
    tests = "Wilcoxon's test, Holm's correction for all pairs"
    if not alike:
        says = f"{label(best)} {BEST[question]}: {ERROR[question]} {size}. "
        says += f"It differs significantly from every other ({tests})."
    else:
        named = names_of(f"{label(e)} ({p_value(_holm_p(ranking, best, e))})" for e in alike)
        says = f"{label(best)} has the least {ERROR[question]}: {size}. It does not differ significantly from {named}"
        says += f", but does from {names_of(map(label, apart))} ({tests})." if apart else f" ({tests})."
    gap, low, high = summary.difference(second, best, question)
    scores = summary.by_sequence[question]
    wins = int((scores.row(best) < scores.row(second)).sum())
    few = " A few sequences can move the mean; the test looks at ranks." if second in alike and low > 0.0 else ""
    return (
        f"{says} Next comes {label(second)}: {_more(gap)} (95 % interval {span(low, high, to=True)}), beaten on "
        f"{wins} of {len(scores.sequences)} sequences.{few}"
    )


def _more(gap: float) -> str:
    return f"{number(abs(gap))} percentage points {'more' if gap >= 0 else 'less'}"


def _proposed(summary: Summary) -> list[str]:
    """How the proposed method does wherever it is not the best, or not there at all."""
    if PROPOSED not in summary.estimators:
        return [f"The proposed method, {label(PROPOSED)}, took no part in this run."]
    said = []
    for question, ranking in summary.rankings.items():
        order = _by_mean(summary, question)
        if PROPOSED not in order:
            said.append(
                f"The proposed method, {label(PROPOSED)}, has no complete {ERROR[question]}: "
                f"{ranking.dropped.get(PROPOSED, 'it failed')}."
            )
        elif order[0] != PROPOSED:
            alike = " It does not differ significantly from the first." if PROPOSED in _alike(summary, question) else ""
            said.append(
                f"The proposed method, {label(PROPOSED)}, does not have the least {ERROR[question]}: it is number "
                f"{order.index(PROPOSED) + 1} of {len(order)} with {_size(summary, PROPOSED, question)}.{alike}"
            )
    return said


def _friedman(ranking: Ranking, question: str) -> str:
    n = f"{len(ranking.estimators)} estimators on {len(ranking.sequences)} sequences"
    if not math.isfinite(ranking.friedman_p):
        return f"By {ERROR[question]}, {n} are too few for Friedman's test."
    differ = "differ significantly" if ranking.friedman_p < FAMILY_LEVEL else "do not differ significantly"
    return f"By {ERROR[question]}, {n} {differ} as a group (Friedman, {p_value(ranking.friedman_p)})."


def _count(others: int) -> str:
    """``five others``."""
    return f"{COUNT[others] if others < len(COUNT) else others} other{'' if others == 1 else 's'}"


def names_of(labels: object) -> str:
    """``a, b and c``; where a name holds a comma ``a; b, c; and d``."""
    names = list(labels)  # type: ignore[call-overload]
    comma, last = ("; ", "; and ") if any(", " in name for name in names) else (", ", " and ")
    return last.join(filter(None, (comma.join(names[:-1]), names[-1])))


def p_value(p: float) -> str:
    """``p = 0.012``, dimensionless."""
    return f"p = {p:.2g}" if p >= 1e-4 else "p < 0.0001"
