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
    """How an effect or a fault changes the yardstick's machine, from ``onset_s`` on."""
    return (_by_parameter if effect.slot else _by_fault)(yardstick, effect, onset_s)


def with_fault(
    machine: Machine,
    take: Take,
    series: Array,
    port: str,
    fault: tuple[str, float],
    span: tuple[float, float],
    onset_s: float = -float("inf"),
) -> Array:
    """A take's inputs or outputs with a fault in one of their channels.

    Args:
        series: (N, channels) of the port's side, in the channels' units.
        port: "input:..." or "output:...".
        fault: its kind and size.
        span: lowest and highest value of the channel in training.
        onset_s: it is there from here on, on the suite's clock.
    """
    side, _, channel = port.partition(":")
    column = (machine.inputs if side == "input" else machine.outputs).index(channel)
    time_s = take.start_s + clock(len(series) * machine.period_s, machine.period_s)
    last = take.name == f"train_{len(machine.seconds['train'])}"
    changed = series.copy()
    there = time_s >= onset_s
    changed[there, column] = faulty(*fault, time_s, series[:, column], span, last)[there]
    return changed


def _by_parameter(yardstick: Yardstick, effect: Effect, onset_s: float) -> Change:
    def of(amplitude: float) -> Sequence[Array]:
        moved = yardstick.p.copy()
        moved[yardstick.machine.at(effect.slot)] = amplitude
        return yardstick.with_parameters(moved, onset_s)

    return Change(effect.typical, effect.most, of)


def _by_fault(yardstick: Yardstick, effect: Effect, onset_s: float) -> Change:
    kind, channel = parts(effect)
    machine, span = yardstick.machine, span_in_training(yardstick, effect)
    start, most = first_size(kind, machine.noise[channel].sigma, span, machine.period_s)

    def of(size: float) -> Sequence[Array]:
        made = series_with_fault(yardstick, effect, size, onset_s)
        return yardstick.with_inputs(made) if channel in yardstick.machine.inputs else made

    return Change(start, most, of)


def series_with_fault(yardstick: Yardstick, effect: Effect, size: float, onset_s: float = -float("inf")) -> list[Array]:
    """The inputs or outputs of every take, (N, channels) each, as a fault makes them from ``onset_s`` on.

    Args:
        size: in the fault's unit.
    """
    fault, span = (parts(effect)[0], size), span_in_training(yardstick, effect)
    pairs = zip(yardstick.takes, _clean(yardstick, effect)[0], strict=True)
    return [with_fault(yardstick.machine, take, s, effect.ports[0], fault, span, onset_s) for take, s in pairs]


def span_in_training(yardstick: Yardstick, effect: Effect) -> tuple[float, float]:
    """Lowest and highest value of a fault's channel where the engine learns: what saturates must do so there."""
    series, column = _clean(yardstick, effect)
    pairs = zip(yardstick.takes, series, strict=True)
    return span_of([s[:, column] for take, s in pairs if not take.held_out])


def _clean(yardstick: Yardstick, effect: Effect) -> tuple[Sequence[Array], int]:
    """The series (N, channels) that a fault is put into, and in which of the channels."""
    machine, channel = yardstick.machine, parts(effect)[1]
    if channel in machine.inputs:
        return [take.u for take in yardstick.takes], machine.inputs.index(channel)
    return yardstick.base, machine.outputs.index(channel)
