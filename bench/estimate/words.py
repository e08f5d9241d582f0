"""What an estimate rests on, in plain lines for a terminal."""

from __future__ import annotations

from twinbench.bench.estimate.quality import USABLE, ChannelUse, Quality
from twinbench.data.units import short_unit

SMALL = 0.001
"""A share of less is not worth a word."""


def told(name: str, quality: Quality) -> list[str]:
    """The verdict, a line for each channel, and the rest."""
    table: list[tuple[str, ...]] = [("channel", "offered", "used", "outside training", "training range")]
    table += [_row(channel, use) for channel, use in quality.channels.items()]
    widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
    lines = ["  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in table]
    return [verdict_line(name, quality), *lines, f"  {_nis(quality)}", f"  {_gaps(quality)}", f"  {_flags(quality)}"]


def verdict_line(name: str, quality: Quality) -> str:
    """The verdict in one line."""
    if quality.verdict == USABLE:
        return f"{name}: usable"
    return f"{name}: {quality.verdict}: {quality.because}"


def _row(channel: str, use: ChannelUse) -> tuple[str, ...]:
    return (
        channel,
        _percent(use.offered),
        "not told" if use.accepted is None and use.offered else _percent(use.accepted or 0.0),
        _percent(use.outside),
        f"{use.trained_low:.4g} to {use.trained_high:.4g} {short_unit(use.unit)}",
    )


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _nis(quality: Quality) -> str:
    if quality.nis_median is None:
        return "median NIS: none, this estimator does not tell it or used nothing"
    says = f"median NIS {quality.nis_median:.3g} times its chi-square's median"
    if quality.nis_low is None:
        return f"{says}; what is expected is not known from so few validation recordings"
    says += f", expected {quality.nis_low:.3g} to {quality.nis_high:.3g}"
    if quality.nis_median < quality.nis_low:
        says += "; less than expected, as of smoothed or interpolated readings, which make intervals too narrow"
    return says


def _gaps(quality: Quality) -> str:
    if not quality.gaps:
        return "gaps in all channels at once: none"
    return (
        f"gaps in all channels at once: {quality.gaps}, the longest {quality.longest_gap_s:.4g} s, "
        f"{quality.gaps_s:.4g} s in all"
    )


def _flags(quality: Quality) -> str:
    raised = [f"{name} {_percent(share)}" for name, share in quality.flags.items() if share >= SMALL]
    return f"flags, share of the time: {', '.join(raised) or 'none'}"
