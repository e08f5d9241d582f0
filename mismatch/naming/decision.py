"""What is said of each finding: a name, a set of names, or a place alone, by a rule that was learnt.

Cases with known truth are free, so the rule is learnt from many of them (``proof.learning``): a logistic regression on
what speaks for a finding gives the probability that the right name is among those weighed. That times the name's share
of the evidence of all sets that were weighed is the probability that it is right. A name is said from the probability
on at which the promised rate of wrong names was kept on machines that were left out.
"""

from __future__ import annotations

import functools
import json
import math
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from scipy.special import expit

from twinbench.mismatch.naming.answer import Answer, Found, Unnamed, shares
from twinbench.physics.simulator import Port

RULE = Path(__file__).with_name("decision.json")
"""The learnt weights, with where they come from."""
CREDIBLE = 0.95
"""Probability with which the names of a set should hold the right one."""
LARGEST_SET = 3
"""Names, those alike counted once, that a set may hold and still say something; beyond, the place is said."""
FEATURES = (
    "against_nothing", "against_unnamed", "little_beside", "little_wandering", "sds", "one_size", "one_form", "fits",
    "foretells_more",
)  # fmt: skip
"""What speaks for a finding, whichever its name; each the more, the larger. How many effects there are, of what kind
and since when is left out on purpose: it foretells a little more on the cases drawn, and would be wrong where other
machines are."""
AGAIN = 0.5
"""Share of the halves of the recordings in which the likeliest set must hold a finding, where the simulator was far
off. Strong effects may be in all of them although a weak one beside them comes and goes. Of the ten findings on the two
leaking chambers it is 0.5 once and 1 otherwise, so up to that share nothing changes there."""
MOST_NATS = 1000.0
"""Nats beyond which more of them say no more."""
SLIGHTLY = 0.1
"""Misfit, in noise variances, and sds below which less says little more."""


@dataclass(frozen=True)
class Rule:
    """A learnt rule.

    Attributes:
        weights: by feature, and "constant".
        say_name, say_set: least probability with which a name is said, and a set.
    """

    weights: Mapping[str, float]
    say_name: float
    say_set: float


@dataclass(frozen=True)
class Claim:
    """One thing that a verdict says is there.

    Attributes:
        names: one is a name; several are what these recordings cannot tell apart, likeliest first; none is something
            unnamed.
        alike: do the names do the same in these recordings?
        probability: that this claim is right.
        ports: where it acts, with the probability of each, likeliest first.
        found: the finding that it is made of; None if nothing of the catalogue explains it.
    """

    names: tuple[str, ...]
    alike: bool
    probability: float
    ports: tuple[tuple[Port, float], ...]
    found: Found | None

    @property
    def port(self) -> Port:
        """The likeliest port."""
        return self.ports[0][0]


@functools.cache
def learnt_rule() -> Rule:
    """The rule that was learnt last."""
    read = json.loads(RULE.read_text())
    return Rule(read["weights"], float(read["say_name"]), float(read["say_set"]))


def never_said(evidence: Mapping[str, float]) -> bool:
    """Is it plainly none of the names that it could have, whatever its probability?"""
    return bool(evidence["echo"] or evidence["lingers"])


def features(evidence: Mapping[str, float]) -> dict[str, float]:
    """What speaks for a finding (the evidence of a ``Found``), on scales on which it counts evenly."""
    found = {
        "against_nothing": _nats(evidence["against_nothing"]),
        "against_unnamed": _nats(evidence["against_unnamed"]),
        "little_beside": -math.log1p(evidence["beside"]),
        "little_wandering": -math.log1p(evidence["wandering"]),
        "sds": math.log(evidence["sds"] + SLIGHTLY),
        "one_size": _nats(min(evidence["one_size"], 0.0)),
        "one_form": _nats(min(evidence["one_form"], 0.0)),
        "fits": -math.log(evidence["misfit"] + SLIGHTLY),
        "foretells_more": _nats(evidence["held_gain"]),
    }
    return {name: found[name] for name in FEATURES}


def _nats(value: float) -> float:
    value = min(max(value, -MOST_NATS), MOST_NATS)
    return math.copysign(math.log1p(abs(value) / 3.0), value)


def probability(weights: Mapping[str, float], values: Mapping[str, float]) -> float:
    """Of a logistic regression."""
    return float(expit(weights["constant"] + sum(weights[name] * v for name, v in values.items())))


def decided(answer: Answer, again: Sequence[float], rule: Rule | None = None) -> tuple[Claim, ...]:
    """What is said of an answer; nothing where nothing is missing.

    Args:
        again: for each finding, share of the halves of the recordings in which it is in the likeliest set.
        rule: the learnt one if left out.
    """
    rule = rule or learnt_rule()
    silent = replace(rule, say_name=math.inf, say_set=math.inf)
    machine = answer.chosen.problem.machine
    port_of = {c.name: c.mechanism.port for c in machine.candidates}
    contains = {c.name: c.mechanism.contains for c in machine.candidates}
    claims = [
        _claim(found, port_of, silent if astray(answer, share) else rule, contains)
        for found, share in zip(answer.found, again, strict=True)
    ]
    if answer.more:
        claims.append(Claim((), False, float(expit(answer.left[0].log)), _likeliest(_where(answer.left)), None))
    return tuple(claims)


def astray(answer: Answer, again: float) -> bool:
    """Is the simulator far off, and still not all explained, or a finding absent in most halves of the recordings?

    Then many sets fit about as well, and what is in the likeliest is no name.

    Args:
        again: share of the halves in which the finding is in the likeliest set.
    """
    return answer.naming.far and (answer.more or again < AGAIN)


def _claim(found: Found, port_of: Mapping[str, Port], rule: Rule, contains: Mapping[str, str]) -> Claim:
    among = probability(rule.weights, features(found.evidence))
    right = among * found.marginal(found.alike)
    named: dict[Port, float] = defaultdict(float)
    for name, weight in found.weights.items():
        named[port_of[name]] += weight
    # It is where one of the names acts, or something unnamed in its place.
    unnamed = _where(found.unnamed)
    either = {p: among * named.get(p, 0.0) + (1.0 - among) * unnamed.get(p, 0.0) for p in {*named, *unnamed}}
    nameless = Claim((), False, 1.0 - right, _likeliest(either), found)
    if never_said(found.evidence):
        return nameless
    ports = _likeliest(named)
    if right >= rule.say_name:
        # What contains an effect can become it, and is no other thing.
        others = [n for n in found.alike if contains[n] != found.name]
        names = (found.name, *sorted(set(others) - {found.name}, key=lambda n: -found.weights[n]))
        return Claim(names, len(names) > 1, right, ports, found)
    names = found.credible(CREDIBLE)
    holds = among * found.marginal(names)
    if holds >= rule.say_set and is_set(names, found.alike):
        return Claim(names, set(names) <= found.alike, holds, ports, found)
    return nameless


def _where(unnamed: Sequence[Unnamed]) -> dict[Port, float]:
    """Probability of each port, if something unnamed is at one of them."""
    return dict(zip((u.port for u in unnamed), shares([u.log for u in unnamed]), strict=True))


def _likeliest(ports: Mapping[Port, float]) -> tuple[tuple[Port, float], ...]:
    return tuple(sorted(((port, min(1.0, p)) for port, p in ports.items()), key=lambda item: -item[1]))


def is_set(names: Collection[str], alike: Collection[str]) -> bool:
    """Are these several things, those alike counted once, and few enough to say something?"""
    things = len(set(names) - set(alike)) + (not set(alike).isdisjoint(names))
    return 1 < things <= LARGEST_SET
