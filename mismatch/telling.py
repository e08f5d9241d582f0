"""A diagnosis in words: one sentence that is the verdict, and the points that follow from it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from twinbench.mismatch import evidence
from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.evidence import OutputError
from twinbench.mismatch.findings import Finding, Value, variable_names
from twinbench.mismatch.words import count, counted, interval, listed, number, sentence, with_unit

MOST_NAMED = 6
"""Names in a sentence that a table has all of."""
AGREES = "the simulator agrees with the recordings"


def headline(
    d: Diagnosis, verdict: str, findings: Sequence[Finding], errors: Sequence[OutputError], incomplete: bool
) -> str:
    """The verdict in one sentence, with the error on what was held out and the sensor's noise."""
    if verdict == "consistent":
        lead = AGREES
    elif verdict == "parameter change":
        lead = f"{AGREES} once its parameters are right"
    elif len(findings) == 1:
        lead = _one(d, findings[0])
    else:
        lead = listed(list(_several(findings)))
    if incomplete:
        lead += ", and that is not all"
    shown = [e for e in errors if e.held_out] or list(errors)
    if not shown:
        return sentence(lead, variable_names(d.simulator))
    return sentence(
        f"{lead}: on {_held_out(d)} {_error(furthest(d, shown), d.chosen is not None, len(shown))}",
        variable_names(d.simulator),
    )


def furthest(d: Diagnosis, errors: Sequence[OutputError]) -> OutputError:
    """The output that the calibrated simulator is furthest off, in noises of its sensor; first what it does not follow.

    A column in a wrong order looks like noise, and its error like no more than that.
    """
    lost = {u.channel for u in d.unfollowed}
    return max(errors, key=lambda e: (e.channel in lost, e.rmse_before / max(e.noise_sd, 1e-300)))


def points(
    d: Diagnosis,
    findings: Sequence[Finding],
    changed: Sequence[Value],
    errors: Sequence[OutputError],
    left: Sequence[str],
) -> Iterator[str]:
    """What else is to be said, one thing a point.

    Args:
        left: why what is left is no noise.
    """
    yield from (f.says for f in findings)
    shown = [e for e in errors if e.held_out]
    for e in shown:
        if e is not furthest(d, shown):
            yield sentence(f"on {_held_out(d)} {_error(e, d.chosen is not None)}")
    yield from _not_followed(d)
    if changed:
        moved = [f"{v.name} from {number(v.before or 0.0)} to {v.words()}" for v in changed]
        yield sentence(f"parameters moved, with 90 % intervals: {listed(moved)}")
    yield from (sentence(f"not all is explained: {why}") for why in left)
    if d.chosen is not None and any(f.kind == "missing physics" for f in findings):
        yield from _instruments(d)
    if not findings:
        yield from _hidden(d)
    yield from _taken_out(d)
    yield from _joined(d)
    yield held_out_use(d)


def held_out_use(d: Diagnosis) -> str:
    """What the recordings held back were used for."""
    own = "where it starts" + (" and how what drifts went" if d.simulator.drifts else "")
    used = f"nothing but {own} was learnt from {_held_out(d)}"
    if d.weighed_on_held_out:
        used += f"; {counted(d.weighed_on_held_out, 'explanation was', 'explanations were')} compared on it"
        used += ", so its errors flatter the one that was chosen a little" if d.chosen is not None else ""
    return sentence(used)


def more_data(d: Diagnosis, findings: Sequence[Finding]) -> str:
    """What to record next; empty if nothing is known that would help."""
    sets = [f for f in findings if len(f.candidates) > 1]
    if sets:
        first, second = sets[0].candidates[:2]
        how = (
            "wider and faster changes of the inputs than in these recordings, and both directions of motion or flow"
            if d.simulator.inputs
            else "from other starts than these recordings', and for longer"
        )
        return f"To tell {first} from {second}, record where their effects differ: {how}."
    if not findings:
        hidden = [name for name, size in smallest_seen(d) if size > 1.0]
        if hidden:
            how = "move the inputs more, or record longer" if d.simulator.inputs else "record longer"
            return f"To see {hidden[0]} at its typical size, {how}."
    return ""


def smallest_seen(d: Diagnosis) -> list[tuple[str, float]]:
    """The least size of each candidate that would have passed the threshold, in its typical sizes."""
    best: dict[str, float] = {}
    for i, variant in enumerate(d.shown.variants):
        name = d.machine.candidates[variant.candidate].name
        size = float(np.sqrt(d.threshold / max(d.shown.G[i, i], 1e-12)))
        best[name] = min(best.get(name, np.inf), size)
    return sorted(best.items(), key=lambda item: item[1])


