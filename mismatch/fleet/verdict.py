"""What a fleet's recordings say: effects that all machines share, and machines that have something of their own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinbench.mismatch.fleet.asking import Said
from twinbench.mismatch.fleet.pooled import Pooled, Shared, pooled
from twinbench.mismatch.naming.answer import shares
from twinbench.mismatch.naming.decision import features, learnt_rule, probability
from twinbench.mismatch.words import count, digits_worth, interval, listed, number, probable, sentence, with_unit

CONSISTENT, NAMED, UNNAMED = "consistent", "named", "unnamed"
FLEET_VERSION = 1
"""Of the form of ``fleet.json``. It rises as that of ``verdict.json`` does."""
ADDED_UP = ("against_nothing", "against_unnamed", "one_size", "one_form", "held_gain")
"""What speaks for an effect in nats."""
UNKNOWN = 0.5
"""Probability that the right name is among those weighed, where no machine's findings say."""
TOLD = 0.1
"""Probability from which an effect of an odd machine is told."""
LIKELIER = 0.5
"""Probability from which something is told though it is not sure enough to be given a name."""


@dataclass(frozen=True)
class Common:
    """An effect that all machines share.

    Attributes:
        alike: names that do the same on these machines, beside its own.
        probability: that it is there, by this name or by one of these.
        named: is that enough for a name?
        size: of it over the fleet.
    """

    name: str
    alike: tuple[str, ...]
    probability: float
    named: bool
    size: Shared
    unit: str

    @property
    def called(self) -> str:
        """Its name, and those that do the same."""
        return " or ".join((self.name, *self.alike))


@dataclass(frozen=True)
class Odd:
    """A machine that is not as the others.

    Attributes:
        probability: of that, whatever the name of what it has.
        effects: what it has, lacks or has in another size than the others, likeliest first; with the probability that
            each is there by this name.
        port: where something without a name acts; empty where effects say more.
        named: is the likeliest of these effects sure enough for a name?
    """

    machine: str
    probability: float
    effects: tuple[tuple[str, float], ...]
    port: str = ""
    named: bool = False


@dataclass(frozen=True)
class Fleet:
    """The verdict on a fleet.

    Attributes:
        odd: machines that are, the surest first; ``perhaps`` those that likelier than not are, but not surely.
        odds: by machine, probability that it is.
    """

    verdict: str
    says: str
    points: tuple[str, ...]
    common: tuple[Common, ...]
    odd: tuple[Odd, ...]
    perhaps: tuple[Odd, ...]
    odds: Mapping[str, float]
    machines: Mapping[str, Said]

    def to_dict(self) -> dict[str, Any]:
        """``fleet.json``, but for its provenance."""
        return {
            "schema_version": FLEET_VERSION,
            "verdict": self.verdict,
            "says": self.says,
            "points": list(self.points),
            "shared": [
                {
                    "mechanism": c.name,
                    "indistinguishable_from": list(c.alike),
                    "probability": c.probability,
                    "named": c.named,
                    "mean": {"value": c.size.mean, "low": c.size.low, "high": c.size.high, "unit": c.unit},
                    "scatter_sd": c.size.scatter,
                }
                for c in self.common
            ],
            "odd": [_odd(o, True) for o in self.odd] + [_odd(o, False) for o in self.perhaps],
            "machines": {
                name: {"verdict": said.document["verdict"], "says": said.document["says"], "odd": self.odds[name]}
                for name, said in self.machines.items()
            },
        }


def _odd(o: Odd, sure: bool) -> dict[str, Any]:
    effects = [{"mechanism": name, "probability": p} for name, p in o.effects]
    about = {"machine": o.machine, "probability": o.probability, "sure": sure}
    return {**about, "effects": effects, "named": o.named, "port": o.port}


def conclude(machines: Mapping[str, Said]) -> Fleet:
    """Weigh what all machines say together, and put it into words."""
    weighed = pooled({name: said.known for name, said in machines.items()}, next(iter(machines.values())).candidates)
    p, rule = shares([w.log for w in weighed]), learnt_rule()
    likely = weighed[0]
    common = [_common(name, size, machines, weighed, p) for name, size in likely.shared.items()]
    common = sorted((c for c in common if c.probability > LIKELIER), key=lambda c: -c.probability)
    several = [_judged(said, weighed, p, machines) for said in machines.values()]
    odd = sorted((o for o in several if o.probability >= rule.say_set), key=lambda o: -o.probability)
    perhaps = sorted((o for o in several if LIKELIER < o.probability < rule.say_set), key=lambda o: -o.probability)
    named = any(c.named for c in common) or any(o.named for o in odd)
    verdict = NAMED if named else UNNAMED if common or odd or perhaps else CONSISTENT
    return Fleet(
        verdict,
        sentence(_headline(machines, common, odd)),
        tuple(map(sentence, _points(machines, common, odd, perhaps))),
        tuple(common),
        tuple(odd),
        tuple(perhaps),
        {o.machine: o.probability for o in several},
        machines,
    )


