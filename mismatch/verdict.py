"""The verdict: what was found, how sure it is and what it is not, as data and in deterministic words."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mismatch.evidence import probabilities
from mismatch.explanation import Explanation
from mismatch.leftover import leftovers
from mismatch.locate import Located, locate, regime
from mismatch.onset import first_onset
from mismatch.proof import piece_squares
from mismatch.walk import Diagnosis, residual_chi2
from mismatch.weigh import LEAST_SHARE
from physics.simulator import Array, Mechanism

Z90 = 1.645
MOVED = 3.0
"""Posterior standard deviations that a parameter must have moved by to be called changed."""
PLAIN = 0.5
"""And scales of the parameter."""
KINDS = {"physics": "missing physics"}
LARGEST_SET = 3
"""Things that a set may hold names for and still say something."""


@dataclass(frozen=True)
class Value:
    """A number with its 90 % interval; ``before`` for what a parameter was."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    before: float | None = None


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong. Fields as in ``verdict.json``."""

    kind: str
    mechanism: str | None
    term: str
    probability: float | None
    indistinguishable_from: tuple[str, ...]
    port: str
    ports: tuple[tuple[str, float], ...]
    since_s: float | None
    intervals_s: tuple[tuple[float, float], ...]
    regime: str
    parameters: tuple[Value, ...]
    says: str


@dataclass(frozen=True)
class Fit:
    """One channel's error, model before and after; ``reduction`` with its 90 % interval, as a share."""

    channel: str
    unit: str
    held_out: bool
    rmse_before: float
    rmse_after: float
    noise_floor: float
    reduction_low: float
    reduction_high: float


@dataclass(frozen=True)
class Verdict:
    """What ``diagnose`` says. ``values`` are the mended simulator's, by parameter name."""

    verdict: str
    says: str
    findings: tuple[Finding, ...]
    parameters: tuple[Value, ...]
    fit: tuple[Fit, ...]
    more_data: str
    mechanisms: tuple[Mechanism, ...]
    values: dict[str, float]
    located: Located | None
    diagnosis: Diagnosis

    def to_dict(self) -> dict[str, Any]:
        """``verdict.json``."""
        return {
            "verdict": self.verdict,
            "says": self.says,
            "findings": [
                {
                    **asdict(f),
                    "ports": [{"port": port, "probability": p} for port, p in f.ports],
                    "parameters": {v.name: _plain(v) for v in f.parameters},
                }
                for f in self.findings
            ],
            "parameters": {
                v.name: {"before": v.before, "after": v.value, "low": v.low, "high": v.high, "unit": v.unit}
                for v in self.parameters
            },
            "fit": [asdict(f) for f in self.fit],
            "more_data": self.more_data,
        }


def conclude(d: Diagnosis) -> Verdict:
    """Put a diagnosis into words."""
    held = d.chosen or d.before
    sd = standard_deviations(held)
    parameters = _parameters(d, held, sd)
    chi2, limit = residual_chi2(held)
    left = leftovers(held, d.held_before if d.chosen is None else d.held_after, d.tracks, d.floor)
    located = locate(d) if (d.best is not None or chi2 > limit or left) else None
    findings = (*_stuck(d), *_findings(d, sd, located, left))
    mechanisms: tuple[Mechanism, ...] = ()
    if d.chosen is not None:
        mechanisms = tuple(d.machine.candidates[v.candidate].mechanism for v in d.chosen.chosen)
    changed = [v for v in parameters if v.before is not None and _changed(d, v)]
    if not mechanisms and d.unfollowed:
        verdict: str = "unexplained"
    elif mechanisms:
        kinds = {*_kinds(d), *(f.kind for f in findings if f.mechanism)} or {"unexplained"}
        verdict = next(k for k in ("missing physics", "sensor fault", "unexplained") if k in kinds)
        if d.transferred is not None and d.transferred.fails:
            verdict = "incomplete"
    elif d.best is not None or left:
        verdict = "unexplained"
    elif d.stuck:
        verdict = "sensor fault"
    else:
        verdict = "parameter change" if changed else "consistent"
    fit = _fits(d)
    return Verdict(
        verdict, _words(d, verdict, findings, changed, fit, chi2 > limit, left), findings, parameters, fit,
        _more_data(d, findings), mechanisms, _values(held), located, d,
    )  # fmt: skip