def _one(d: Diagnosis, finding: Finding) -> str:
    """What one finding is, before any number."""
    if finding.mechanism is not None:
        known = {c.name: c.mechanism for c in d.machine.candidates}
        if len(finding.candidates) > 1:
            some = listed(finding.candidates)
            physics = {known[name].kind == "physics" for name in finding.candidates if name in known}
            return f"the simulator lacks one of {some}" if all(physics) else f"one of {some} is missing or at fault"
        says = {name: mechanism.says for name, mechanism in known.items()}
        return says.get(
            finding.mechanism, f"the sensor of {finding.port.variable if finding.port else ''} stands still"
        )
    if d.unfollowed and d.chosen is None:
        return f"the simulator explains nothing of what {listed([u.channel for u in d.unfollowed])} does"
    if finding.candidates:
        return f"something is missing at {finding.port} that these recordings cannot name"
    return "something is wrong, and nothing that was looked for explains it"


def _several(findings: Sequence[Finding]) -> Iterator[str]:
    """What several findings are, before any number."""
    kinds = [f.kind for f in findings]
    if lacks := kinds.count("missing physics"):
        sure = sum(f.is_sure for f in findings if f.kind == "missing physics")
        how_sure = "" if sure == lacks else f" ({count(sure) if sure else 'none'} of them sure by name)"
        yield f"the simulator lacks {counted(lacks, 'effect')}{how_sure}"
    if faulty := kinds.count("sensor fault"):
        yield f"{counted(faulty, 'sensor or input is', 'sensors or inputs are')} at fault"
    if "unexplained" in kinds:
        yield "something else is wrong that nothing explains"


def _error(e: OutputError, mended: bool, of: int = 1) -> str:
    """An output's error, before and after if something was added, beside the noise of its sensor."""
    which = f"{e.channel}, the furthest off of {of} outputs," if of > 1 else e.channel
    noise = f"its sensor scatters by {with_unit(e.noise_sd, e.unit)} from reading to reading"
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


def _not_followed(d: Diagnosis) -> Iterator[str]:
    """Outputs of which the simulator explains nothing."""
    for u in d.unfollowed:
        where = "" if u.held_out else " where the simulator was fitted"
        yield sentence(
            f"the output {u.channel} is not followed{where}: of its standard deviation of {with_unit(u.sd, u.unit)} "
            f"(its sensor scatters by {with_unit(u.noise_sd, u.unit)}) the simulator explains no more "
            "than chance would"
        )


def _joined(d: Diagnosis) -> Iterator[str]:
    """How the inputs go between samples, where that is not as it always was."""
    j = d.joined
    if j.by == "fit" and j.rmse_linear is not None and j.rmse_held is not None:
        yield sentence(
            f"the inputs are joined by lines between samples: on a short stretch that leaves an error of {j.channel} "
            f"of {with_unit(j.rmse_linear, j.unit)}, and holding them {number(j.rmse_held)}"
        )
    elif j.inputs == "linear":
        yield "The inputs are joined by lines between samples, as asked."


def _instruments(d: Diagnosis) -> Iterator[str]:
    """How far sensors and inputs alone could be to blame."""
    fault = evidence.best_fault_alone(d)
    if fault is None:
        return
    named = listed(fault.names)
    measured = [e for e in fault.errors if np.isfinite(e[2])]
    if measured:
        channel, unit, before, alone, chosen = max(measured, key=lambda e: e[2] / max(e[4], 1e-300))
        yield sentence(
            f"a fault of sensors or inputs alone, at best {named}, leaves an error of {channel} of "
            f"{with_unit(alone, unit)} where it learnt; what is named leaves {number(chosen)}, and the simulator with "
            f"its own parameters fitted {number(before)}"
        )


def _hidden(d: Diagnosis) -> Iterator[str]:
    """What would not have been seen."""
    seen = smallest_seen(d)
    hidden = [name for name, size in seen if size > 1.0]
    plain = counted(len(seen) - len(hidden), "would", "would") if hidden else "all would"
    yield sentence(
        f"of {counted(len(seen), 'effect')} looked for {plain} have been seen at a typical size"
        + (f"; too small to be seen: {listed(hidden, MOST_NAMED)}" if hidden else "")
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
    return listed([t.name for t in d.held], 3)
