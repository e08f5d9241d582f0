"""What an effect or a fault of some size does to the readings of a machine that has nothing else."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from twinbench.physics.simulator import Array
from twinbench.proof.concealed.faults import faulty, first_size, parts, span_of
from twinbench.proof.concealed.machine import Effect, Machine, clock
from twinbench.proof.concealed.severity import Take, Yardstick


class Change(NamedTuple):
    """A change by its size.

    Attributes:
        start, most: a size to start from, and the largest that makes sense, both in the effect's unit.
        of: ``of(size)`` gives the readings of every take, (N, ny) each.
    """

    start: float
    most: float
    of: Callable[[float], Sequence[Array]]


def change_of(yardstick: Yardstick, effect: Effect, onset_s: float = -float("inf")) -> Change:
    """How an effect changes the yardstick's machine; from ``onset_s`` on where it is no fault."""
    return _by_parameter(yardstick, effect, onset_s) if effect.slot else _by_fault(yardstick, effect)


def with_fault(
    machine: Machine, take: Take, series: Array, port: str, fault: tuple[str, float], span: tuple[float, float]
) -> Array:
    """A take's inputs or outputs with a fault in one of their channels.

    Args:
        series: (N, channels) of the port's side, in the channels' units.
        port: "input:..." or "output:...".
        fault: its kind and size.
        span: lowest and highest value of the channel over all recordings.
    """
    side, _, channel = port.partition(":")
    column = (machine.inputs if side == "input" else machine.outputs).index(channel)
    time_s = take.start_s + clock(len(series) * machine.period_s, machine.period_s)
    last = take.name == f"train_{len(machine.seconds['train'])}"
    changed = series.copy()
    changed[:, column] = faulty(*fault, time_s, series[:, column], span, last)
    return changed


def _by_parameter(yardstick: Yardstick, effect: Effect, onset_s: float) -> Change:
    def of(amplitude: float) -> Sequence[Array]:
        moved = yardstick.p.copy()
        moved[yardstick.machine.at(effect.slot)] = amplitude
        return yardstick.with_parameters(moved, onset_s)

    return Change(effect.typical, effect.most, of)


def _by_fault(yardstick: Yardstick, effect: Effect) -> Change:
    kind, channel = parts(effect)
    start, most = first_size(
        kind, yardstick.machine.noise[channel].sigma, _clean(yardstick, effect)[1], yardstick.machine.period_s
    )

    def of(size: float) -> Sequence[Array]:
        made = series_with_fault(yardstick, effect, size)
        return yardstick.with_inputs(made) if channel in yardstick.machine.inputs else made

    return Change(start, most, of)


def series_with_fault(yardstick: Yardstick, effect: Effect, size: float) -> list[Array]:
    """The inputs or outputs of every take, (N, channels) each, as a fault makes them.

    Args:
        size: in the fault's unit.
    """
    series, span = _clean(yardstick, effect)
    fault = (parts(effect)[0], size)
    pairs = zip(yardstick.takes, series, strict=True)
    return [with_fault(yardstick.machine, take, s, effect.ports[0], fault, span) for take, s in pairs]


def _clean(yardstick: Yardstick, effect: Effect) -> tuple[Sequence[Array], tuple[float, float]]:
    """The series (N, channels) that a fault is put into, and the span of its channel."""
    machine, channel = yardstick.machine, parts(effect)[1]
    at_input = channel in machine.inputs
    column = (machine.inputs if at_input else machine.outputs).index(channel)
    series = [t.u for t in yardstick.takes] if at_input else yardstick.base
    return series, span_of([s[:, column] for s in series])
