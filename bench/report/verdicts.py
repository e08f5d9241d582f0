"""The sentences of the comparison, each decided by the tables' own tests: what a page may say of the estimators.

No sentence here is written by hand for a run. "Better" needs Wilcoxon's test with Holm's correction, or a 95 % interval
that leaves out what it is compared with; where neither tells, the sentence says so.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping

import pandas as pd

from twinbench.bench.report.main_table import extremes
from twinbench.bench.report.table_formats import number, span
from twinbench.bench.report.words import names_of
from twinbench.bench.roster import PROPOSED, QUANTITIES, REFERENCE, TRIVIAL, TRUE_START, UNRANKED, label
from twinbench.bench.statistics.scores import STATE_ERRORS
from twinbench.bench.statistics.summary import FORECAST, LIFE, Summary, Value
from twinbench.machines.compressor import HEALTH

TIMES_ALLOWED = 1.15
"""How many times the reference's error the proposed method may make and count as close to it. With a larger one it
passes more often; it is what the comparison set out to reach."""
CALIBRATED_PCT = (93.0, 97.0)
"""Between these a quantity's 95 % intervals count as right. Wider bounds call more of them right."""
ASKED = {
    **dict(zip(STATE_ERRORS, ("filtered pressure", "filtered temperature", "filtered flow"), strict=True)),
    LIFE: "health",
    FORECAST: "the 60 s forecast",
}
"""The errors that sentences are about, and what they are called there."""


def verdicts(summary: Summary, regimes: pd.DataFrame) -> list[str]:
    """What the run says of each question, a paragraph per string; nothing where it was not asked.

    Args:
        regimes: what ``bench.statistics.coverage.coverage_table`` returns.
    """
    worth = (*_skill(summary), *_parameters(summary), *true_start(summary))
    near = (*_close(summary), *_passing(summary))
    return [*_states(summary), *worth, *near, *_coverage(summary), *_in_regimes(regimes)]


def _ranked(summary: Summary) -> list[str]:
    return [e for e in summary.estimators if e not in UNRANKED]


def _states(summary: Summary) -> Iterator[str]:
    """Whom the tests tell from the best in each filtered state."""
    for metric in STATE_ERRORS:
        known = [e for e in _ranked(summary) if math.isfinite(summary.value(e, metric).mean)]
        if len(known) < 2:
            continue
        best, *others = sorted(known, key=lambda e: summary.value(e, metric).mean)
        alike = [e for e in others if not summary.better(best, e, metric)]
        least = f"In {ASKED[metric]} {label(best)} has the least error, {_with_interval(summary.value(best, metric))}"
        if not alike:
            yield f"{least}. The tests tell it from every other ranked estimator."
        elif len(alike) == len(others):
            yield f"{least}. The tests tell it from no other ranked estimator."
        else:
            yield f"{least}. The tests tell it from all ranked estimators but {names_of(map(label, alike))}."


def _skill(summary: Summary) -> Iterator[str]:
    """Who is worth more than the rows that cost nothing, by the paired interval."""
    for metric in (LIFE, FORECAST):
        skills = {e: summary.skill(e, metric) for e in summary.estimators if e not in (*TRIVIAL, TRUE_START)}
        skills = {e: s for e, s in skills.items() if math.isfinite(s.low)}
        if not skills:
            continue
        against = label(next(iter(skills.values())).against)
        above = [e for e, s in skills.items() if s.low > 0.0]
        below = [e for e, s in skills.items() if s.high < 0.0]
        level = [e for e in skills if e not in (*above, *below)]
        said = [f"Of the rows that cost nothing, {against} errs least in {ASKED[metric]}."]
        said += [_better(summary, above, len(skills), metric)]
        said += [_listed("No difference is found for", map(label, level))] if level else []
        said += [_listed("Worse", map(label, below))] if below else []
        yield " ".join(said)


def _better(summary: Summary, above: list[str], asked: int, metric: str) -> str:
    """How many err less than that row, and what the first of them and the proposed method are worth."""
    if not above:
        return f"By the paired 95 % interval none of {asked} others errs less."
    first = min(above, key=lambda e: summary.value(e, metric).mean)
    shown = [first, *([PROPOSED] if PROPOSED in above and first != PROPOSED else [])]
    worth = names_of(f"{label(e)} has a skill of {_skill_of(summary, e, metric)}" for e in shown)
    return f"By the paired 95 % interval {len(above)} of {asked} others err less: {worth}."


def _parameters(summary: Summary) -> Iterator[str]:
    """In which health parameters the reference and the proposed method have skill."""
    for estimator in (REFERENCE, PROPOSED):
        skills = {h: summary.skill(estimator, f"{h}_life_pct") for h in HEALTH}
        skills = {h: s for h, s in skills.items() if math.isfinite(s.low)}
        if not skills:
            continue
        above = [QUANTITIES[h][0] for h, s in skills.items() if s.low > 0.0]
        rest = [QUANTITIES[h][0] for h, s in skills.items() if s.low <= 0.0]
        said = f"{label(estimator)} has skill, by its interval, in {names_of(above) if above else 'no parameter'}"
        yield f"{said}, and none is shown in {names_of(rest)}." if rest and above else f"{said}."


