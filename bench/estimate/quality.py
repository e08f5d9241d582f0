"""What an estimator made of one recording: which readings it used, how far they fit, and whether the answer is one."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np

from twinbench.bench.estimate.reference import Envelope, Reference, References, learns, narrowing, nis_ratio, sound
from twinbench.bench.estimate.sampling import Manner
from twinbench.bench.estimate.witness import Witnessed
from twinbench.bench.estimates import Estimates
from twinbench.data.units import likely_units, short_unit
from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine
from twinbench.methods.estimator import FLAG_GATED, FLAG_MISSING, FLAG_SPIKE, FLAG_UNINFORMED

FLAGS = {
    "spike": FLAG_SPIKE,
    "missing": FLAG_MISSING,
    "gated": FLAG_GATED,
    "uninformed": FLAG_UNINFORMED,
}
MOST_UNUSED = 0.5
"""Most of a channel's readings: a channel of which more lie outside training, or are rejected, is not one to go by."""

USABLE, UNLIKE, PRIOR, SELDOM, LACKS = (
    "usable",
    "these recordings do not look like this machine",
    "nothing was learnt",
    "read too seldom",
    "channels are missing",
)


@dataclass(frozen=True)
class ChannelUse:
    """One channel of one recording. Shares are of 1.

    Attributes:
        offered: readings there are, of those that its period promises.
        accepted: of the readings there are, those that the estimator used; None where it does not say.
        outside: of the readings there are, those outside the training range.
        period_s: between two readings; None where it was never read.
        longest_gap_s: between two readings, or an end and a reading.
        median, trained_low, trained_high: in the channel's unit.
    """

    unit: str
    offered: float
    accepted: float | None
    outside: float
    period_s: float | None
    longest_gap_s: float
    median: float | None
    trained_low: float
    trained_high: float


@dataclass(frozen=True)
class Quality:
    """What the estimate of one recording rests on.

    Attributes:
        verdict: one of the five constants above.
        because: the reason in words; empty where it is usable.
        nis_median, nis_low, nis_high: median NIS, each over the median of its chi-square, and where that of a sound
            recording is expected; None: not known.
        gaps: times when no channel was read for longer than the period; number, longest and all seconds.
        flags: share of the ticks with a reading, by name.
        narrowest: width of the health intervals over that at the start, by name.
    """

    verdict: str
    because: str
    channels: dict[str, ChannelUse]
    nis_median: float | None
    nis_low: float | None
    nis_high: float | None
    gaps: int
    longest_gap_s: float
    gaps_s: float
    flags: dict[str, float]
    narrowest: dict[str, float]

    @property
    def usable(self) -> bool:
        """Is the estimate one to go by?"""
        return self.verdict == USABLE

    def to_json(self) -> dict[str, Any]:
        """As the summary holds it."""
        return {"usable": self.usable, **asdict(self)}


def judge(
    measured: Array, manner: Manner, estimates: Estimates, seen: Witnessed, references: References, who: str
) -> Quality:
    """Facts and verdict of one recording.

    Args:
        measured: (N, nu + ny) readings in the channels' units as recorded, one row a tick, nothing joined.
        estimates: of this recording alone, B = 1.
        seen: likewise.
        who: the estimator's printed name.
    """
    machine = references.machine
    narrowest = narrowing(estimates, references.estimator.init(1), machine)[0]
    reference = references.of(manner)
    read = Read(machine, measured, manner, estimates)
    channels = _channels(read, seen.accepted[0], references.envelope, reference)
    ratio = nis_ratio(seen)[0]
    median = float(np.nanmedian(ratio)) if np.isfinite(ratio).any() else np.nan
    low, high = reference.nis_range(len(measured))
    verdict, because = (
        _unlike(channels)
        or _unsound(manner, references, who)
        or _rejected(channels, reference, read)
        or _unlearnt(seen, narrowest, reference, machine)
        or _inconsistent((median, low, high), channels, seen, reference, read)
        or (USABLE, "")
    )
    there = np.asarray(~np.isnan(measured).all(axis=1))
    gaps = _gaps(there, min((m for m in manner if m), default=1), machine.sample_period_s)
    return Quality(
        verdict,
        because,
        channels,
        _number(median),
        _number(low),
        _number(high),
        len(gaps),
        max(gaps, default=0.0),
        sum(gaps),
        {name: float((seen.flags[0][there] & flag > 0).mean()) for name, flag in FLAGS.items()},
        dict(zip(machine.health_names, map(float, narrowest), strict=True)),
    )


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


