"""A diagnosis in words: one sentence that is the verdict, and the points that follow from it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from twinbench.mismatch.began import begins
from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.errors import OutputError
from twinbench.mismatch.findings import PHYSICS, SENSOR, Finding, acts_at, none_of_them, variable_names
from twinbench.mismatch.followed import Followed
from twinbench.mismatch.naming.answer import PLAIN, Unnamed
from twinbench.mismatch.noise import BEYOND_DOUBT
from twinbench.mismatch.noisy_inputs import NoisyInput, SpikyInput
from twinbench.mismatch.sizes import Value
from twinbench.mismatch.unbroken import whole
from twinbench.mismatch.words import count, counted, interval, listed, number, probable, sentence, with_unit

AGREES = "the simulator agrees with the recordings"
MOST_NAMED = 6
"""Names in a sentence that a table has all of."""
ONE_PERIOD = 1.2
"""Longest over shortest period of a band that is told as one period: periods of a machine lie further apart."""
HARDLY_EVER = 0.05
"""Probability of a name below which an experiment is not told."""
NAMED_IN_ONE = 3
"""Recordings that a sentence names one by one."""


def headline(
    d: Diagnosis, verdict: str, found: Sequence[Finding], errors: Sequence[OutputError], missing: Sequence[str]
) -> str:
    """The verdict in one sentence, with the error on what was held out and the sensor's noise.

    Args:
        missing: what else is wrong, of which no finding speaks.
    """
    if found:
        *first, last = _leads(d, found)
        lead = f"{', '.join(first)}, and {last}" if first else last
    elif missing:
        lead = "something is wrong that nothing in the catalogue explains"
    else:
        lead = AGREES + (" once its parameters are right" if verdict == "parameter change" else "")
    if d.unfollowed and not found:
        lead = f"the simulator explains nothing of what {listed([u.channel for u in d.unfollowed])} does"
    if verdict == "incomplete" and not any(not f.names for f in found):
        lead += ", and that is not all"
    known = variable_names(d.simulator)
    shown = [e for e in errors if e.held_out] or list(errors)
    if not shown:
        return sentence(lead, known)
    worst = furthest(d, shown)
    return sentence(f"{lead}: on {_held_out(d)} {_error(worst, d.mended is not None, len(shown))}", known)


def furthest(d: Diagnosis, errors: Sequence[OutputError]) -> OutputError:
    """The output that the calibrated simulator is furthest off, in noises of its sensor; first what it does not follow.

    A column in a wrong order looks like noise, and its error like no more than that.
    """
    lost = {u.channel for u in d.unfollowed}
    return max(errors, key=lambda e: (e.channel in lost, e.rmse_before / max(e.noise_sd, 1e-300)))


def points(
    d: Diagnosis,
    found: Sequence[Finding],
    changed: Sequence[Value],
    errors: Sequence[OutputError],
    missing: Sequence[str],
) -> Iterator[str]:
    """What else is to be said, one thing a point.

    Args:
        changed: parameters that moved.
        missing: what else is wrong, of which no finding speaks.
    """
    yield from _told(d, found)
    yield from at_one_port(found)
    shown = [e for e in errors if e.held_out]
    for e in shown:
        if e is not furthest(d, shown):
            yield sentence(f"on {_held_out(d)} {_error(e, d.mended is not None)}")
    yield from (sentence(text) for text in missing)
    yield from _inexact(d)
    yield from _coloured(d)
    if changed:
        moved = [f"{v.name} from {number(v.before or 0.0)} to {v.words()}" for v in changed]
        yield sentence(f"parameters moved, with 90 % intervals: {listed(moved)}")
    yield from _self_check(d, found)
    if data := more_data(d, found):
        yield data
    yield from _taken_out(d)
    yield from _joined(d)
    yield from map(_noisy, d.noisy)
    learnt = {whole(t.name) for t in d.tracks}
    if len(learnt) == 1:
        yield sentence(
            f"only {listed([*learnt])} was learnt from, so whether sizes and parameters are the same in other "
            "recordings could not be checked"
        )
    yield held_out_use(d)


def _told(d: Diagnosis, found: Sequence[Finding]) -> Iterator[str]:
    """What each finding says; of several that explain together what acts at one port, what they say together."""

    def of(f: Finding) -> tuple[object, ...]:
        return (f.port, bool(f.stand_in), none_of_them(d, f.best)) if f.best and not d.refused else (id(f),)

    for f in found:
        same = [g for g in found if of(g) == of(f)]
        if len(same) == 1:
            yield f.says
        elif f is same[0]:
            yield _together(same, none_of_them(d, f.best))


def _together(same: Sequence[Finding], none: str) -> str:
    """Several that explain together what acts at one port, and why none of them is its name."""
    most = max(1.0 - (f.probability or 0.0) for f in same)
    right = f"but {none}" if none else f"none of them with a probability above {probable(most)}"
    says = sentence(f"{acts_at(str(same[0].port))}: {listed([f.best for f in same])} explain it best, {right}")
    since = f" {sentence(begins(same[0].onsets))}" if same[0].onsets else ""
    stand_in = " Until more is known they stand in for it in the mended model." if same[0].stand_in else ""
    return says + since + stand_in


def at_one_port(found: Sequence[Finding]) -> Iterator[str]:
    """Named physics that acts at one port may be one law, whose form the catalogue does not hold."""
    physics = [f for f in found if f.kind == PHYSICS and (f.alike or len(f.names) == 1)]
    for port in dict.fromkeys(f.port for f in physics):
        names = [f.names[0] for f in physics if f.port == port]
        if len(names) > 1:
            yield sentence(
                f"{listed(names)} act at one port: a single law that the catalogue does not hold may do what they do "
                "together"
            )


def inexact(d: Diagnosis) -> tuple[Unnamed, ...]:
    """Where the equations, with all that is named, are plainly inexact, by less than what has to be missing.

    At most two ports are told, the likelier first.
    """
    answer = d.answer
    if answer.more:
        return ()
    return tuple(u for u in answer.inexact[:2] if u.log > max(BEYOND_DOUBT, answer.inexact[0].log - PLAIN))


def _inexact(d: Diagnosis) -> Iterator[str]:
    if places := inexact(d):
        where = " or ".join(str(u.port) for u in places)
        yield sentence(
            f"the equations are inexact at {where}, by about {number(places[0].size_pct, 2)} % of what commonly acts "
            "there. The simulator may be that rough, or something small is missing"
        )


def _coloured(d: Diagnosis) -> Iterator[str]:
    """Where what is left is told from noise by its spectrum: what acts in time is a function of no state."""
    c = d.answer.coloured
    if c.sure:
        about = with_unit(math.sqrt(c.shortest_s * c.longest_s), "s")
        periods = f"{number(c.shortest_s)} to {with_unit(c.longest_s, 's')}"
        at = f"a period of about {about}" if c.longest_s < ONE_PERIOD * c.shortest_s else f"periods of {periods}"
        yield sentence(
            f"the residual of {d.simulator.outputs[c.channel].name} is not noise alone: at {at} its power is "
            f"{number(c.power, 2)} times that of the noise. Something that changes with time alone leaves such a "
            "residual, and so does an inexact form"
        )


def what_else(d: Diagnosis) -> tuple[str, ...]:
    """What is wrong besides the findings: outputs that are not followed, errors that grow on what was held out."""
    return (*(_not_followed(u) for u in d.unfollowed), *d.strange)


def held_out_use(d: Diagnosis) -> str:
    """What the recordings held back were used for."""
    if not d.held:
        return "No recording was held back, so nothing was proved on one."
    own = "the start state" + (" and the course of what drifts were" if d.simulator.drifts else " was")
    said = "What was held back chose nothing, and counts only in whether a name is given and the model mended"
    return sentence(f"only {own} learnt from {_held_out(d)}. {said}")


def more_data(d: Diagnosis, found: Sequence[Finding]) -> str:
    """What to record next; empty if nothing is known that would help."""
    sets = [f for f in found if len(f.names) > 1 and not f.alike]
    if not sets:
        if found or not (hidden := _hidden(d)):
            return _experiment(d)
        how = "move the inputs more, or record longer" if d.simulator.inputs else "record longer"
        return f"To see {hidden[0]}, {how}."
    first, second = sets[0].names[:2]
    how = (
        "wider and faster changes of the inputs than in these recordings, and both directions of motion or flow"
        if d.simulator.inputs
        else "from other starts than these recordings', and for longer"
    )
    return f"To tell {first} from {second}, record where their effects differ: {how}. {_experiment(d)}".rstrip()


def _experiment(d: Diagnosis) -> str:
    """The best experiment where the inputs were already; empty if none of them would do it."""
    best = d.experiment
    if best is None or best.probability < HARDLY_EVER:
        return ""
    return sentence(
        f"where the inputs were already, the best experiment to tell {listed(best.rivals)} apart is {best.says}: it "
        f"leaves the right name alone with probability {probable(best.probability)}"
    )


def _self_check(d: Diagnosis, found: Sequence[Finding]) -> Iterator[str]:
    """What the answer is worth on these recordings, and what would have stayed hidden in them."""
    check = d.self_check
    if check.decoys:
        yield from check.says
    if not found and check.power:
        hidden = _hidden(d)
        looked = counted(len(check.power), "effect")
        yield sentence(
            f"of {looked} looked for {count(len(hidden))} would not have been named at any size"
            + (f": {listed(hidden, MOST_NAMED)}" if hidden else "")
        )


def _hidden(d: Diagnosis) -> list[str]:
    """Candidates that these recordings would not have shown at any size that they may have."""
    return [p.name for p in d.self_check.power if p.size_90 is None]


def _leads(d: Diagnosis, found: Sequence[Finding]) -> Iterator[str]:
    """What the findings are, before any number: one in its own words, several counted."""
    if len(found) == 1:
        yield _one(d, found[0])
        return
    named = [f for f in found if f.names]
    if lacks := sum(f.kind == PHYSICS for f in named):
        yield f"the simulator lacks {counted(lacks, 'effect')}"
    if faulty := sum(f.kind == SENSOR for f in named):
        yield f"{counted(faulty, 'sensor or input is', 'sensors or inputs are')} at fault"
    if either := len(named) - lacks - faulty:
        yield f"{counted(either, 'effect or fault is', 'effects or faults are')} there"
    if places := list(dict.fromkeys(str(f.port) for f in found if not f.names)):
        yield _unnamed(d, places)


def _one(d: Diagnosis, f: Finding) -> str:
    known = {m.name: m.says for m in (*(c.mechanism for c in d.machine.candidates), *d.rounded)}
    if not f.names:
        return _unnamed(d, [str(f.port)])
    if len(f.names) == 1:
        return known.get(f.names[0], f"the sensor of {f.port.variable if f.port else ''} stands still")
    if f.alike:
        return f"{' or '.join(known[name] for name in f.names)}, which do the same in these recordings"
    if f.kind == PHYSICS:
        return f"the simulator lacks one of {listed(f.names)}"
    return f"one of {listed(f.names)} is missing or at fault"


def _unnamed(d: Diagnosis, places: Sequence[str]) -> str:
    beside = "something else" if d.named else "something"
    says = acts_at(listed(places), beside)
    if d.stand_ins:
        says += f", and {listed(d.stand_ins, MOST_NAMED)} {'stands' if len(d.stand_ins) == 1 else 'stand'} in for it"
    return says


def _error(e: OutputError, mended: bool, of: int = 1) -> str:
    """An output's error, before and after if something was added, beside the noise of its sensor."""
    which = f"{e.channel}, the furthest off of {of} outputs," if of > 1 else e.channel
    noise = f"the noise of its sensor from reading to reading is {with_unit(e.noise_sd, e.unit)}"
    if not mended:
        return f"the RMS error of {which} is {with_unit(e.rmse_after, e.unit)}; {noise}"
    before, after = number(e.rmse_before), with_unit(e.rmse_after, e.unit)
    if e.change_high < 0.0:
        change = f"falls from {before} to {after} (90 % interval of the fall {interval(-e.change_high, -e.change_low)})"
    elif e.change_low > 0.0:
        change = f"grows from {before} to {after} (90 % interval of the growth {interval(e.change_low, e.change_high)})"
    else:
        change = (
            f"is {before} before and {after} after, which may be chance (90 % interval of the change "
            f"{interval(e.change_low, e.change_high)})"
        )
    return f"the RMS error of {which} {change}; {noise}"