def _kinds(d: Diagnosis) -> set[str]:
    """What is wrong for sure, even where its name is not: all that cannot be told apart is of one kind."""
    assert d.chosen is not None
    kind_of = {c.name: KINDS.get(c.mechanism.kind, "sensor fault") for c in d.machine.candidates}
    kinds = [{kind_of[n] for n in (name, *r.names)} for name, r in zip(d.chosen.names, d.rivals, strict=True)]
    return {next(iter(k)) for k in kinds if len(k) == 1}


def standard_deviations(explanation: Explanation) -> Array:
    """Posterior standard deviations (K,) of the unknowns, widened where the residual is more than noise."""
    problem, z = explanation.problem, explanation.z
    G, _, _ = problem.normal(z, problem.residuals(z))
    chi2, _ = residual_chi2(explanation)
    # Each unknown in its own scale: their units differ by ten decades.
    scale = 1.0 / np.sqrt(np.maximum(np.diag(G), 1e-300))
    covariance = np.linalg.pinv(G * np.outer(scale, scale), hermitian=True, rcond=1e-12)
    return scale * np.sqrt(np.maximum(np.diag(covariance), 0.0) * max(1.0, chi2))


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


def _parameters(d: Diagnosis, held: Explanation, sd: Array) -> tuple[Value, ...]:
    out = []
    for u, z, s in zip(held.problem.unknowns, held.z, sd, strict=True):
        if u.kind == "parameter":
            v = d.simulator.parameters[u.at]
            out.append(Value(v.name, float(z), float(z - Z90 * s), float(z + Z90 * s), v.unit, v.nominal))
    return tuple(out)


def _changed(d: Diagnosis, value: Value) -> bool:
    v = d.simulator.parameters[d.simulator.index(value.name)]
    sd = (value.high - value.low) / (2 * Z90)
    return abs(value.value - v.nominal) > max(MOVED * sd, PLAIN * v.scale)


def _stuck(d: Diagnosis) -> list[Finding]:
    """Sensors that stand still, one finding per channel."""
    found = []
    for c in sorted({s.channel for s in d.stuck}):
        v, stretches = d.simulator.outputs[c], [s for s in d.stuck if s.channel == c]
        name, port = f"sensor_stuck@{v.name}", f"output:{v.name}"
        where = ", ".join(
            f"at {_with_unit(s.value, v.unit)} from {s.since_s:.0f} to {s.until_s:.0f} s of {s.recording}, while the "
            f"simulator says that it moved by {_with_unit(s.moved, v.unit)}"
            for s in stretches
        )
        says = f"the sensor of {v.name} stands still ({name}, at {port}): {where}; its readings there were set aside"
        times = tuple((s.since_s, s.until_s) for s in stretches)
        found.append(Finding("sensor fault", name, "", 1.0, (), port, ((port, 1.0),), times[0][0], times, "", (), says))
    return found


