"""Numbers, units and lists as people read them; the same in a terminal, on a page and in ``verdict.json``."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
COUNTS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
LEAST_PLAIN, MOST_PLAIN = 1e-3, 1e5
"""Numbers between these are written without a power of ten."""
FINEST = 6
"""Significant digits at most, however narrow the interval: no fit is known better."""
NEARLY_SURE = 0.99
"""Probability above which probabilities are not told apart: they are not known so well."""
SELDOM = 0.01
"""Probability below which a port or a name is not told, nor how small it is."""


def number(value: float, digits: int = 3) -> str:
    """So many significant digits, with a true minus sign; a dash where there is no number."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:.{digits - 1}e}"
    mantissa, _, power = text.partition("e")
    if value and not LEAST_PLAIN <= abs(float(text)) < MOST_PLAIN:
        trimmed = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
        return f"{trimmed} × 10{str(int(power)).translate(SUPERSCRIPTS)}".replace("-", "−")
    decimals = max(digits - 1 - int(power), 0)
    plain = f"{float(text):,.{decimals}f}"
    return (plain.rstrip("0").rstrip(".") if "." in plain else plain).replace("-", "−")


def probable(p: float | None) -> str:
    """A probability as it is told."""
    if p is None:
        return "not known"
    if p > NEARLY_SURE:
        return f"above {number(NEARLY_SURE)}"
    return number(p, 2) if p >= SELDOM else f"below {number(SELDOM)}"


def with_unit(value: float, unit: str, digits: int = 3) -> str:
    """A number and its unit, if it has one."""
    return f"{number(value, digits)} {spoken(unit)}".rstrip()


def spoken(unit: str) -> str:
    """A unit as it is written by hand: ``(rad/s)/s`` is rad/s², a plain number has none."""
    if unit in ("", "1", "-"):
        return ""
    unit = re.sub(r"\(([^()/]+)/s\)/s\b", r"\1/s^2", unit)
    return re.sub(r"\^(-?\d+)(?![\d.])", lambda m: m[1].translate(SUPERSCRIPTS), unit.replace("**", "^"))


def labelled(name: str, unit: str) -> str:
    """A name with its unit behind it, if it has one: for an axis."""
    return f"{name}, {spoken(unit)}" if spoken(unit) else name


def digits_worth(value: float, low: float, high: float) -> int:
    """As many significant digits as an interval is worth."""
    width, largest = high - low, max(abs(low), abs(high), abs(value))
    if math.isfinite(width) and 0.0 < width < largest:
        return min(max(3, math.ceil(math.log10(largest / width)) + 1), FINEST)
    return 3


def interval(low: float, high: float, digits: int = 3) -> str:
    """Both ends; in words, since a dash beside a minus sign is misread."""
    return f"{number(low, digits)} to {number(high, digits)}"


def listed(names: Sequence[str], most: int = 0) -> str:
    """``a, b and c``; of more than ``most`` (0: any number) the first, and how many more there are."""
    if most and len(names) > most:
        return f"{', '.join(names[:most])} and {len(names) - most} more"
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def counted(n: int, singular: str, plural: str = "") -> str:
    """``one effect``, ``12 effects``."""
    return f"{count(n)} {singular if n == 1 else plural or singular + 's'}"


def count(n: int) -> str:
    """Small numbers in letters."""
    return COUNTS[n] if n < len(COUNTS) else str(n)


def sentence(text: str, names: Collection[str] = ()) -> str:
    """With a capital and a full stop; one of ``names``, and what is no word, stays as it is at the beginning."""
    first = re.split(r"[\s,;:]", text, maxsplit=1)[0]
    plain = first.replace("-", "").isalpha() and first not in names
    return typeset(text[:1].upper() + text[1:] if plain else text).rstrip(".") + "."


def typeset(text: str) -> str:
    """True minus and comparison signs, where ASCII stands for them; hyphens in names stay."""
    return re.sub(r"(?<![\w.])-(?=[\d\s])", "−", text).replace("<=", "≤")


def time_unit(duration_s: float) -> tuple[float, str]:
    """Seconds in the unit that suits a recording of that length, and the unit."""
    return (86400.0, "d") if duration_s > 2e5 else (3600.0, "h") if duration_s > 10800.0 else (1.0, "s")