@dataclass(frozen=True)
class Read:
    """A recording and what was made of it.

    Attributes:
        machine: of which it is.
        measured: (N, nu + ny) readings in the channels' units; NaN means missing.
        manner: how often each channel was read.
        estimates: of it alone.
    """

    machine: Machine
    measured: Array
    manner: Manner
    estimates: Estimates

    def off(self, output: str) -> float:
        """How far an output typically is from what the estimate says that it reads, in its unit; NaN if unread."""
        machine, i = self.machine, self.machine.outputs.index(output)
        every = -(-len(self.measured) // len(self.estimates.time_s))
        said = machine.observe(self.estimates.mean[0].astype(float))[:, i]
        apart = self.measured[::every, len(machine.inputs) + i] - said
        return float(np.median(apart[~np.isnan(apart)])) if np.isfinite(apart).any() else np.nan


def _channels(read: Read, used: np.ndarray, envelope: Envelope, reference: Reference) -> dict[str, ChannelUse]:
    told, manner, period_s = reference.accepted.any(), read.manner, read.machine.sample_period_s
    found = {}
    for c, name in enumerate(read.machine.channels):
        there = ~np.isnan(read.measured[:, c])
        values, low, high = read.measured[there, c], envelope.low[c], envelope.high[c]
        period = manner[c] or max(manner) or 1
        found[name] = ChannelUse(
            read.machine.variables[name].unit,
            min(float(there.sum()) / -(-len(there) // period), 1.0),
            float(used[there, c].mean()) if told and len(values) else None,
            float(((values < low) | (values > high)).mean()) if len(values) else 0.0,
            manner[c] * period_s if manner[c] else None,
            max(_gaps(there, period, period_s), default=0.0),
            float(np.median(values)) if len(values) else None,
            float(low),
            float(high),
        )
    return found


def _gaps(read: np.ndarray, period: int, period_s: float) -> list[float]:
    """Seconds of each stretch without a reading that lasts longer than a period does."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], read, [True]]).astype(np.int8)))
    lengths = edges[1::2] - edges[::2]
    return [float(n * period_s) for n in lengths if n >= 2 * period]


def _unlike(channels: dict[str, ChannelUse]) -> tuple[str, str] | None:
    """Channels that are mostly where training never was."""
    far = {n: c for n, c in channels.items() if c.outside > MOST_UNUSED and c.median is not None}
    swapped = _swapped(far)
    said = [f"{' and '.join(pair)} read as each other should: are they swapped?" for pair in swapped]
    for name, c in far.items():
        if not any(name in pair for pair in swapped):
            said.append(
                f"{name} has the median {c.median:.4g} {short_unit(c.unit)}, training was between "
                f"{c.trained_low:.4g} and {c.trained_high:.4g}{_asks(name, c, c.trained_low, c.trained_high)}"
            )
    return (UNLIKE, "; ".join(said)) if said else None


def _asks(name: str, use: ChannelUse, low: float, high: float) -> str:
    """The units under which the channel's median would lie between two values, as a question."""
    units = likely_units(use.median, use.unit, low, high) if use.median is not None else ()
    return f"; is it in {' or '.join(units)}? Then say --map 'COLUMN[{units[0]}]={name}'" if units else ""


def _swapped(far: dict[str, ChannelUse]) -> list[tuple[str, str]]:
    """Pairs of channels in one unit, each of which reads as the other should."""
    return [
        (a, b)
        for (a, one), (b, other) in combinations(far.items(), 2)
        if one.unit == other.unit and _within(one, other) and _within(other, one)
    ]


def _within(one: ChannelUse, other: ChannelUse) -> bool:
    return other.trained_low <= float(one.median or 0.0) <= other.trained_high


def _unsound(manner: Manner, references: References, who: str) -> tuple[str, str] | None:
    """Recordings read like this one, of which the estimator could not be trusted where the truth is known."""
    names, period_s = references.machine.channels, references.machine.sample_period_s
    reference = references.of(manner)
    trained = references.of(tuple(min(m, 1) for m in manner))
    every = references.of((1,) * len(manner))
    if sound(reference, every) or not sound(every, every):  # who never learns anything says so by the next rule
        return None
    lacks = [name for name, ticks in zip(names, manner, strict=True) if not ticks]
    if not sound(trained, every):
        return LACKS, f"{' and '.join(lacks)}; {_held(trained, every, who)}"
    seldom = [n for n, ticks in zip(names, manner, strict=True) if ticks == max(manner)]
    what = "it was" if len(seldom) == len(names) - len(lacks) else f"{' and '.join(seldom)} were"
    limit = references.slowest(manner)
    return SELDOM, (
        f"{what} read every {max(manner) * period_s:g} s, {who} is trained for every {period_s:g} s and "
        f"goes down to every {limit:g} s; {_held(reference, every, who)}"
    )


def _held(reference: Reference, every: Reference, who: str) -> str:
    """What was measured, in words."""
    if not learns(reference.narrowest):
        return f"on the validation recordings, read like that, {who} learnt nothing: its estimate was the prior"
    return (
        f"on the validation recordings, read like that, its 95 % intervals held the truth in "
        f"{100 * reference.covered:.0f} % of the samples, otherwise in {100 * every.covered:.0f} %"
    )


def _rejected(channels: dict[str, ChannelUse], reference: Reference, read: Read) -> tuple[str, str] | None:
    """Channels of which the estimator left most readings out, as it does not on sound recordings."""
    usual = dict(zip(channels, reference.accepted.mean(axis=0), strict=True))
    said = [
        f"{name} was rejected in {100 * (1.0 - c.accepted):.0f} % of its readings, on the validation recordings in "
        f"{100 * (1.0 - usual[name]):.1f} %{_typically(name, c, read)}"
        for name, c in channels.items()
        if c.accepted is not None and c.accepted < MOST_UNUSED * usual[name]
    ]
    return (UNLIKE, "; ".join(said)) if said else None


def _typically(name: str, use: ChannelUse, read: Read) -> str:
    """How far the readings of an output are from the estimate; empty for an input."""
    if name not in read.machine.outputs or use.median is None:
        return ""
    off = read.off(name)
    near = (0.9 * (use.median - off), 1.1 * (use.median - off))  # where a wrong unit moves it by less, none is guessed
    way = "above" if off > 0.0 else "below"
    asks = "" if near[0] <= use.median <= near[1] else _asks(name, use, *near)
    return f"; typically it is {abs(off):.3g} {short_unit(use.unit)} {way} the estimate{asks}"


def _unlearnt(seen: Witnessed, narrowest: Array, reference: Reference, machine: Machine) -> tuple[str, str] | None:
    outputs = seen.accepted[0][:, len(machine.inputs) :]
    if reference.accepted.any() and not outputs.any():
        return PRIOR, "the estimate is the prior: no reading of an output was used"
    if not learns(narrowest):
        return PRIOR, "the estimate is the prior: no health interval is narrower than at the start"
    return None


def _inconsistent(
    nis: tuple[float, float, float],
    channels: dict[str, ChannelUse],
    seen: Witnessed,
    reference: Reference,
    read: Read,
) -> tuple[str, str] | None:
    """Innovations larger than the estimator's own on sound recordings."""
    median, low, high = nis
    if not median > high:
        return None
    outputs = read.machine.outputs
    used = [i for i, name in enumerate(outputs) if channels[name].accepted]
    ticks = seen.off.shape[1]
    usual = np.nanmedian(reference.off[:, :ticks, used].astype(np.float32), axis=(0, 1))
    worst = outputs[used[int(np.argmax(np.nanmedian(np.abs(seen.off[0][:, used]), axis=0) / usual))]]
    return UNLIKE, (
        f"the readings contradict each other, median NIS {median:.3g} of its chi-square's, expected {low:.3g} to "
        f"{high:.3g}; {worst} is farthest off{_typically(worst, channels[worst], read)}; "
        "look at units (gauge or absolute pressure?), column names and sensors"
    )