def _findings(d: Diagnosis, sd: Array, located: Located | None, left: list[str]) -> tuple[Finding, ...]:
    ports = located.ports if located is not None else ()
    if d.chosen is None:
        if d.best is not None:
            names = ", ".join(d.best.names)
            says = f"something is missing that the catalogue does not hold: {names} explains it best, but {d.refused}"
        elif left:
            says = f"{'; '.join(left)}, and nothing in the catalogue explains it"
        elif d.unfollowed:
            channels = ", ".join(f.channel for f in d.unfollowed)
            says = f"the simulator explains nothing of what {channels} does, and nothing in the catalogue does"
        else:
            return ()
        where = ports[0][0] if ports else ""
        return (Finding("unexplained", None, "", 0.0, (), where, ports, None, (), "", (), says),)
    found = []
    machine = d.machine
    at = d.chosen.first
    since = first_onset(d.chosen.problem.since)
    weighed = probabilities(d)
    where = regime(d)
    for variant, (rivals, things, _) in zip(d.chosen.chosen, d.rivals, strict=True):
        candidate = machine.candidates[variant.candidate]
        values = []
        for v in candidate.mechanism.parameters:
            z, s = float(d.chosen.z[at]), float(sd[at])
            values.append(Value(v.name, z, z - Z90 * s, z + Z90 * s, v.unit))
            at += 1
        mechanism = candidate.mechanism
        probability = weighed[mechanism.name]
        kind = KINDS.get(mechanism.kind, "sensor fault")
        term = _formula(mechanism, values)
        size = values[0]
        words = [
            f"{mechanism.says} ({mechanism.name}, at {mechanism.port}): "
            f"{_with_unit(size.value, size.unit)} (90 % interval {_number(size.low)} to {_number(size.high)})"
        ]
        if since is not None:
            words.append(f"since about {since:.0f} s")
        if where:
            words.append(f"mostly where {where}")
        named: str | None = mechanism.name
        if things > LARGEST_SET:
            # A set of many is no name: what is said is where it is.
            count = len(rivals) + 1
            words.insert(0, f"something acts at {mechanism.port}; {count} candidates cannot be told apart here")
            named, probability = None, 0.0
        elif rivals:
            words.append(f"these recordings cannot tell it from {', '.join(rivals)}")
        found.append(
            Finding(
                kind, named, term, probability, tuple(rivals) if named else (), mechanism.port, ports, since,
                () if since is None else ((since, max(float(t.time_s[-1]) for t in d.tracks)),), where, tuple(values),
                "; ".join(words),
            )
        )  # fmt: skip
    return tuple(found)


def _formula(mechanism: Mechanism, values: list[Value]) -> str:
    filled = {v.name: _with_unit(v.value, v.unit) for v in values}
    return re.sub(r"\{(\w+)\}", lambda m: filled.get(m[1], m[0]), mechanism.formula)


def _fits(d: Diagnosis) -> tuple[Fit, ...]:
    """Errors sample by sample; the noise floor is what the accepted model leaves of the recordings it was fitted to."""
    after = d.chosen or d.before
    n = range(len(d.tracks))
    fitted = [np.sqrt(np.mean([e.problem.squares(r, e.z) for r in n], axis=0)) for e in (d.before, after)]
    rows = [(False, *fitted, d.before.problem.residuals(d.before.z), after.problem.residuals(after.z))]
    if d.held_before is not None:
        held = d.held_after if d.chosen is not None and d.held_after is not None else d.held_before
        rows.append((True, d.held_before.rmse, held.rmse, d.held_before.residuals, held.residuals))
    rng = np.random.default_rng(0)
    out = []
    for is_held, rmse_before, rmse_after, before, later in rows:
        for c, v in enumerate(d.simulator.outputs):
            b, a = (piece_squares(residuals, c) for residuals in (before, later))
            if not len(b):
                continue
            picks = rng.integers(0, len(b), (500, len(b)))
            # The share of the samples' error, spread as the blocks' is.
            share = 1.0 - np.sqrt(a[picks].mean(axis=1) / b[picks].mean(axis=1))
            share += (1.0 - rmse_after[c] / rmse_before[c]) - (1.0 - np.sqrt(a.mean() / b.mean()))
            low, high = np.quantile(share, (0.05, 0.95))
            values = (rmse_before[c], rmse_after[c], fitted[1][c], low, high)
            out.append(Fit(v.name, v.unit, is_held, *map(float, values)))
    return tuple(out)


def smallest_seen(d: Diagnosis) -> list[tuple[str, float]]:
    """The least size of each candidate that would have passed the threshold, in its typical sizes."""
    best: dict[str, float] = {}
    for i, variant in enumerate(d.shown.variants):
        name = d.machine.candidates[variant.candidate].name
        size = float(np.sqrt(d.threshold / max(d.shown.G[i, i], 1e-12)))
        best[name] = min(best.get(name, np.inf), size)
    return sorted(best.items(), key=lambda item: item[1])


