"""A verdict's tables: sizes, parameters, fit, rivals, tests, explanations, and all that was looked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bench.ranking import ranking
from bench.table_formats import number
from mismatch.picture import typical
from mismatch.verdict import Finding, Fit, Value, Verdict, smallest_seen
from mismatch.walk import Diagnosis

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
    return [_fit(verdict.fit), _parameters(verdict), _rivals(d), _tests(d), _explanations(d), _looked_for(d)]


def sizes(finding: Finding) -> Listing:
    """What a finding's parameters came out as."""
    rows = tuple((v.name, *_texts(v), v.unit) for v in finding.parameters)
    return Listing("sizes", "", ("parameter", "value", "90 % interval", "unit"), ("unit",), rows)


def _texts(v: Value) -> tuple[str, str]:
    """A value and its interval, with as many digits as the interval is worth."""
    width, largest = v.high - v.low, max(abs(v.low), abs(v.high), abs(v.value))
    digits = 3
    if np.isfinite(width) and 0.0 < width < largest:
        digits = min(max(3, int(np.ceil(np.log10(largest / width))) + 2), 6)
    return _number(v.value, digits), f"{_number(v.low, digits)} to {_number(v.high, digits)}"


def _number(value: float, digits: int = 3) -> str:
    """Plain, unless it would be mostly zeros."""
    return f"{value:.{digits}g}" if 0.0 < abs(value) < 1e-3 else number(value, digits)


def _fit(fits: Sequence[Fit]) -> Listing:
    rows = tuple(
        (
            f.channel, "held out" if f.held_out else "learnt from", _number(f.rmse_before), _number(f.rmse_after),
            _number(f.noise_floor), f.unit, _reduction(f),
        )
        for f in sorted(fits, key=lambda f: not f.held_out)
    )  # fmt: skip
    return Listing(
        "fit", "Fit per channel",
        ("channel", "recordings", "error before", "error after", "where it learnt", "unit",
         "error reduced by, 90 % interval"),
        ("recordings", "unit"), rows,
        ("Error: root mean square of measured minus simulated, open loop. Before: the calibrated simulator, so the "
         "reduction is what was found, not the parameters. Where it learnt: the error after there, "
         "which is the sensor's noise if nothing is missing any more.",),
        "No output was measured.",
    )  # fmt: skip


def _reduction(f: Fit) -> str:
    if f.rmse_after == f.rmse_before:
        return "–"
    return f"{100.0 * f.reduction_low:.0f} % to {100.0 * f.reduction_high:.0f} %"


def _parameters(verdict: Verdict) -> Listing:
    known = {v.name: v.says for v in verdict.diagnosis.simulator.parameters}
    rows = tuple(
        (v.name, known.get(v.name, ""), _number(np.nan if v.before is None else v.before), *_texts(v), v.unit)
        for v in verdict.parameters
    )  # fmt: skip
    return Listing(
        "parameters", "Parameters of the simulator",
        ("parameter", "what it is", "as it came", "now", "90 % interval", "unit"), ("what it is", "unit"), rows,
        (), "The simulator has no parameters to calibrate.",
    )  # fmt: skip


def _rivals(d: Diagnosis) -> Listing:
    best = d.chosen
    ranked = {frozenset(e.names): e for e in ranking(d)}
    rows = []
    if best is not None:
        own = ranked[frozenset(best.names)].gain
        for name, others in zip(best.names, d.rivals, strict=True):
            for other in others.names:
                instead = ranked.get(frozenset(best.names) - {name} | {other})
                rows.append((name, other, _number(own - instead.gain) if instead else "–", _number(own)))
    return Listing(
        "rivals", "What these recordings cannot tell apart",
        ("found", "could as well be", "which gains less by", "out of"), ("could as well be",), tuple(rows), (),
        "Nothing: no other candidate explains the recordings nearly as well." if best else "Nothing was named.",
    )  # fmt: skip


def _tests(d: Diagnosis) -> Listing:
    failed = sorted((t for t in d.tests if t.p < SIGNIFICANT), key=lambda t: t.p)
    rows = tuple(
        (t.recording, t.channel, t.says, _number(t.statistic), f"{t.p:.1g}" if t.p >= LEAST_P else f"below {LEAST_P:g}")
        for t in failed
    )
    return Listing(
        "tests", "Residual tests of the calibrated simulator that failed",
        ("recording", "channel", "what is wrong", "statistic", "p"), ("channel", "what is wrong"), rows,
        (f"p after Holm's correction over all {len(d.tests)} tests; shown below {SIGNIFICANT}.",),
        f"None of {len(d.tests)}: what calibration leaves is noise to these tests.",
    )  # fmt: skip


def _explanations(d: Diagnosis) -> Listing:
    rows = tuple(
        (" + ".join(e.names), str(len(e.names)), _number(e.gain, 4), _number(e.needed), e.standing) for e in ranking(d)
    )
    return Listing(
        "explanations-fitted", "Explanations fitted in full",
        ("explanation", "effects", "gain", "had to gain", "standing"), ("standing",), rows,
        ("Gain: over the calibrated simulator, twice the log-likelihood. Had to gain: what noise alone could with as "
         "many effects.",),
        "None: no candidate promised enough.",
    )  # fmt: skip


def _looked_for(d: Diagnosis) -> Listing:
    candidates = {c.name: c for c in d.machine.candidates}
    rows = []
    for name, size in smallest_seen(d):
        c = candidates[name]
        v = c.mechanism.parameters[0]
        seen = size * abs(typical(c))
        beyond = seen > max(abs(v.low - c.null[0]), abs(v.high - c.null[0]))
        rows.append((
            name, c.mechanism.says, c.mechanism.port, f"{_number(seen)} {v.unit}".strip() if not beyond else "hidden",
            _number(size) if not beyond else "–",
        ))  # fmt: skip
    return Listing(
        "looked-for", "All that was looked for, and the least of it that would have been seen",
        ("mechanism", "what it is", "port", "least size seen", "in typical sizes"), ("what it is", "port"), tuple(rows),
        ("Least size: what would have passed the threshold in these recordings, alone. Above 1 an effect of typical "
         "size stays hidden in them; hidden: so does the largest that is possible.",),
        "The catalogue was empty.",
    )  # fmt: skip