def true_start(summary: Summary) -> Iterator[str]:
    """Does a row that knows each machine's true start lose to the reference? If not, too little changes."""
    value = summary.value(TRUE_START, LIFE)
    if math.isfinite(value.times_low):
        less = "It errs less than the reference: too little changes in these recordings."
        more = "It errs more than the reference, so health changes enough to be worth following."
        says = more if value.times_low > 1.0 else less if value.times_high < 1.0 else "No difference is found."
        yield (
            f"{label(TRUE_START)}, which nobody can have, errs {number(value.times)} times as much in health as the "
            f"reference (95 % interval {span(value.times_low, value.times_high, to=True)}). {says}"
        )


def _close(summary: Summary) -> Iterator[str]:
    """How near the proposed method is to the reference."""
    values = {m: summary.value(PROPOSED, m) for m in ASKED}
    values = {m: v for m, v in values.items() if math.isfinite(v.times_low)}
    if not values:
        return
    parts = [f"{ASKED[m]} {number(v.times)} ({span(v.times_low, v.times_high, to=True)})" for m, v in values.items()]
    yield f"{label(PROPOSED)} errs this many times as much as the reference (95 % interval): {'; '.join(parts)}."
    yield within_limit({ASKED[m]: v for m, v in values.items()})


def within_limit(values: Mapping[str, Value]) -> str:
    """Where the multiple of the reference's error is within TIMES_ALLOWED by its interval, beyond it, or open.

    Args:
        values: by what is estimated.
    """
    within = [says for says, v in values.items() if v.times_high <= TIMES_ALLOWED]
    beyond = [says for says, v in values.items() if v.times_low > TIMES_ALLOWED]
    open_ = [says for says in values if says not in (*within, *beyond)]
    times = f"{TIMES_ALLOWED:g} times as much"
    said = [f"It errs at most {times} as the reference in {names_of(within)}."] if within else []
    said += [f"It errs more than {times} in {names_of(beyond)}."] if beyond else []
    said += [f"Whether it errs more than {times} is open in {names_of(open_)}."] if open_ else []
    return " ".join(said)


def _passing(summary: Summary) -> Iterator[str]:
    """Who errs less than the reference by the paired interval: a reference that is passed is no bound."""
    if REFERENCE not in summary.estimators:
        return
    passed = {e: [ASKED[m] for m in ASKED if summary.value(e, m).times_high < 1.0] for e in _ranked(summary)}
    said = [f"{label(e)} errs less than it in {names_of(where)}" for e, where in passed.items() if where]
    if said:
        yield f"The reference is no bound: by the paired 95 % interval {names_of(said)}."
    else:
        yield "No ranked estimator errs less than the reference by its paired 95 % interval."


def _coverage(summary: Summary) -> Iterator[str]:
    """The lowest and highest coverage of the ten quantities, before and after calibration."""
    if PROPOSED not in summary.estimators:
        return
    for prefix, when in (("coverage", "as it reports them"), ("calibrated_coverage", "after calibration")):
        found = extremes(summary, PROPOSED, prefix)
        if found is None:
            continue
        (low, where_low), (high, where_high) = found
        right = CALIBRATED_PCT[0] <= low and high <= CALIBRATED_PCT[1]
        yield (
            f"The 95 % intervals of {label(PROPOSED)}, {when}, hold the truth {number(low)} % of the time at least "
            f"({where_low}) and {number(high)} % at most ({where_high}). All ten quantities between "
            f"{CALIBRATED_PCT[0]:g} and {CALIBRATED_PCT[1]:g} %: {'yes' if right else 'no'}."
        )


def _in_regimes(regimes: pd.DataFrame) -> Iterator[str]:
    """In how many pairs of quantity and regime the calibrated intervals of the proposed method are right."""
    if "calibrated_pct" not in regimes:
        return
    pairs = regimes[regimes["quantity"] != "mean"].dropna(subset="calibrated_pct")
    own, reference = (pairs[pairs["estimator"] == name] for name in (PROPOSED, REFERENCE))
    if own.empty:
        return
    wrong = (own["calibrated_high"] < CALIBRATED_PCT[0]) | (own["calibrated_low"] > CALIBRATED_PCT[1])
    found = sorted(own[["calibrated_pct", "quantity", "regime"]].itertuples(index=False, name=None))
    ends = [f"{number(pct)} % ({QUANTITIES[q][0]}, {r.replace('_', ' ')})" for pct, q, r in (found[0], found[-1])]
    beside = f"; the reference's does in {_right(reference)}" if len(reference) == len(own) else ""
    yield (
        f"By quantity and regime, its calibrated coverage goes from {ends[0]} to {ends[1]}. It lies between "
        f"{CALIBRATED_PCT[0]:g} and {CALIBRATED_PCT[1]:g} % in {_right(own)} of {len(own)} pairs{beside}. In "
        f"{int(wrong.sum())} of its pairs the interval over recordings lies wholly outside these bounds."
    )


def _right(pairs: pd.DataFrame) -> int:
    """In how many pairs the calibrated coverage is within CALIBRATED_PCT."""
    return int(pairs["calibrated_pct"].between(*CALIBRATED_PCT).sum())


def _with_interval(value: Value) -> str:
    text = f"{number(value.mean)} %"
    return f"{text} ({span(value.low, value.high, to=True)})" if math.isfinite(value.low) else text


def _skill_of(summary: Summary, estimator: str, metric: str) -> str:
    skill = summary.skill(estimator, metric)
    return f"{number(skill.value, 2)} ({span(skill.low, skill.high, to=True)})"


def _listed(says: str, texts: Iterable[str]) -> str:
    names = list(texts)
    return f"{says}: {names_of(names) if names else 'none'}."
