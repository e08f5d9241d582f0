"""What is wrong, one by one: its name, its size with an interval, where and since when, and what else it could be."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from twinbench.mismatch import evidence
from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.evidence import Onset
from twinbench.mismatch.explanation import Explanation, residual_chi2
from twinbench.mismatch.force import as_force, inertia
from twinbench.mismatch.locate import Located, regime
from twinbench.mismatch.words import digits_worth, interval, listed, number, sentence, spoken, with_unit
from twinbench.physics.simulator import Array, Mechanism, Port, Simulator, Term

Z90 = 1.645
KINDS = {"physics": "missing physics"}
SURE, NEARLY_SURE = 0.9, 0.99
"""Probability from which a name counts as sure, and above which probabilities are not told apart: the weights are not
known so well."""
LARGEST_SET = 3
"""Things that a set may hold names for and still say something."""


@dataclass(frozen=True)
class Value:
    """A number with its 90 % interval; ``before`` for what a parameter was, ``says`` for what it is."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    before: float | None = None
    says: str = ""

    def words(self, of: str = "") -> str:
        """How large it is and, after what the interval is ``of``, how sure that is."""
        digits = digits_worth(self.value, self.low, self.high)
        return f"{with_unit(self.value, self.unit, digits)} ({of}{interval(self.low, self.high, digits)})"


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong. Fields as in ``verdict.json``.

    Attributes:
        mechanism: its name; None where nothing, or too much, would fit.
        probability: of the name, over everything that was fitted; None where it was weighed against nothing.
        indistinguishable_from: other names that a set of few holds.
        candidates: all names that cannot be told apart, its own first.
        since_s: when it began, on the recordings' clock; None where it began in none of them.
        onsets: where it is, recording by recording, if not everywhere.
        force: its size as a force, where the port is a balance of forces.
    """

    kind: str
    mechanism: str | None
    term: str
    probability: float | None
    indistinguishable_from: tuple[str, ...]
    candidates: tuple[str, ...]
    port: Port | None
    ports: tuple[tuple[Port, float], ...]
    since_s: float | None
    onsets: tuple[Onset, ...]
    intervals_s: tuple[tuple[float, float], ...]
    regime: str
    parameters: tuple[Value, ...]
    force: Value | None
    says: str

    @property
    def is_sure(self) -> bool:
        """Is it a single name that everything else that was fitted leaves probable?"""
        return len(self.candidates) == 1 and self.probability is not None and self.probability >= SURE

    def to_dict(self) -> dict[str, Any]:
        """Its part of ``verdict.json``."""
        return {
            **asdict(self),
            "port": str(self.port or ""),
            "ports": [{"port": str(port), "probability": p} for port, p in self.ports],
            "onsets": [o._asdict() for o in self.onsets],
            "parameters": {v.name: plain(v) for v in self.parameters},
            "force": plain(self.force) if self.force else None,
        }


UNNAMED = Finding(
    kind="unexplained",
    mechanism=None,
    term="",
    probability=None,
    indistinguishable_from=(),
    candidates=(),
    port=None,
    ports=(),
    since_s=None,
    onsets=(),
    intervals_s=(),
    regime="",
    parameters=(),
    force=None,
    says="",
)
"""What is wrong and has no name."""


def plain(value: Value) -> dict[str, Any]:
    """A value as JSON has it."""
    return {"value": value.value, "low": value.low, "high": value.high, "unit": value.unit}


def stuck(d: Diagnosis) -> Iterator[Finding]:
    """Sensors that stand still, one finding per channel."""
    for c in sorted({s.channel for s in d.stuck}):
        v, stretches = d.simulator.outputs[c], [s for s in d.stuck if s.channel == c]
        name, port = f"sensor_stuck@{v.name}", Port("output", v.name)
        where = listed(
            [
                f"at {with_unit(s.value, v.unit)} from {s.since_s:.0f} to {s.until_s:.0f} s of {s.recording}, while "
                f"the simulator says that it moved by {with_unit(s.moved, v.unit)}"
                for s in stretches
            ]
        )
        says = f"the sensor of {v.name} stands still ({name}, at {port}): {where}; its readings there were set aside"
        times = tuple((s.since_s, s.until_s) for s in stretches)
        yield replace(
            UNNAMED,
            kind="sensor fault",
            mechanism=name,
            candidates=(name,),
            port=port,
            ports=((port, 1.0),),
            since_s=times[0][0],
            intervals_s=times,
            says=sentence(says),
        )


def named(d: Diagnosis, located: Located | None) -> Iterator[Finding]:
    """The effects of the accepted explanation."""
    assert d.chosen is not None
    ports = located.ports if located is not None else ()
    covariance = uncertainty(d.chosen)
    at, where = d.chosen.first, regime(d)
    onsets, weights = evidence.onsets(d), evidence.probabilities(d)
    began = [o.since_s for o in onsets if o.since_s is not None]
    since_s = min(began) if began else None
    until_s = max(float(t.time_s[-1]) for t in d.tracks)
    for variant in d.chosen.chosen:
        candidate = d.machine.candidates[variant.candidate]
        mechanism, n = candidate.mechanism, len(candidate.at)
        values = _values(mechanism, d.chosen.z[at : at + n], covariance[at : at + n, at : at + n])
        groups = evidence.candidates_for(d, mechanism.name)
        names = tuple(name for group in groups for name in group)
        single = len(groups) <= LARGEST_SET
        found = Finding(
            kind=KINDS.get(mechanism.kind, "sensor fault"),
            mechanism=mechanism.name if single else None,
            term=formula(mechanism, values),
            probability=weights[mechanism.name] if single else None,
            indistinguishable_from=names[1:] if single else (),
            candidates=names,
            port=mechanism.port,
            ports=ports,
            since_s=since_s,
            onsets=onsets,
            intervals_s=() if since_s is None else ((since_s, until_s),),
            regime=where,
            parameters=values,
            force=_force(d, mechanism, at, covariance),
            says="",
        )
        yield replace(found, says=_says(d.simulator, mechanism, found))
        at += n


def _says(simulator: Simulator, mechanism: Mechanism, found: Finding) -> str:
    said, known, names = [], variable_names(simulator), found.candidates
    if found.mechanism is not None:
        said.append(f"{mechanism.says} ({mechanism.name}, at {mechanism.port})")
    else:
        said += [
            f"something acts at {mechanism.port}, and these recordings cannot tell which of {len(names)} candidates it "
            f"is: {listed(names)}",
            f"the model is mended with {mechanism.name}: {mechanism.says}",
        ]
    first, *others = found.parameters
    sizes = [f"{first.says or first.name} {first.words('90 % interval ')}"]
    sizes += [f"{found.force.says}: {found.force.words()}"] if found.force else []
    sizes += [f"{v.says or v.name} {v.words()}" for v in others]
    said.append("; ".join(sizes))
    if found.onsets:
        said.append(begins(found.onsets))
    if found.regime:
        said.append(f"it acts mostly where {found.regime}")
    if found.mechanism is not None:
        if len(names) > 1:
            said.append(f"these recordings cannot tell it from {listed(names[1:])}")
        said.append(f"its probability among all that was fitted is {probable(found.probability)}")
    return " ".join(sentence(text, known) for text in said)


def probable(weight: float | None) -> str:
    """A probability as it is told."""
    if weight is None:
        return "not known, for nothing else was fitted in its place"
    return number(weight, 2) if weight <= NEARLY_SURE else f"above {number(NEARLY_SURE)}"


def variable_names(simulator: Simulator) -> set[str]:
    """What must not be given a capital."""
    return {v.name for v in (*simulator.states, *simulator.inputs, *simulator.outputs, *simulator.parameters)}


def begins(onsets: tuple[Onset, ...]) -> str:
    """In which recordings an effect is, and from when on."""
    words = {"throughout": "all through {0}", "not": "not in {0}", "from": "in {0} from {1:.0f} s on"}
    ordered = sorted(onsets, key=lambda o: o.there == "not")
    return "it is there " + listed([words[o.there].format(o.recording, o.since_s or 0.0) for o in ordered])


def formula(mechanism: Mechanism, values: tuple[Value, ...]) -> str:
    """The term with its fitted values."""
    filled = {v.name: with_unit(v.value, v.unit) for v in values}
    return re.sub(r"\{(\w+)\}", lambda m: filled.get(m[1], m[0]), mechanism.formula)


def _values(mechanism: Mechanism, z: Array, covariance: Array) -> tuple[Value, ...]:
    spread = Z90 * np.sqrt(np.diag(covariance))
    return tuple(
        Value(v.name, float(x), float(x - s), float(x + s), v.unit, says=v.says)
        for v, x, s in zip(mechanism.parameters, z, spread, strict=True)
    )


def _force(d: Diagnosis, mechanism: Mechanism, at: int, covariance: Array) -> Value | None:
    """A size at a balance of forces or heat, times the inertia or capacity as fitted; they are uncertain together."""
    if not isinstance(mechanism, Term) or mechanism.port.place != "balance":
        return None
    assert d.chosen is not None
    simulator: Simulator = d.simulator
    state = mechanism.port.index(simulator)
    of, size = inertia(simulator, state), mechanism.parameters[0]
    unit = as_force(size.unit, simulator, state, of) if of else None
    if of is None or unit is None:
        return None
    x, sd, mass = float(d.chosen.z[at]), float(np.sqrt(covariance[at, at])), of.parameter.nominal
    variance = (mass * sd) ** 2
    for k, u in enumerate(d.chosen.problem.unknowns):
        if u.kind == "parameter" and u.at == of.at:
            mass = float(d.chosen.z[k])
            variance = (mass * sd) ** 2 + x**2 * covariance[k, k] + 2.0 * mass * x * covariance[k, at]
    value, spread = unit[0] * mass * x, Z90 * unit[0] * float(np.sqrt(max(variance, 0.0)))
    says = f"as a {of.word}, with {of.parameter.name} at {number(mass)} {spoken(of.parameter.unit)}"
    return Value(f"{size.name} as a {of.word}", value, value - spread, value + spread, unit[1], says=says)


def uncertainty(explanation: Explanation) -> Array:
    """Posterior covariance (K, K) of the unknowns, widened where the residual is more than noise."""
    problem, z = explanation.problem, explanation.z
    G, _, _ = problem.normal(z, problem.residuals(z))
    chi2, _ = residual_chi2(explanation)
    # Each unknown in its own scale: their units differ by ten decades.
    scale = 1.0 / np.sqrt(np.maximum(np.diag(G), 1e-300))
    covariance = np.linalg.pinv(G * np.outer(scale, scale), hermitian=True, rcond=1e-12)
    return np.asarray(np.outer(scale, scale) * covariance * max(1.0, chi2))
