"""The verdict: what was found, how sure it is and what it is not, as data and in deterministic words."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twinbench.mismatch import evidence, findings, telling
from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.evidence import OutputError
from twinbench.mismatch.explanation import Explanation, residual_chi2
from twinbench.mismatch.findings import KINDS, UNNAMED, Z90, Finding, Value
from twinbench.mismatch.leftover import leftovers
from twinbench.mismatch.locate import Located, locate
from twinbench.mismatch.weigh import LEAST_SHARE
from twinbench.mismatch.words import listed, number, sentence
from twinbench.physics.simulator import Array, Mechanism

VERDICTS = ("consistent", "parameter change", "sensor fault", "missing physics", "incomplete", "unexplained")
"""All that ``verdict`` may say."""
CHANGED_SD = 3.0
"""Posterior standard deviations that a parameter must have moved by to be called changed."""
CHANGED_SCALES = 0.5
"""And scales of the parameter."""


@dataclass(frozen=True)
class Verdict:
    """What ``diagnose`` says.

    Attributes:
        says, points: the verdict in one sentence, and what follows, one thing a point.
        fit: errors per output, on what was held out and on what was learnt from.
        values: of the mended simulator's parameters, by name.
    """

    verdict: str
    says: str
    points: tuple[str, ...]
    findings: tuple[Finding, ...]
    parameters: tuple[Value, ...]
    fit: tuple[OutputError, ...]
    more_data: str
    mechanisms: tuple[Mechanism, ...]
    values: dict[str, float]
    located: Located | None
    diagnosis: Diagnosis

    def to_dict(self) -> dict[str, Any]:
        """``verdict.json``."""
        d = self.diagnosis
        return {
            "verdict": self.verdict,
            "says": self.says,
            "points": list(self.points),
            "findings": [f.to_dict() for f in self.findings],
            "parameters": {
                v.name: {"before": v.before, "after": v.value, "low": v.low, "high": v.high, "unit": v.unit}
                for v in self.parameters
            },
            "fit": [e._asdict() for e in self.fit],
            "inputs": d.joined._asdict(),
            "spikes": [
                {"recording": s.recording, "channel": s.channel, "time_s": s.time_s, "value": s.value} for s in d.spikes
            ],
            "weighed": [{"effects": sorted(names), "probability": p} for names, p in evidence.weights(d).items()],
            "unfollowed": [u._asdict() for u in d.unfollowed],
            "held_out": {"recordings": [t.name for t in d.held], "explanations_compared": d.weighed_on_held_out},
            "more_data": self.more_data,
        }


def conclude(d: Diagnosis) -> Verdict:
    """Put a diagnosis into words."""
    held = d.chosen or d.before
    parameters = _parameters(d, held)
    chi2, limit = residual_chi2(held)
    noisy = chi2 > limit
    left = leftovers(held, d.held_before if d.chosen is None else d.held_after, d.tracks, d.held, d.floor)
    located = locate(d) if (d.best is not None or noisy or left) else None
    effects = findings.named(d, located) if d.chosen is not None else _unnamed(d, located, left)
    found = (*findings.stuck(d), *effects)
    mechanisms: tuple[Mechanism, ...] = ()
    if d.chosen is not None:
        mechanisms = tuple(d.machine.candidates[v.candidate].mechanism for v in d.chosen.chosen)
    changed = [v for v in parameters if v.before is not None and _changed(d, v)]
    verdict = _verdict(d, found, left, bool(changed))
    errors = evidence.output_errors(d)
    why = _why_incomplete(d, left, noisy) if d.chosen is not None else []
    more = telling.more_data(d, found)
    points = (*telling.points(d, found, changed, errors, why), *([more] if more else []))
    return Verdict(
        verdict,
        telling.headline(d, verdict, found, errors, bool(why)),
        points,
        found,
        parameters,
        errors,
        more,
        mechanisms,
        _values(held),
        located,
        d,
    )


def _verdict(d: Diagnosis, found: tuple[Finding, ...], left: list[str], changed: bool) -> str:
    if d.chosen is not None:
        if d.transferred is not None and d.transferred.fails:
            return "incomplete"
        kinds = {*_kinds(d), *(f.kind for f in found if f.mechanism)} or {"unexplained"}
        return next(k for k in ("missing physics", "sensor fault", "unexplained") if k in kinds)
    if d.best is not None or left or d.unfollowed:
        return "unexplained"
    if d.stuck:
        return "sensor fault"
    return "parameter change" if changed else "consistent"


def _kinds(d: Diagnosis) -> set[str]:
    """What is wrong for sure, even where its name is not: all that cannot be told apart is of one kind."""
    assert d.chosen is not None
    kind_of = {c.name: KINDS.get(c.mechanism.kind, "sensor fault") for c in d.machine.candidates}
    kinds = [{kind_of[n] for n in (name, *r.names)} for name, r in zip(d.chosen.names, d.rivals, strict=True)]
    return {next(iter(k)) for k in kinds if len(k) == 1}


def _unnamed(d: Diagnosis, located: Located | None, left: list[str]) -> tuple[Finding, ...]:
    """What nothing that was looked for explains, if there is anything."""
    if d.best is not None:
        tried = f"{listed(d.best.names)} explains what was learnt from best, but is refused: {d.refused}"
        says = f"nothing that was looked for passes the proof; {tried}"
    elif left:
        says = f"{'; '.join(left)}, and nothing that was looked for explains it"
    elif d.unfollowed:
        says = f"nothing that was looked for explains {listed([u.channel for u in d.unfollowed])}"
    else:
        return ()
    ports = located.ports if located is not None else ()
    where = ports[0][0] if ports else None
    return (replace(UNNAMED, port=where, ports=ports, says=sentence(says)),)


def _why_incomplete(d: Diagnosis, left: list[str], noisy: bool) -> list[str]:
    """Why what was named is not all, if it is not."""
    why = left or (["the residual is still more than noise"] if noisy else [])
    if d.share is not None and d.there is not None and d.share.share < LEAST_SHARE:
        why = [
            *why,
            f"of what is added to the outputs, {number(d.there.ratio)} times as much is in the held-out readings (90 % "
            f"interval {number(d.there.low)} to {number(d.there.high)}), but the rest of their error is something else",
        ]
    if d.transferred is not None and d.transferred.fails:
        why = [
            *why,
            "the recordings held back want other sizes than those learnt (chi-square "
            f"{number(d.transferred.chi2)} of {d.transferred.sizes}), so something else is missing too",
        ]
    return why


def _values(explanation: Explanation) -> dict[str, float]:
    machine = explanation.problem.machine
    found = {
        u.name: float(v)
        for u, v in zip(explanation.problem.unknowns, explanation.z, strict=True)
        if u.kind == "parameter"
    }
    at = explanation.first
    for variant in explanation.chosen:
        for v in machine.candidates[variant.candidate].mechanism.parameters:
            found[v.name] = float(explanation.z[at])
            at += 1
    return found


def _parameters(d: Diagnosis, held: Explanation) -> tuple[Value, ...]:
    spread: Array = Z90 * np.sqrt(np.diag(findings.uncertainty(held)))
    out = []
    for u, z, s in zip(held.problem.unknowns, held.z, spread, strict=True):
        if u.kind == "parameter":
            v = d.simulator.parameters[u.at]
            out.append(Value(v.name, float(z), float(z - s), float(z + s), v.unit, v.nominal, v.says))
    return tuple(out)


def _changed(d: Diagnosis, value: Value) -> bool:
    v = d.simulator.parameters[d.simulator.index(value.name)]
    sd = (value.high - value.low) / (2 * Z90)
    return abs(value.value - v.nominal) > max(CHANGED_SD * sd, CHANGED_SCALES * v.scale)
