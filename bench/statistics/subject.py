"""What scores and tables need to know of a machine. It can be written into a run's manifest, so that a report needs no
machine."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine, with_unit

LEADS_S = (1, 10, 60)
"""Of the forecasts that are scored."""


class Followed(NamedTuple):
    """An output and the state behind it: short name, what state and reading are, what errors are a share of."""

    key: str
    says: str
    reads: str
    share_of: str = "its mean value"


class Lived(NamedTuple):
    """A health parameter: name, what tables call it, how far it moves over a life, whether its value is never zero."""

    name: str
    label: str
    span: float
    relative: bool


class Named(NamedTuple):
    """Anything that is estimated or read: name, what tables call it, unit."""

    name: str
    label: str
    unit: str

    @property
    def axis_label(self) -> str:
        """``temperature bias, K``; a dash stands for no unit."""
        return with_unit(self.label, self.unit)


@dataclass(frozen=True)
class Subject:
    """What a run was about.

    Attributes:
        machine: its name.
        says: what it is, in words.
        outputs: what is read, and what is behind it.
        health: the parameters that change over a life.
        quantities: all that is estimated, states first.
        period_s: from tick to tick.
        inputs, readings: the channels of a recording.
    """

    machine: str
    says: str
    outputs: tuple[Followed, ...]
    health: tuple[Lived, ...]
    quantities: tuple[Named, ...]
    period_s: float
    inputs: tuple[Named, ...] = ()
    readings: tuple[Named, ...] = ()

    @functools.cached_property
    def state_errors(self) -> tuple[str, ...]:
        """Names of the errors of the filtered states behind the outputs."""
        return tuple(f"{o.key}_nrmse_pct" for o in self.outputs)

    @functools.cached_property
    def forecast_errors(self) -> tuple[str, ...]:
        """Names of the errors of the readings forecast a minute ahead."""
        return tuple(f"{o.key}_open{LEADS_S[-1]}_pct" for o in self.outputs)

    @functools.cached_property
    def relative(self) -> tuple[int, ...]:
        """Positions of the health parameters whose relative error means something."""
        return tuple(i for i, h in enumerate(self.health) if h.relative)

    @functools.cached_property
    def span(self) -> Array:
        """How far each health parameter moves over a life, (nh,) in their units."""
        return np.array([h.span for h in self.health])

    def to_json(self) -> dict[str, Any]:
        """For a manifest."""
        return asdict(self)

    def kind_and_sensor(self, condition: str) -> tuple[str, str]:
        """What a fault is, and the label of the one sensor that has it; of any other condition its name and nothing."""
        kind, _, channel = condition.rpartition(" ")
        labels = {c.name: c.label for c in (*self.inputs, *self.readings)}
        return (kind, labels[channel]) if channel in labels else (condition, "")

    def condition_label(self, name: str) -> str:
        """``stuck: mass flow`` of a fault of one sensor; any other condition keeps its name."""
        kind, sensor = self.kind_and_sensor(name)
        return f"{kind}: {sensor}" if sensor else kind

    @classmethod
    def from_json(cls, found: Mapping[str, Any]) -> Subject:
        """The inverse of ``to_json``."""
        parts = {"outputs": Followed, "health": Lived, **dict.fromkeys(("quantities", "inputs", "readings"), Named)}
        rows = {part: tuple(kind(*row) for row in found[part]) for part, kind in parts.items()}
        return cls(found["machine"], found["says"], period_s=found["period_s"], **rows)  # type: ignore[arg-type]


def subject_of(machine: Machine) -> Subject:
    """What a run on a machine is about."""

    def named(names: tuple[str, ...]) -> tuple[Named, ...]:
        return tuple(Named(name, machine.label(name), machine.variables[name].unit) for name in names)

    return Subject(
        machine.name,
        machine.says,
        tuple(Followed(r.key, r.says, r.reads, *([f"{r.size:g}"] if r.size else [])) for r in machine.readings),
        tuple(Lived(h.name, machine.label(h.name), h.span, not h.either_way) for h in machine.health),
        named(machine.quantities),
        machine.sample_period_s,
        named(machine.inputs),
        named(machine.outputs),
    )


PAPERS = subject_of(COMPRESSOR)
"""The paper's compressor: what a run is about whose manifest says nothing else."""
