"""The history of a size in words."""

from __future__ import annotations

from twinbench.mismatch.history.axis import KNOTS, Axis
from twinbench.mismatch.history.history import History, Interval
from twinbench.mismatch.history.patterns import CONSTANT, RAMP, STEP
from twinbench.mismatch.place import bracketed
from twinbench.mismatch.words import digits_worth, interval, number, probable, spoken, time_unit

MINUTES_S = 300.0
"""Span from which on a rate is told per minute."""


def says(history: History) -> str:
    """One sentence, without a capital and a full stop: how the size went, how surely, since when and how fast."""
    kind, p = history.likeliest, {name: probable(share) for name, share in history.odds.items()}
    unit, last = spoken(history.size.unit), history.in_time[-1].size  # a size below nothing grows downwards
    if kind == CONSTANT:
        return f"its size is constant with probability {p[CONSTANT]}"
    constant = f"that it is constant has probability {p[CONSTANT]}"
    if kind == RAMP:
        verb = "grows" if history.rate.value * last > 0.0 else "falls"
        return (
            f"its size {verb} by {rate(history, history.rate)} {since(history)}, evenly with probability {p[RAMP]}; "
            + constant
        )
    if kind == STEP:
        low, high = sorted(abs(end) for end in (history.change.low, history.change.high))
        verb = "rises" if history.change.value * last > 0.0 else "falls"
        digits = digits_worth(abs(history.change.value), low, high)
        much = f"{number(abs(history.change.value), digits)} {unit}".rstrip()
        return (
            f"its size {verb} by {much} (90 % interval {interval(low, high, digits)}) {since(history)}, at once with "
            f"probability {p[STEP]}; {constant}"
        )
    points = history.in_time
    every = [one.size for one in points]
    return (
        f"its size wanders, with probability {p[kind]}: from {number(every[0])} at first to {number(every[-1])} at "
        f"last, between {number(min(every))} and {number(max(every))} {unit}".rstrip()
        + f"; {constant}"
    )


def rate(history: History, value: Interval) -> str:
    """How fast a size changes, with its interval, per second, minute, hour or day."""
    span = history.axis.span_s
    per_s, unit = time_unit(span)
    if per_s == 1.0 and span > MINUTES_S:
        per_s, unit = 60.0, "min"
    per = f"{spoken(bracketed(history.size.unit))}/{unit}"
    low, middle, high = (per_s * v for v in (value.low, value.value, value.high))
    if middle < 0.0:
        low, middle, high = -high, -middle, -low
    digits = digits_worth(middle, low, high)
    return f"{number(middle, digits)} {per} (90 % interval {interval(low, high, digits)})"


def since(history: History) -> str:
    """From when on, with the interval of that."""
    axis, when = history.axis, history.since
    if when.low <= float(axis.along_s.min()) + axis.span_s / KNOTS:
        return f"throughout, or from before {at(axis, when.high)} on"
    return f"from {at(axis, when.value)} on (90 % interval {at(axis, when.low)} to {at(axis, when.high)})"


def at(axis: Axis, along_s: float) -> str:
    """A time on the axis as one of a recording's clock."""
    name, time_s = axis.place(along_s)
    return f"{number(time_s)} s of {name}"
