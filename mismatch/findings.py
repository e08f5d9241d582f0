"""What is wrong, one by one: its name, its size with an interval, where and since when, and what else it could be."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from twinbench.mismatch.began import Onset, begins, told_onsets
from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.history.history import History
from twinbench.mismatch.history.patterns import CONSTANT
from twinbench.mismatch.history.saying import says as history_says
from twinbench.mismatch.naming.answer import Unnamed
from twinbench.mismatch.naming.decision import Claim, astray
from twinbench.mismatch.regime import regime
from twinbench.mismatch.sizes import Value, force, formula, sizes
from twinbench.mismatch.stuck import STANDS_STILL
from twinbench.mismatch.words import SELDOM, listed, number, probable, sentence, with_unit
from twinbench.physics.simulator import Port, Simulator

PHYSICS, SENSOR, UNEXPLAINED = "missing physics", "sensor fault", "unexplained"
"""Kinds of findings: of the machine, of a sensor or an input, and what has no name or one of either kind."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong. Fields as in ``verdict.json``.

    Attributes:
        mechanism: its name, the likeliest where several fit; None where none does.
        best: what explains it best, where it has no name; empty if nothing does.
        stand_in: that, where the mended simulator has it in its place.
        indistinguishable_from: the other names that it may have.
        alike: do these do the same in these recordings?
        probability: that what is said is right, of an unexplained finding that none of the names is; None of what was
            not weighed.
        weights: probability of each name in its place, likeliest first.
        since_s: when it began, on the recordings' clock; None where it began in none of them.
        onsets: where it is, recording by recording, if not everywhere.
        force: its size as a force, where the port is a balance of forces.
        history: its size over time, or of what explains it best; None where nothing does.
    """

    kind: str
    says: str
    mechanism: str | None = None
    best: str = ""
    stand_in: str = ""
    term: str = ""
    probability: float | None = None
    indistinguishable_from: tuple[str, ...] = ()
    alike: bool = False
    weights: Mapping[str, float] = field(default_factory=dict)
    port: Port | None = None
    ports: tuple[tuple[Port, float], ...] = ()
    since_s: float | None = None
    onsets: tuple[Onset, ...] = ()
    intervals_s: tuple[tuple[float, float], ...] = ()
    regime: str = ""
    parameters: tuple[Value, ...] = ()
    force: Value | None = None
    history: History | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """All names that it may have, likeliest first."""
        return (self.mechanism, *self.indistinguishable_from) if self.mechanism is not None else ()

    def to_dict(self) -> dict[str, Any]:
        """Its part of ``verdict.json``."""
        return {
            **asdict(replace(self, history=None)),
            "port": str(self.port or ""),
            "ports": [{"port": str(port), "probability": p} for port, p in self.ports],
            "onsets": [o._asdict() for o in self.onsets],
            "parameters": {v.name: v.plain for v in self.parameters},
            "force": self.force.plain if self.force else None,
            "history": self.history.plain if self.history else None,
        }


def findings(d: Diagnosis) -> tuple[Finding, ...]:
    """Sensors that stand still or move in steps, then what the claims say.

    Something unnamed at a port where a finding has no name either is the same thing.
    """
    unnamed = {claim.port for claim in d.claims if claim.found and not claim.names}
    told = [claim for claim in d.claims if claim.found or claim.port not in unnamed]
    return (*_stuck(d), *_rounded(d), *(_claimed(d, claim) if claim.found else _beside(d, claim) for claim in told))


def _stuck(d: Diagnosis) -> Iterator[Finding]:
    """Sensors that stand still, one finding per channel."""
    for c in sorted({s.channel for s in d.stuck}):
        v, stretches = d.simulator.outputs[c], [s for s in d.stuck if s.channel == c]
        name, port = f"{STANDS_STILL}{v.name}", Port("output", v.name)
        where = listed(
            [
                f"at {with_unit(s.value, v.unit)} from {s.since_s:.0f} to {s.until_s:.0f} s of {s.recording}, while "
                f"the simulator says that it moved by {with_unit(s.moved, v.unit)}"
                for s in stretches
            ]
        )
        says = f"the sensor of {v.name} stands still ({name}, at {port}): {where}; its readings there were set aside"
        times = tuple((s.since_s, s.until_s) for s in stretches)
        yield Finding(
            SENSOR, sentence(says), name, port=port, ports=((port, 1.0),), since_s=times[0][0], intervals_s=times
        )


def _rounded(d: Diagnosis) -> Iterator[Finding]:
    """Sensors that move in steps."""
    for fault in d.rounded:
        step = fault.parameters[0]
        says = f"the sensor of {fault.port.variable} moves in steps of {with_unit(step.nominal, step.unit)}"
        says += f" ({fault.name}, at {fault.port}), far beyond chance"
        yield Finding(SENSOR, sentence(says), fault.name, port=fault.port, ports=((fault.port, 1.0),))


def _claimed(d: Diagnosis, claim: Claim) -> Finding:
    """What a claim says of an effect of the chosen hypothesis."""
    assert claim.found is not None
    kind_of = {c.name: PHYSICS if c.mechanism.kind == "physics" else SENSOR for c in d.machine.candidates}
    # Names that are one thing are of the likeliest's kind.
    kinds = {kind_of[name] for name in (claim.names[:1] if claim.alike else claim.names)}
    since_s = d.answer.chosen.since_s
    until_s = max(float(t.time_s[-1]) for t in d.tracks)
    found = Finding(
        kind=kinds.pop() if len(kinds) == 1 else UNEXPLAINED,
        says="",
        probability=claim.probability,
        alike=claim.alike and len(claim.names) > 1,
        weights={name: p for name, p in claim.found.weights.items() if p > SELDOM},
        port=claim.port,
        ports=_told(claim),
        since_s=since_s if np.isfinite(since_s) else None,
        onsets=told_onsets(since_s, d.tracks),
        intervals_s=((since_s, until_s),) if np.isfinite(since_s) else (),
    )
    history, known = d.histories[claim.found.place], variable_names(d.simulator)
    if not claim.names:
        told = [_unnamed_says(d, claim, found.onsets)]
        if history.likeliest != CONSTANT:
            told.append(sentence(f"if it is {claim.found.name}, {history_says(history)}", known))
        found = replace(found, says=" ".join(told), best=claim.found.name, history=history)
        if claim.found.name not in d.stand_ins:
            return found
    mechanism = d.machine.candidates[claim.found.effect.variant.candidate].mechanism
    values = sizes(d, claim.found.place)
    if not claim.names:
        return replace(found, stand_in=claim.found.name, term=formula(mechanism, values), parameters=values)
    found = replace(
        found,
        mechanism=claim.names[0],
        indistinguishable_from=claim.names[1:],
        term=formula(mechanism, values),
        regime=regime(d),
        parameters=values,
        force=force(d, claim.found.place),
        history=history,
    )
    return replace(found, says=_says(d, found, claim))


def _beside(d: Diagnosis, claim: Claim) -> Finding:
    """Something that nothing in the catalogue explains, beside what is named or alone."""
    says = _unnamed_says(d, claim)
    return Finding(UNEXPLAINED, says, probability=claim.probability, port=claim.port, ports=_told(claim))


def _told(claim: Claim) -> tuple[tuple[Port, float], ...]:
    """The ports of a claim that are worth telling."""
    return tuple((port, p) for port, p in claim.ports if p > SELDOM)


def _unnamed_says(d: Diagnosis, claim: Claim, onsets: tuple[Onset, ...] = ()) -> str:
    """Something at a port: how large, if that was weighed, and what was refused, if anything."""
    beside = "something else" if claim.found is None and d.named else "something"
    says = acts_at(str(claim.port), beside)
    if claim.found is None:
        (here,) = (u for u in d.answer.left if u.port == claim.port)
        return sentence(f"{says}: {unnamed_size(here)}")
    since = f" {sentence(begins(onsets))}" if onsets else ""
    if d.refused:
        refused = f"{claim.found.name} explains what was learnt from best, but is refused: {d.refused}"
        says = sentence(f"{says}: {refused}") + since
    else:
        none = none_of_them(d, claim.found.name)
        right = f"but {none}" if none else f"and is right with probability {probable(1.0 - claim.probability)}"
        says = sentence(f"{says}: {claim.found.name} explains it best, {right}") + since
    if claim.found.name in d.stand_ins:
        says += f" Until more is known {claim.found.name} stands in for it in the mended model."
    return says


def acts_at(where: str, what: str = "something") -> str:
    """That something has no name, and where it acts."""
    return f"{what} that these recordings cannot name acts at {where}"


def none_of_them(d: Diagnosis, name: str) -> str:
    """Why an effect that explains something best is no name for it, whatever its probability; empty if nothing is."""
    if astray(d.answer, 1.0):
        return "the simulator is so far off, and so much is left, that other sets may explain as much"
    again = [share for f, share in zip(d.answer.found, d.self_check.again, strict=True) if f.name == name]
    if any(astray(d.answer, share) for share in again):
        return "the simulator is so far off that sets without it are likelier in most halves of the recordings"
    found = [c.found for c in d.claims if c.found is not None and c.found.name == name]
    if any(f.evidence["lingers"] for f in found):
        return "the residual still swings with its period, so it acts elsewhere, or in another way"
    if any(f.evidence["echo"] for f in found):
        return "several effects of one channel or period stand in for one cause, which is none of them"
    return ""


def unnamed_size(u: Unnamed) -> str:
    """How large something unnamed is, in words."""
    return f"about {number(u.size_pct, 2)} % of what commonly acts there"


def _says(d: Diagnosis, found: Finding, claim: Claim) -> str:
    said, known = [], variable_names(d.simulator)
    by_name = {c.name: c.mechanism for c in d.machine.candidates}
    each = [f"{by_name[name].says} ({name}, at {by_name[name].port})" for name in found.names]
    assert claim.found is not None
    if len(each) == 1:
        said.append(each[0])
    elif found.alike:
        said.append(f"{' or '.join(each)}, which do the same in these recordings")
    else:
        said.append(
            f"one of {listed([f'{name} (probability {probable(claim.found.weights[name])})' for name in found.names])}"
        )
    if len(each) > 1:
        said.append(f"the model is mended with {claim.found.name}: {by_name[claim.found.name].says}")
    first, *others = found.parameters
    # One size that holds at all times is not what the course says.
    alone = ", if it were constant" if found.history and found.history.likeliest != CONSTANT else ""
    told = [f"{first.says or first.name}{alone}: {first.words('90 % interval ')}"]
    told += [f"{found.force.says}: {found.force.words()}"] if found.force else []
    told += [f"{v.says or v.name}: {v.words()}" for v in others]
    said.append("; ".join(told))
    if found.onsets:
        said.append(begins(found.onsets))
    if found.history:
        said.append(history_says(found.history))
    if found.regime:
        said.append(f"it acts mostly where {found.regime}")
    said.append(f"the probability that this is right is {probable(found.probability)}")
    return " ".join(sentence(text, known) for text in said)


def variable_names(simulator: Simulator) -> set[str]:
    """What must not be given a capital."""
    return {v.name for v in (*simulator.states, *simulator.inputs, *simulator.outputs, *simulator.parameters)}
