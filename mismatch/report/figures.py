"""Why simulator and recordings differ, drawn: the fit before and after, where the mismatch lives, what explains it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

from matplotlib.figure import Figure

from twinbench.common.page import Drawing
from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.report.figure_fit import fit_over_time
from twinbench.mismatch.report.figure_rank import explanations, ports
from twinbench.mismatch.report.figure_where import over_regime, over_time
from twinbench.mismatch.report.replays import Replay, deviation, most_telling, replays
from twinbench.mismatch.verdict import Verdict
from twinbench.physics.simulator import Array

NOTHING_TO_LOCATE = "the residual is noise, so there is nothing to locate"


def draw(verdict: Verdict) -> Iterator[Drawing]:
    """All figures of a verdict, one at a time; held-out recordings first."""
    shown, sd = replays(verdict.diagnosis), deviation(verdict.diagnosis)
    yield from _fits(verdict.diagnosis, shown, sd)
    yield from _where(verdict, shown, sd)
    yield _explanations(verdict.diagnosis)


def _fits(d: Diagnosis, shown: Sequence[Replay], sd: Array) -> Iterator[Drawing]:
    """Before and after, on what was held out and where it learnt.

    Args:
        sd: (ny,) of the noise, in the outputs' units.
    """
    for name, held_out in (("fit_held_out", True), ("fit_learnt", False)):
        title = "Before and after, " + ("held out" if held_out else "on the recordings fitted")
        some = [r for r in shown if r.held_out == held_out]
        if not some:
            yield Drawing(name, "Held-out recordings.", None, "no recording was held out", title)
            continue
        replay, channels = most_telling(some, sd)
        yield _drawn(
            name,
            title,
            _fit_caption(replay, len(some), d.weighed_on_held_out, {s.recording for s in d.spikes}),
            partial(fit_over_time, replay, channels, d.simulator.outputs, sd, d.spikes) if channels else None,
            "no output was measured in it",
        )


def _where(verdict: Verdict, shown: Sequence[Replay], sd: Array) -> Iterator[Drawing]:
    """When, in which regime and at which port the two differ."""
    d, located = verdict.diagnosis, verdict.located
    yield _drawn(
        "where_in_time",
        "When",
        (
            f"Top: the free force at {located.ports[0][0]} that would explain the recordings best, per recording that "
            "was learnt from. Bottom: e"
            if located
            else "E"
        )
        + "rror of all outputs in units of the noise; at the thin line nothing but noise is left."
        + (" Dotted: when it began." if any(f.since_s is not None for f in verdict.findings) else ""),
        partial(over_time, [r for r in shown if not r.held_out], verdict, sd),
    )
    yield _drawn(
        "where_in_regime",
        "In which regime",
        "Error of all outputs in all recordings, in units of the noise, over what drives the machine: one point per "
        "equal share of the time."
        + (" Dotted: the bounds of the regime that is named above." if any(f.regime for f in verdict.findings) else ""),
        partial(over_regime, shown, verdict, sd) if d.simulator.inputs else None,
        "the simulator has no inputs",
    )
    yield _drawn(
        "where_by_port",
        "At which port",
        (
            "Weight of the explanations that have an effect there, among all that were fitted. Each of several effects "
            "has a port, so the bars may sum to more than 100 %."
            if d.chosen is not None
            else "Probability that the difference enters there, from how much a free force at each port alone would "
            "explain."
        )
        + " Below 1 %: not shown.",
        partial(ports, located.ports) if located else None,
        NOTHING_TO_LOCATE,
    )


def _explanations(d: Diagnosis) -> Drawing:
    return _drawn(
        "explanations",
        "Explanations fitted in full",
        "By what they gain over the calibrated simulator (twice the log-likelihood). The tick is what noise alone "
        "could gain with as many effects: an explanation has to pass it. Those that only add to the accepted one "
        "are in the table alone.",
        partial(explanations, d) if d.fitted or d.best else None,
        "no candidate promised enough to be fitted",
    )


def _drawn(name: str, title: str, caption: str, figure: Callable[[], Figure] | None, missing: str = "") -> Drawing:
    """A figure, or why there is none: one that fails must not take the others, nor the page, with it."""
    if figure is None:
        return Drawing(name, caption, None, missing, title)
    try:
        return Drawing(name, caption, figure(), "", title)
    except Exception as error:
        return Drawing(name, caption, None, failed(error), title)


def failed(error: Exception) -> str:
    """Why a figure is not there, in one line."""
    return f"drawing it failed, {type(error).__name__}: {' '.join(str(error).split())}"


def _fit_caption(replay: Replay, count: int, compared: int, with_spikes: set[str]) -> str:
    of = f", the most telling of {count} recordings" if count > 1 else ""
    used = f" {compared} explanations were compared on it." if replay.held_out and compared else ""
    after = "before and after what was found is added" if replay.after is not None else "calibrated; nothing was added"
    crosses = " A cross is a reading that was taken out as a spike, at the edge where it lies beyond."
    return (
        f"Recording {replay.track.name}{of}.{used} Measured and simulated open loop, {after}. Left: the whole "
        "recording; right: the shaded window, where "
        + ("the two differ most" if replay.after is not None else "the error is largest")
        + ". Beneath each: measured minus simulated, with twice the error on the recordings fitted in grey."
        + (crosses if replay.track.name in with_spikes else "")
    )
