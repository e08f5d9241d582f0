"""A verdict's tables: sizes, parameters, fit, names, tests, hypotheses, and all that was looked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.errors import OutputError
from twinbench.mismatch.findings import Finding
from twinbench.mismatch.report.hypotheses import hypotheses
from twinbench.mismatch.sizes import Value
from twinbench.mismatch.verdict import Verdict
from twinbench.mismatch.words import digits_worth, interval, number, probable, spoken, typeset, with_unit

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
    return [
        _errors(verdict.fit),
        _parameters(verdict),
        _names(verdict.findings),
        _unnamed(d),
        _tests(d),
        _hypotheses(d),
        _looked_for(d),
    ]


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


def _names(findings: Sequence[Finding]) -> Listing:
    rows = tuple(
        (f.mechanism or f"something at {f.port}", name, probable(p), "yes" if f.alike and name in f.names else "")
        for f in findings
        for name, p in f.weights.items()
    )
    return Listing(
        "names",
        "What each finding may be",
        ("finding", "name", "probability", "one thing with it"),
        ("name", "one thing with it"),
        rows,
        (
            "Probability: among all names that were weighed in its place. One thing with it: no recording of these "
            "channels can tell the two.",
        ),
        "Nothing was named.",
    )


def _unnamed(d: Diagnosis) -> Listing:
    rows = tuple((str(u.port), number(u.log), number(u.size_pct, 2)) for u in d.answer.left)
    return Listing(
        "unnamed",
        "Something else at each port",
        ("port", "evidence", "size, %"),
        (),
        rows,
        (
            "Evidence: nats for something beside what was chosen that the catalogue has no name for; below zero it is "
            "less likely than not. Size: per cent of what commonly acts there.",
        ),
        "The simulator has no port where something could act.",
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


def _hypotheses(d: Diagnosis) -> Listing:
    rows = tuple((" + ".join(h.names), number(h.gain), probable(h.probability), h.standing) for h in hypotheses(d))
    return Listing(
        "hypotheses",
        "Hypotheses weighed",
        ("hypothesis", "evidence", "probability", "standing"),
        ("standing",),
        rows,
        (
            "Evidence: nats over nothing, with sizes, parameters and what no catalogue holds integrated out. "
            "Probability: among these.",
        ),
    )


def _looked_for(d: Diagnosis) -> Listing:
    known = {p.name: p for p in d.self_check.power}
    rows = []
    for c in sorted(d.machine.candidates, key=lambda c: c.name):
        p = known.get(c.name)
        if p is None:
            least, shows = "–", "–"
        elif p.size_90 is None or p.shows_90 is None:
            least, shows = "hidden", "–"
        else:
            least, shows = with_unit(p.size_90, p.unit, 2), number(p.shows_90, 2)
        rows.append((c.name, c.mechanism.says, str(c.mechanism.port), least, shows))
    return Listing(
        "looked-for",
        "All that was looked for, and how much of it would have been named",
        ("mechanism", "what it is", "port", "named from", "in noise sds"),
        ("what it is", "port"),
        tuple(rows),
        (
            "Named from: the size from which on it would have been named in these recordings with probability 0.9; "
            "hidden: at no size that it may have. A dash: it is in what was chosen, or another form of that. In noise "
            "sds: how strongly it shows in the readings there, root mean square.",
        ),
        "The catalogue was empty.",
    )
