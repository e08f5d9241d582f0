"""Why simulator and recordings differ, drawn: the fit before and after, where the mismatch lives, what explains it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

from matplotlib.figure import Figure

from twinbench.common.page import Drawing
from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.findings import Finding
from twinbench.mismatch.report.figure_fit import fit_over_time
from twinbench.mismatch.report.figure_history import sizes_over_time
from twinbench.mismatch.report.figure_rank import evidence, ports
from twinbench.mismatch.report.figure_where import over_regime, over_time
from twinbench.mismatch.report.replays import Replay, most_telling, replays
from twinbench.mismatch.verdict import Verdict
from twinbench.physics.simulator import Array, Port

NOTHING_TO_LOCATE = "nothing was found, so there is nothing to locate"


def draw(verdict: Verdict) -> Iterator[Drawing]:
    """All figures of a verdict, one at a time; held-out recordings first."""
    shown, sd = replays(verdict.diagnosis), verdict.diagnosis.noise_sd
    yield from _fits(verdict.diagnosis, shown, sd)
    yield from _where(verdict, shown, sd)
    yield _histories(verdict.findings)
    yield _evidence(verdict.diagnosis)


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
            _fit_caption(replay, len(some), {s.recording for s in d.spikes}),
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
            f"Top: the force at {located.port} that would explain the recordings best, whatever makes it, per "
            "recording that was learnt from. Bottom: e"
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
    shares = _ports(verdict.findings)
    yield _drawn(
        "where_by_port",
        "At which port",
        "Probability of the names that act there, in the place of each finding. Each of several findings has a port, "
        "so the bars may sum to more than 100 %. Below 1 %: not shown.",
        partial(ports, shares) if shares else None,
        NOTHING_TO_LOCATE,
    )


def _ports(findings: Sequence[Finding]) -> list[tuple[Port, float]]:
    """The likeliest first; findings at one port add up."""
    found: dict[Port, float] = {}
    for port, p in (pair for f in findings for pair in f.ports):
        found[port] = min(found.get(port, 0.0) + p, 1.0)
    return sorted(found.items(), key=lambda item: -item[1])


def _histories(findings: Sequence[Finding]) -> Drawing:
    told = [f for f in findings if f.history]
    return _drawn(
        "sizes_over_time",
        "How large over time",
        "Size of each effect, named or what explains best, in the recordings that were learnt from, with its 90 % "
        "interval: constant, growing, leaping and wandering counted in, each by its probability. Thin lines part "
        "recordings.",
        partial(sizes_over_time, told) if told else None,
        "no effect explains anything, so none has a size",
    )


def _evidence(d: Diagnosis) -> Drawing:
    return _drawn(
        "hypotheses",
        "Hypotheses weighed",
        "By their evidence over nothing, in nats. At the dotted line one is twenty times less likely than the "
        "likeliest; the plainest beyond it is chosen.",
        partial(evidence, d) if len(d.answer.naming.hypotheses) > 1 else None,
        "nothing in the catalogue was likely enough to be weighed against nothing",
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


def _fit_caption(replay: Replay, count: int, with_spikes: set[str]) -> str:
    of = f", the most telling of {count} recordings" if count > 1 else ""
    after = "before and after what was found is added" if replay.after is not None else "calibrated; nothing was added"
    crosses = " A cross is a reading that was taken out as a spike, at the edge where it lies beyond."
    return (
        f"Recording {replay.track.name}{of}. Measured and simulated open loop, {after}. Left: the whole "
        "recording; right: the shaded window, where "
        + ("the two differ most" if replay.after is not None else "the error is largest")
        + ". Beneath each: measured minus simulated, with twice the noise in grey."
        + (crosses if replay.track.name in with_spikes else "")
    )
