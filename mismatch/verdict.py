"""The verdict: what was found, how sure it is and what it is not, as data and in deterministic words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from twinbench.mismatch import telling
from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.errors import OutputError, output_errors
from twinbench.mismatch.findings import PHYSICS, SENSOR, UNEXPLAINED, Finding, findings
from twinbench.mismatch.locate import Located, locate
from twinbench.mismatch.mixture import Z90
from twinbench.mismatch.naming.answer import shares
from twinbench.mismatch.naming.decision import Claim, never_said
from twinbench.mismatch.sizes import Value, all_values, parameters
from twinbench.physics.simulator import Mechanism

CONSISTENT, PARAMETERS, INCOMPLETE = "consistent", "parameter change", "incomplete"
VERDICTS = (CONSISTENT, PARAMETERS, SENSOR, PHYSICS, INCOMPLETE, UNEXPLAINED)
"""All that ``verdict`` may say."""
VERDICT_VERSION = 1
"""Of the form of ``verdict.json``. It rises when a field goes, or changes its type or what it means. A new field leaves
it as it is."""
CHANGED_SD = 3.0
"""Posterior standard deviations that a parameter must have moved by to be called changed."""
CHANGED_SCALES = 0.5
"""And scales of the parameter."""


@dataclass(frozen=True)
class Verdict:
    """What ``diagnose`` says.

    Attributes:
        says, points: the verdict in one sentence, and what follows, one thing a point.
        parameters: of the simulator, with what all hypotheses together say of them.
        fit: errors per output, on what was held out and on what was learnt from.
        mechanisms: what the mended simulator has besides.
        values: of the mended simulator's parameters, by name; of the calibrated one's where nothing is mended.
        located: the force at the first finding's port.
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

    @property
    def not_asked(self) -> str:
        """Why effects in the balances could not be asked for; empty where they were."""
        return telling.not_asked(self.diagnosis)

    def to_dict(self) -> dict[str, Any]:
        """``verdict.json``, but for its provenance and what was noted of the recordings."""
        d = self.diagnosis
        return {
            "schema_version": VERDICT_VERSION,
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
            "noisy_inputs": [n._asdict() for n in d.noisy],
            "spikes": [
                {"recording": s.recording, "channel": s.channel, "time_s": s.time_s, "value": s.value} for s in d.spikes
            ],
            "weighed": [{"effects": sorted(names), "probability": p} for names, p in weighed(d).items()],
            "unnamed": [{"port": str(u.port), "nats": u.log, "size_pct": u.size_pct} for u in d.answer.left],
            "inexact": [{"port": str(u.port), "nats": u.log, "size_pct": u.size_pct} for u in telling.inexact(d)],
            "coloured": {
                **d.answer.coloured._asdict(),
                "channel": d.simulator.outputs[d.answer.coloured.channel].name,
            },
            "unfollowed": [u._asdict() for u in d.unfollowed],
            "held_out": {"recordings": [t.name for t in d.held], "worse": [w._asdict() for w in d.worse]},
            "self_check": asdict(d.self_check),
            "more_data": self.more_data,
            "not_asked": self.not_asked,
        }


def weighed(d: Diagnosis) -> dict[frozenset[str], float]:
    """Probability of each set of effects among all that were weighed, likeliest first; no effect at all is a set."""
    every = d.answer.naming.hypotheses
    found: dict[frozenset[str], float] = {}
    for h, p in zip(every, shares([h.log for h in every]), strict=True):
        names = frozenset(h.names)
        found[names] = max(found.get(names, 0.0), p)
    total = sum(found.values())
    return {names: p / total for names, p in found.items()}


def conclude(d: Diagnosis) -> Verdict:
    """Put a diagnosis into words."""
    found, told, errors, missing = findings(d), parameters(d), output_errors(d), telling.what_else(d)
    changed = [v for v in told if _changed(d, v)]
    verdict = _verdict(d, found, missing, bool(changed))
    effects = d.answer.chosen.effects if d.mended is not None else ()
    return Verdict(
        verdict=verdict,
        says=telling.headline(d, verdict, found, errors, missing),
        points=tuple(telling.points(d, found, changed, errors, missing)),
        findings=found,
        parameters=told,
        fit=errors,
        more_data=telling.more_data(d, found),
        mechanisms=(*(d.machine.candidates[e.variant.candidate].mechanism for e in effects), *d.rounded),
        values=_values(d),
        located=locate(d),
        diagnosis=d,
    )


def _verdict(d: Diagnosis, found: Sequence[Finding], missing: Sequence[str], changed: bool) -> str:
    unnamed = bool(missing) or any(not f.names for f in found)
    kinds = {f.kind for f in found if f.names} if any(claim.names for claim in d.claims) else set()
    if kinds:
        lacks = bool(missing) or any(_no_candidate(claim) for claim in d.claims)
        return INCOMPLETE if lacks else next(k for k in (PHYSICS, SENSOR, UNEXPLAINED) if k in kinds)
    if unnamed:
        return UNEXPLAINED
    if d.stuck or d.rounded:
        return SENSOR
    return PARAMETERS if changed else CONSISTENT


def _no_candidate(claim: Claim) -> bool:
    """Is something there that likelier than not is none of the candidates?"""
    if claim.names:
        return False
    return claim.probability > 0.5 or (claim.found is not None and never_said(claim.found.evidence))


def _values(d: Diagnosis) -> dict[str, float]:
    fit = d.mended or d.before
    found = {u.name: float(v) for u, v in zip(fit.problem.unknowns, fit.z, strict=True) if u.kind == "parameter"}
    found |= {v.name: v.nominal for fault in d.rounded for v in fault.parameters}
    if d.mended is not None:
        for place in range(len(d.answer.chosen.effects)):
            found |= all_values(d.answer.chosen, place)
    return found


def _changed(d: Diagnosis, value: Value) -> bool:
    v = d.simulator.parameters[d.simulator.index(value.name)]
    sd = (value.high - value.low) / (2 * Z90)
    return abs(value.value - v.nominal) > max(CHANGED_SD * sd, CHANGED_SCALES * v.scale)
