"""A verdict's tables: sizes, parameters, fit, rivals, tests, explanations, and all that was looked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.evidence import OutputError
from twinbench.mismatch.findings import Finding, Value
from twinbench.mismatch.picture import typical
from twinbench.mismatch.report.ranking import ranking
from twinbench.mismatch.telling import smallest_seen
from twinbench.mismatch.verdict import Verdict
from twinbench.mismatch.words import digits_worth, interval, number, spoken, typeset, with_unit

SIGNIFICANT = 0.05
LEAST_P = 1e-6
"""Smaller ones would claim more than the tests can know."""


class Listing(NamedTuple):
    """A table for the page.

    Attributes:
        words: heads whose columns hold words rather than numbers.
        rows: texts, as many as heads.
        without: what to say where there is no row.
    """

    name: str
    title: str
    heads: tuple[str, ...]
    words: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    without: str = ""


def build_listings(verdict: Verdict) -> list[Listing]:
    """All tables below the findings, in the order of the page."""
    d = verdict.diagnosis
    return [_errors(verdict.fit), _parameters(verdict), _rivals(d), _tests(d), _explanations(d), _looked_for(d)]


def sizes(finding: Finding) -> Listing:
    """What a finding's parameters came out as, and its size as a force."""
    values = (*finding.parameters, *([finding.force] if finding.force else []))
    rows = tuple((v.name, v.says, *_texts(v), spoken(v.unit)) for v in values)
    heads = ("parameter", "what it is", "value", "90 % interval", "unit")
    return Listing("sizes", "", heads, ("what it is", "unit"), rows)


def _texts(v: Value) -> tuple[str, str]:
    """A value and its interval, with as many digits as the interval is worth."""
    digits = digits_worth(v.value, v.low, v.high)
    return number(v.value, digits), interval(v.low, v.high, digits)


def _errors(errors: Sequence[OutputError]) -> Listing:
    rows = tuple(
        (
            e.channel,
            "held out" if e.held_out else "learnt from",
            number(e.rmse_before),
            number(e.rmse_after),
            "–" if e.rmse_after == e.rmse_before else interval(e.change_low, e.change_high),
            number(e.noise_sd),
            spoken(e.unit),
        )
        for e in sorted(errors, key=lambda e: not e.held_out)
    )
    return Listing(
        "errors",
        "Error of each output",
        ("output", "recordings", "before", "after", "change, 90 % interval", "sensor's scatter", "unit"),
        ("recordings", "unit"),
        rows,
        (
            "Error: root mean square of measured minus simulated, open loop, reading by reading.",
            "Before: the simulator with its own parameters fitted. After: with what was found added. So the change is "
            "what was found, not what was merely set wrong.",
            "Sensor's scatter: its noise from reading to reading. Slow noise does not show in that, so all its noise "
            "is this or more.",
        ),
        "No output was measured.",
    )


def _parameters(verdict: Verdict) -> Listing:
    known = {v.name: v.says for v in verdict.diagnosis.simulator.parameters}
    rows = tuple(
        (
            v.name,
            known.get(v.name, ""),
            number(v.before if v.before is not None else float("nan")),
            *_texts(v),
            spoken(v.unit),
        )
        for v in verdict.parameters
    )
    return Listing(
        "parameters",
        "Parameters of the simulator",
        ("parameter", "what it is", "as it came", "now", "90 % interval", "unit"),
        ("what it is", "unit"),
        rows,
        (),
        "The simulator has no parameters to calibrate.",
    )


def _rivals(d: Diagnosis) -> Listing:
    best = d.chosen
    ranked = {frozenset(e.names): e for e in ranking(d)}
    rows = []
    if best is not None:
        own = ranked[frozenset(best.names)].gain
        for name, others in zip(best.names, d.rivals, strict=True):
            for other in others.names:
                instead = ranked.get(frozenset(best.names) - {name} | {other})
                rows.append((name, other, number(own - instead.gain) if instead else "–", number(own)))
    return Listing(
        "rivals",
        "What these recordings cannot tell apart",
        ("found", "could as well be", "which gains less by", "out of"),
        ("could as well be",),
        tuple(rows),
        (),
        "Nothing: no other candidate explains the recordings nearly as well." if best else "Nothing was named.",
    )


def _tests(d: Diagnosis) -> Listing:
    failed = sorted((t for t in d.tests if t.p < SIGNIFICANT), key=lambda t: t.p)
    rows = tuple(
        (
            t.recording,
            t.channel,
            typeset(t.says),
            number(t.statistic),
            number(t.p, 1) if t.p >= LEAST_P else f"below {number(LEAST_P, 1)}",
        )
        for t in failed
    )
    return Listing(
        "tests",
        "Residual tests of the calibrated simulator that failed",
        ("recording", "channel", "what is wrong", "statistic", "p"),
        ("channel", "what is wrong"),
        rows,
        (f"p after Holm's correction over all {len(d.tests)} tests; shown below {SIGNIFICANT}.",),
        f"None of {len(d.tests)}: what calibration leaves is noise to these tests.",
    )


def _explanations(d: Diagnosis) -> Listing:
    rows = tuple(
        (" + ".join(e.names), str(len(e.names)), number(e.gain, 4), number(e.needed), e.standing) for e in ranking(d)
    )
    return Listing(
        "explanations-fitted",
        "Explanations fitted in full",
        ("explanation", "effects", "gain", "required gain", "standing"),
        ("standing",),
        rows,
        (
            "Gain: over the calibrated simulator, twice the log-likelihood. Required gain: what noise alone can reach "
            "with as many effects.",
        ),
        "None: no candidate promised enough.",
    )


def _looked_for(d: Diagnosis) -> Listing:
    candidates = {c.name: c for c in d.machine.candidates}
    rows = []
    for name, size in smallest_seen(d):
        c = candidates[name]
        v = c.mechanism.parameters[0]
        seen = size * abs(typical(c))
        beyond = seen > max(abs(v.low - c.null[0]), abs(v.high - c.null[0]))
        rows.append(
            (
                name,
                c.mechanism.says,
                str(c.mechanism.port),
                with_unit(seen, v.unit) if not beyond else "hidden",
                number(size) if not beyond else "–",
            )
        )
    return Listing(
        "looked-for",
        "All that was looked for, and the least of it that would have been seen",
        ("mechanism", "what it is", "port", "least size seen", "in typical sizes"),
        ("what it is", "port"),
        tuple(rows),
        (
            "Least size: what would have passed the threshold in these recordings, alone. Above 1 an effect of typical "
            "size stays hidden in them; hidden: so does the largest that is possible.",
        ),
        "The catalogue was empty.",
    )