def _words(
    d: Diagnosis, verdict: str, findings: tuple[Finding, ...], changed: list[Value], fit: tuple[Fit, ...],
    noisy: bool, left: list[str],
) -> str:  # fmt: skip
    words = []
    if verdict == "consistent":
        words.append("The simulator agrees with the recordings: no candidate explains more than noise would.")
    elif verdict == "parameter change":
        words.append("The simulator agrees with the recordings once its parameters are right: no physics is missing.")
    else:
        words += [_sentence(f.says) for f in findings]
    if changed:
        moved = ", ".join(f"{v.name} from {_number(v.before or 0.0)} to {_with_unit(v.value, v.unit)}" for v in changed)
        words.append(f"Parameters moved: {moved}.")
    if d.chosen is not None:
        gained = d.before.cost - d.chosen.cost
        sensors = [
            e for e in d.tried
            if all(d.machine.candidates[v.candidate].mechanism.kind != "physics" for v in e.chosen) and e.names
        ]  # fmt: skip
        if sensors and verdict == "missing physics":
            best = max(d.before.cost - e.cost for e in sensors)
            share = 100.0 * max(best, 0.0) / gained
            much = f"{share:.0f} %" if share >= 1.5 else "no more than 1 %"
            words.append(f"The best sensor or input fault alone explains {much} of it.")
        if d.share is not None:
            words.append(f"On recordings held back it removes {d.share.says}.")
            if d.there is not None and d.share.share < LEAST_SHARE:
                words.append(
                    f"What it adds to the outputs is in them ({d.there.ratio:.2f} of it, 90 % interval "
                    f"{d.there.low:.2f} to {d.there.high:.2f}); the rest is something else."
                )
        if left or noisy:
            why = "; ".join(left) or "the residual is still more than noise"
            words.append(f"It is incomplete: {why}.")
        if d.transferred is not None and d.transferred.fails:
            words.append(
                "It is incomplete: the recordings held back want other sizes than those learnt "
                f"(chi-square {d.transferred.chi2:.0f} of {d.transferred.sizes}), so something else is missing too."
            )
    if not findings:
        seen = smallest_seen(d)
        hidden = [name for name, size in seen if size > 1.0]
        plain = len(seen) - len(hidden)
        words.append(f"Of {len(seen)} candidates, {plain} would have been seen at their typical size.")
        if hidden:
            words.append(f"Not so {', '.join(hidden[:6])}{' and others' if len(hidden) > 6 else ''}.")
    for f in fit:
        if f.held_out:
            before = f"{_number(f.rmse_before)} to " if f.rmse_after != f.rmse_before else ""
            words.append(
                f"{f.channel}, held out: error {before}{_with_unit(f.rmse_after, f.unit)}, "
                f"where it learnt {_number(f.noise_floor)}."
            )
    return " ".join(words)


def _more_data(d: Diagnosis, findings: tuple[Finding, ...]) -> str:
    sets = [f for f in findings if f.indistinguishable_from]
    if sets:
        f = sets[0]
        return (
            f"To tell {f.mechanism} from {f.indistinguishable_from[0]}, record where their effects differ: "
            "wider and faster changes of the inputs than in these recordings, and both directions of motion or flow."
        )
    if not findings:
        hidden = [name for name, size in smallest_seen(d) if size > 1.0]
        if hidden:
            return f"To see {hidden[0]} at its typical size, move the inputs more, or record longer."
    return ""


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:].rstrip(".") + "."


def _number(value: float) -> str:
    return f"{value:.3g}"


def _with_unit(value: float, unit: str) -> str:
    return f"{_number(value)} {unit}" if unit not in ("", "1", "-") else _number(value)


def _plain(value: Value) -> dict[str, Any]:
    return {"value": value.value, "low": value.low, "high": value.high, "unit": value.unit}
