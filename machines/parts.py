"""What a machine is described by: its health, what its sensors read, the lags behind its states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Health:
    """A parameter that changes while the machine lives. Its bounds, healthy value and scale are the plant's variable's.

    Attributes:
        name: of a parameter of both simulators.
        start: where it is at a recording's beginning, from a fresh to a worn machine, in its unit.
        life: between which values it moves, likewise; as ``start`` if left out.
        either_way: it wears to either side (a bias). Errors are then a share of half its life.
        exponential: its coordinate is its logarithm; else it is logistic between its bounds.
        on_readings: it acts on what a sensor reads, and not on the machine.
        walk: what it wanders by in the square root of a second, in its unit.
        counterfactual: lowest and highest value that networks are shown, in its unit.
        farthest: value beyond which no filter takes it, in its unit; a worn machine twice over if left out.
    """

    name: str
    start: tuple[float, float]
    life: tuple[float, float] = (np.nan, np.nan)
    either_way: bool = False
    exponential: bool = False
    on_readings: bool = False
    walk: float = 0.0
    counterfactual: tuple[float, float] = (np.nan, np.nan)
    farthest: float = np.nan

    @property
    def ends(self) -> tuple[float, float]:
        """Fresh and worn end of its life, in its unit."""
        return self.start if np.isnan(self.life[0]) else self.life

    @property
    def span(self) -> float:
        """How far it moves over a life, in its unit; errors in per cent of a life refer to it."""
        fresh, worn = self.ends
        return abs(worn - fresh) / (2.0 if self.either_way else 1.0)


@dataclass(frozen=True)
class Reading:
    """What an output reads: ``gain * state + bias``.

    Attributes:
        output: its name.
        state: an estimated state, or a lag.
        gain: in the output's unit per unit of the state.
        bias: the health parameter that is added, if any.
        key: short, in the names of scores: ``p_nrmse_pct``; the output's name if left out.
        says: what the machine's quantity is, for tables; the state's name if left out.
        reads: what the reading is, likewise; the output's name if left out.
        zero: where errors in per cent of the value count from, in the state's unit (273.15 for kelvin).
        size: what errors are a share of, in the state's unit; the value's mean if 0. A quantity that goes through zero
            needs it.
    """

    output: str
    state: str
    gain: float = 1.0
    bias: str = ""
    key: str = ""
    says: str = ""
    reads: str = ""
    zero: float = 0.0
    size: float = 0.0

    def __post_init__(self) -> None:
        for part, default in (("key", self.output), ("says", self.state), ("reads", self.output)):
            object.__setattr__(self, part, getattr(self, part) or default)


@dataclass(frozen=True)
class Lag:
    """A state of the simulators that follows an estimated one (a probe) or an input (an actuator) by a first-order lag.

    Attributes:
        state: its name.
        follows: the estimated state or the input.
        tau_s: the simulators' parameter that is its time constant.
        faster_with: an estimated state above zero with which it gets faster, if any.
        exponent: the simulators' parameter by which it does: the time constant is ``tau_s * state ** -exponent``.
    """

    state: str
    follows: str
    tau_s: str
    faster_with: str = ""
    exponent: str = ""
