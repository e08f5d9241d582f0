"""Sequences in lockstep: what the estimators are trained on, run on and scored against."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine


@dataclass(frozen=True)
class Truth:
    """What only a simulation knows. B sequences of N samples each.

    Attributes:
        states: (B, N, nx) in the states' units: all of the plant's, the estimated ones first.
        health: (B, N, nh) in the parameters' units.
        outputs: (B, N, ny) in the channels' units, the sensors' clean readings: probe lag and bias in, noise out.
        inputs: (B, N, nu) in the channels' units, what really acted on the machine.
        machine: what they are of; in a batch that of the batch.
    """

    states: Array
    health: Array
    outputs: Array
    inputs: Array
    machine: Machine = field(default=COMPRESSOR, kw_only=True)

    @property
    def estimated(self) -> Array:
        """(B, N, n + nh) in the quantities' units: the estimated states and the health, in the machine's order."""
        return np.concatenate([self.states[..., : len(self.machine.estimated)], self.health], axis=-1)


@dataclass(frozen=True)
class Batch:
    """B recordings of one machine, N samples each, in lockstep.

    Attributes:
        names: B sequence names.
        time_s: (N,) seconds, shared by all sequences.
        measured: (B, N, nu + ny) in the channels' units, inputs first; NaN means missing.
        truth: what a simulation knows; None wherever an estimator is judged.
        machine: what they are of.
    """

    names: tuple[str, ...]
    time_s: Array
    measured: Array
    truth: Truth | None = None
    machine: Machine = COMPRESSOR

    def __post_init__(self) -> None:
        if self.truth is not None and self.truth.machine is not self.machine:
            object.__setattr__(self, "truth", replace(self.truth, machine=self.machine))

    def __len__(self) -> int:
        return len(self.names)

    def without_truth(self) -> Batch:
        """The same recordings as an estimator may see them."""
        return replace(self, truth=None)

    def select(self, sequences: slice | list[int], samples: slice = slice(None)) -> Batch:
        """Some sequences, some samples; views where numpy allows."""
        truth = self.truth and Truth(
            *(
                part[sequences][:, samples]
                for part in (self.truth.states, self.truth.health, self.truth.outputs, self.truth.inputs)
            )
        )
        return Batch(
            tuple(self.names[i] for i in np.arange(len(self))[sequences]),
            self.time_s[samples],
            self.measured[sequences][:, samples],
            truth,
            self.machine,
        )