def _not_followed(u: Followed) -> str:
    """Of an output of which the simulator explains nothing."""
    where = "" if u.held_out else " where it was fitted"
    return (
        f"the simulator does not follow the output {u.channel}{where}: it explains no more of its standard deviation "
        f"of {with_unit(u.sd, u.unit)} than chance would, and the noise of its sensor from reading to reading is "
        f"{with_unit(u.noise_sd, u.unit)}"
    )


def _joined(d: Diagnosis) -> Iterator[str]:
    """How the inputs go between samples, where that is not as it always was."""
    j = d.joined
    if j.by == "fit" and j.rmse_linear is not None and j.rmse_held is not None:
        yield sentence(
            f"the inputs are joined by lines between samples: on a short stretch the error of {j.channel} is then "
            f"{with_unit(j.rmse_linear, j.unit)}, and {number(j.rmse_held)} if they are held"
        )
    elif j.inputs == "linear":
        yield "The inputs are joined by lines between samples, as asked."


def _noisy(n: SpikyInput | NoisyInput) -> str:
    """What was taken off an input's record."""
    if isinstance(n, SpikyInput):
        return sentence(
            f"{counted(n.many, 'value')} of {n.name} jumped away and back. The machine did not follow, so they were "
            "taken out"
        )
    return sentence(
        f"the record of {n.name} has a noise of {with_unit(n.sd, n.unit)} (standard deviation). The machine did not "
        "follow it, so it was taken out"
    )


def _taken_out(d: Diagnosis) -> Iterator[str]:
    """Readings that were set aside as spikes."""
    counts: dict[str, int] = {}
    for spike in d.spikes:
        counts[spike.channel] = counts.get(spike.channel, 0) + 1
    if counts:
        each = listed([f"{counted(n, 'reading')} of {channel}" for channel, n in counts.items()])
        yield sentence(f"taken out as spikes: {each}")


def _held_out(d: Diagnosis) -> str:
    return listed([t.name for t in d.held or d.tracks], NAMED_IN_ONE)
