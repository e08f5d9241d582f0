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
from twinbench.data.batch import CHANNELS, HEALTH, INPUTS, OUTPUTS, SAMPLE_PERIOD_S, Array
from twinbench.data.units import UNITS, likely_units
from twinbench.methods.estimator import FLAG_FROZEN, FLAG_GATED, FLAG_MISSING, FLAG_SPIKE, FLAG_UNINFORMED
from twinbench.methods.observe import observe

FLAGS = {
    "spike": FLAG_SPIKE,
    "missing": FLAG_MISSING,
    "gated": FLAG_GATED,
    "frozen": FLAG_FROZEN,
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
        measured: (N, 7) readings in the channels' units, order CHANNELS, as recorded, on the 20 Hz grid, nothing
            joined.
        estimates: of this recording alone, B = 1.
        seen: likewise.
        who: the estimator's printed name.
    """
    narrowest = narrowing(estimates, references.estimator.init(1))[0]
    residual = _residual(measured, estimates)
    reference = references.of(manner)
    channels = _channels(measured, manner, seen.accepted[0], references.envelope, reference)
    ratio = nis_ratio(seen)[0]
    median = float(np.nanmedian(ratio)) if np.isfinite(ratio).any() else np.nan
    low, high = reference.nis_range(len(measured))
    verdict, because = (
        _unlike(channels)
        or _unsound(manner, references, who)
        or _rejected(channels, reference, residual)
        or _unlearnt(seen, narrowest, reference)
        or _inconsistent((median, low, high), channels, seen, reference, residual)
        or (USABLE, "")
    )
    there = np.asarray(~np.isnan(measured).all(axis=1))
    gaps = _gaps(there, min((m for m in manner if m), default=1))
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
        dict(zip(HEALTH, map(float, narrowest), strict=True)),
    )


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _residual(measured: Array, estimates: Estimates) -> Array:
    """(3,) typical readings of the outputs less what the estimate says that they read; NaN where there are none."""
    every = -(-len(measured) // len(estimates.time_s))
    apart = measured[::every, len(INPUTS) :] - observe(estimates.mean[0].astype(float))
    return np.array([np.median(a[~np.isnan(a)]) if np.isfinite(a).any() else np.nan for a in apart.T])


def _channels(
    measured: Array, manner: Manner, accepted: np.ndarray, envelope: Envelope, reference: Reference
) -> dict[str, ChannelUse]:
    told = reference.accepted.any()
    found = {}
    for c, name in enumerate(CHANNELS):
        read = ~np.isnan(measured[:, c])
        values, low, high = measured[read, c], envelope.low[c], envelope.high[c]
        period = manner[c] or max(manner) or 1
        found[name] = ChannelUse(
            UNITS[name],
            min(float(read.sum()) / -(-len(read) // period), 1.0),
            float(accepted[read, c].mean()) if told and len(values) else None,
            float(((values < low) | (values > high)).mean()) if len(values) else 0.0,
            manner[c] * SAMPLE_PERIOD_S if manner[c] else None,
            max(_gaps(read, period), default=0.0),
            float(np.median(values)) if len(values) else None,
            float(low),
            float(high),
        )
    return found


def _gaps(read: np.ndarray, period: int) -> list[float]:
    """Seconds of each stretch without a reading that lasts longer than a period does."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], read, [True]]).astype(np.int8)))
    lengths = edges[1::2] - edges[::2]
    return [float(n * SAMPLE_PERIOD_S) for n in lengths if n >= 2 * period]


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
    reference = references.of(manner)
    trained = references.of(tuple(min(m, 1) for m in manner))
    every = references.of((1,) * len(manner))
    if sound(reference, every) or not sound(every, every):  # who never learns anything says so by the next rule
        return None
    lacks = [name for name, ticks in zip(CHANNELS, manner, strict=True) if not ticks]
    if not sound(trained, every):
        return LACKS, f"{' and '.join(lacks)}; {_held(trained, every, who)}"
    seldom = [n for n, ticks in zip(CHANNELS, manner, strict=True) if ticks == max(manner)]
    what = "it was" if len(seldom) == len(CHANNELS) - len(lacks) else f"{' and '.join(seldom)} were"
    limit = references.slowest(manner)
    return SELDOM, (
        f"{what} read every {max(manner) * SAMPLE_PERIOD_S:g} s, {who} is trained for every {SAMPLE_PERIOD_S:g} s and "
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


def _rejected(channels: dict[str, ChannelUse], reference: Reference, residual: Array) -> tuple[str, str] | None:
    """Channels of which the estimator left most readings out, as it does not on sound recordings."""
    usual = dict(zip(CHANNELS, reference.accepted.mean(axis=0), strict=True))
    said = [
        f"{name} was rejected in {100 * (1.0 - c.accepted):.0f} % of its readings, on the validation recordings in "
        f"{100 * (1.0 - usual[name]):.1f} %{_typically(name, c, residual)}"
        for name, c in channels.items()
        if c.accepted is not None and c.accepted < MOST_UNUSED * usual[name]
    ]
    return (UNLIKE, "; ".join(said)) if said else None


def _typically(name: str, use: ChannelUse, residual: Array) -> str:
    """How far the readings of an output are from the estimate; empty for an input."""
    if name not in OUTPUTS or use.median is None:
        return ""
    off = float(residual[OUTPUTS.index(name)])
    near = (0.9 * (use.median - off), 1.1 * (use.median - off))  # where a wrong unit moves it by less, none is guessed
    way = "above" if off > 0.0 else "below"
    asks = "" if near[0] <= use.median <= near[1] else _asks(name, use, *near)
    return f"; typically it is {abs(off):.3g} {short_unit(use.unit)} {way} the estimate{asks}"


def _unlearnt(seen: Witnessed, narrowest: Array, reference: Reference) -> tuple[str, str] | None:
    outputs = seen.accepted[0][:, len(INPUTS) :]
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
    residual: Array,
) -> tuple[str, str] | None:
    """Innovations larger than the estimator's own on sound recordings."""
    median, low, high = nis
    if not median > high:
        return None
    read = [i for i, name in enumerate(OUTPUTS) if channels[name].accepted]
    ticks = seen.off.shape[1]
    usual = np.nanmedian(reference.off[:, :ticks, read].astype(np.float32), axis=(0, 1))
    worst = OUTPUTS[read[int(np.argmax(np.nanmedian(np.abs(seen.off[0][:, read]), axis=0) / usual))]]
    return UNLIKE, (
        f"the readings contradict each other, median NIS {median:.3g} of its chi-square's, expected {low:.3g} to "
        f"{high:.3g}; {worst} is farthest off{_typically(worst, channels[worst], residual)}; "
        "look at units (gauge or absolute pressure?), column names and sensors"
    )


def short_unit(unit: str) -> str:
    """As people write it."""
    return {"kelvin": "K", "dimensionless": "(no unit)"}.get(unit, unit)