def _common(
    name: str, size: Shared, machines: Mapping[str, Said], weighed: Sequence[Pooled], p: Sequence[float]
) -> Common:
    """A shared effect; names that do the same on most machines which speak of it count as one."""
    said = [one.alike[name] for one in machines.values() if name in one.alike]
    counts = Counter(other for names in said for other in names if other != name)
    alike = tuple(sorted(other for other, count in counts.items() if 2 * count > len(said)))
    there = sum(q for q, w in zip(p, weighed, strict=True) if not w.names.isdisjoint({name, *alike}))
    right = min(1.0, there) * _among(machines.values(), name)
    unit = next(one.units[name] for one in machines.values() if name in one.units)
    return Common(name, alike, right, right >= learnt_rule().say_name, size, unit)


def _among(machines: Iterable[Said], name: str) -> float:
    """Probability that the right name is among those weighed, by all that speaks for it on machines that found it.

    Nats of several machines add up, as those of several recordings do.
    """
    said = [one.speaks[name] for one in machines if name in one.speaks]
    if not said:
        return UNKNOWN
    together = {key: sum(one[key] for one in said) for key in ADDED_UP}
    together["sds"] = float(np.sqrt(sum(one["sds"] ** 2 for one in said)))
    together |= {key: float(np.median([one[key] for one in said])) for key in ("beside", "wandering", "misfit")}
    return probability(learnt_rule().weights, features(together))


def _judged(said: Said, weighed: Sequence[Pooled], p: Sequence[float], machines: Mapping[str, Said]) -> Odd:
    """How odd a machine is: by effects of its own, or by something without a name that most others do not have.

    It is unlike the others also where its effect has another name than those that were weighed, or none. So only the
    names are discounted for that.
    """
    effects: dict[str, float] = {}
    odd = min(1.0, sum(q * w.odd[said.name] for q, w in zip(p, weighed, strict=True)))
    for q, w in zip(p, weighed, strict=True):
        for name, part in w.own[said.name].items():
            effects[name] = effects.get(name, 0.0) + q * part
    told = {
        name: min(1.0, part) * _among((said,) if name in said.speaks else machines.values(), name)
        for name, part in effects.items()
    }
    ordered = sorted(told.items(), key=lambda pair: -pair[1])
    named = bool(ordered) and ordered[0][1] >= learnt_rule().say_name
    likely = tuple((name, part) for name, part in ordered if part > TOLD)
    beside, port = said.beside
    usual = np.mean([one.beside[0] > LIKELIER for one in machines.values()])
    if beside > odd and usual < 0.5:
        return Odd(said.name, beside, likely, port)
    return Odd(said.name, odd, likely, "", named)


def _headline(machines: Mapping[str, Said], common: Sequence[Common], odd: Sequence[Odd]) -> str:
    n = len(machines)
    named = [c.called for c in common if c.named]
    unsure = [c.called for c in common if not c.named]
    lead = f"all {count(n)} machines have in common what the simulator lacks: {listed(named)}" if named else ""
    if not named and unsure:
        lead = f"all {count(n)} machines perhaps have in common what the simulator lacks: {listed(unsure)}"
    if not lead:
        lead = f"nothing is missing in all {count(n)} machines alike"
    if odd:
        which = listed([o.machine for o in odd])
        return f"{lead}; {which} {'has' if len(odd) == 1 else 'have'} something that the others have not"
    return f"{lead}; no machine is unlike the others"


def _points(
    machines: Mapping[str, Said], common: Sequence[Common], odd: Sequence[Odd], perhaps: Sequence[Odd]
) -> Iterator[str]:
    for c in common:
        digits = digits_worth(c.size.mean, c.size.low, c.size.high)
        mean = f"{with_unit(c.size.mean, c.unit, digits)} (90 % interval {interval(c.size.low, c.size.high, digits)})"
        same, of = (", which do the same here,", f"the mean size of {c.name}") if c.alike else ("", "its mean size")
        yield (
            f"{c.called}{same} is the simulator's fault with probability {probable(c.probability)}: {of} is {mean}, "
            f"and from machine to machine it scatters by {number(c.size.scatter, 2)} (sd)"
        )
    for sure, several in ((True, odd), (False, perhaps)):
        for o in several:
            what = f"something without a name at {o.port}" if o.port else _effects(o)
            how = "is unlike the others" if sure else "may be unlike the others"
            yield f"{o.machine} {how}, with probability {probable(o.probability)}: {what}"
    rest = len(machines) - len(odd) - len(perhaps)
    yield f"{count(rest)} of {count(len(machines))} machines are as the others"


def _effects(o: Odd) -> str:
    each = [f"{name} (probability {probable(p)})" for name, p in o.effects]
    return f"{' or '.join(each) or 'some effect'} is not as on the others"
