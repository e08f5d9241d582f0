"""What the suite knows of a concealed machine: its true equations, its twin, how it is run and measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit

from twinbench.physics.simulator import Array
from twinbench.proof.concealed.integrate import Equations, Parameters, Steps, run


@dataclass(frozen=True)
class Noise:
    """A channel's noise in its unit: white and AR(1) parts with their sd, the latter's time constant."""

    white: float
    coloured: float
    tau_s: float

    @property
    def sigma(self) -> float:
        """sd of both together."""
        return float(np.hypot(self.white, self.coloured))


@dataclass(frozen=True)
class Effect:
    """Something that the truth has and the twin has not.

    Attributes:
        name: the catalogue's own for it; any other for physics foreign to every catalogue.
        slot: the truth's parameter that holds its amplitude; 0 is absent.
        typical, most: an amplitude to start from, and the largest that makes sense.
        ports: where it may rightly be located.
        size: the catalogue parameter that its amplitude can be compared with, as
            ``absent + scale * amplitude``; empty where the forms differ too much.
    """

    name: str
    slot: str
    typical: float
    most: float
    ports: tuple[str, ...]
    size: str = ""
    absent: float = 0.0
    scale: float = 1.0

    @property
    def is_stuck(self) -> bool:
        """Is it a channel that sticks? It does in one training recording alone."""
        return "_stuck@" in self.name


@dataclass(frozen=True)
class Machine:
    """A concealed machine.

    Attributes:
        simulator, values: the twin as the engine gets it: where it is, what it is set to.
        calibrate: parameters that the twin may calibrate; the truth has them by the same names.
        parameters: the truth's parameters and their nominal values, in the order of its equations.
        spread, offsets, high: how far a case's parameters lie off: relative, absolute, and an upper limit.
        exponent: range that the effects' exponents are drawn from, where a machine has that parameter.
        ambient: amplitude of the drifting ambient, in the unit of the parameter ``ambient``.
        law, reading, start: the equations, and a state to settle from.
        slow: states (index, size of change) whose start values the twin must find in every recording.
        operate: ``operate(rng, seconds, regime) -> u``, regime "train", "held" or "poor".
        fine, coarse: integration steps per sample, for what is recorded and for what is only scaled.
        seconds: lengths of the recordings.
        rippled: the parameter that the background's ripple multiplies. Its law multiplies it by
            1 + ripple * f, where f is a smooth function of the ripple's arguments with an rms near 0.5.
        ripple_arguments: ``ripple_arguments(x, u) -> (N, d)`` of states x (N, nx) and inputs u (N, nu), scaled so that
            the wave numbers of f are about 1: what a random function of the same smoothness takes.
        network: of a random machine, the description that its twin is made from, plain JSON.
        kind: "tuned" on by the engine's makers, "untuned", or "random".
        played: by input, the parameter that is the full width of its free play; 0 is no play. The law gets what comes
            out behind the play and knows nothing of it.
    """

    name: str
    simulator: str
    values: Mapping[str, float]
    calibrate: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: Mapping[str, float]
    spread: Mapping[str, float]
    law: Any
    reading: Any
    start: Callable[[Array, Array], Array]
    slow: Mapping[int, float]
    operate: Callable[[np.random.Generator, float, str], Array]
    settle_s: float
    period_s: float
    fine: int
    coarse: int
    seconds: Mapping[str, tuple[float, ...]]
    noise: Mapping[str, Noise]
    lsb: Mapping[str, float]
    effects: tuple[Effect, ...]
    foreign: tuple[Effect, ...]
    rippled: str
    ripple_arguments: Callable[[Array, Array], Array]
    kind: str = "tuned"
    network: Mapping[str, Any] = field(default_factory=dict)
    played: Mapping[str, str] = field(default_factory=dict)
    offsets: Mapping[str, float] = field(default_factory=dict)
    high: Mapping[str, float] = field(default_factory=dict)
    exponent: tuple[float, float] = (1.9, 2.1)
    ambient: float = 0.0

    def at(self, parameter: str) -> int:
        """Where a parameter stands in p."""
        return list(self.parameters).index(parameter)

    def p(self, **values: float) -> Array:
        """The truth's parameters (np,), nominal but for ``values``."""
        unknown = set(values) - set(self.parameters)
        if unknown:
            raise ValueError(f"machine {self.name!r} has no parameter {sorted(unknown)}")
        return np.array([values.get(name, nominal) for name, nominal in self.parameters.items()], dtype=float)

    def effect(self, name: str) -> Effect:
        """An effect by its name."""
        return next(e for e in (*self.effects, *self.foreign) if e.name == name)

    def sigma(self) -> Array:
        """Noise sd of the outputs, (ny,)."""
        return np.array([self.noise[name].sigma for name in self.outputs])

    def driven(self, u: Array, p: Parameters, start_s: float) -> Array:
        """What the inputs u (N, nu) come to behind their free play; u itself where there is none.

        Args:
            u: (N, nu) inputs in their units.
            p: the law's own.
            start_s: of the first sample, on the suite's clock.
        """
        if not self.played:
            return u
        late = start_s + clock(len(u) * self.period_s, self.period_s) >= p.onset_s
        through = u.copy()
        for name, slot in self.played.items():
            widths = np.where(late, p.after[self.at(slot)], p.before[self.at(slot)])
            column = self.inputs.index(name)
            through[:, column] = behind_play(np.ascontiguousarray(u[:, column]), widths)
        return through

    @property
    def equations(self) -> Equations:
        """What ``integrate.run`` needs of it."""
        return Equations(self.law, self.reading, len(self.outputs))

    def settled(self, u: Array, p: Array, start_s: float) -> Array:
        """The state (nx,) after ``settle_s`` under the first inputs of u (N, nu) and parameters p (np,).

        Args:
            u: (N, nu) inputs in their units.
            p: (n_parameters,) the law's own, each in its unit.
        """
        held = np.tile(u[0], (round(self.settle_s / self.period_s), 1))
        steps = Steps(start_s - self.settle_s, self.period_s, self.coarse)
        return run(self.equations, steps, held, self.start(u[0], p), Parameters.steady(p))[1]


@njit(cache=True)
def behind_play(values: Array, widths: Array) -> Array:
    """What follows a series (N,) through free play of full widths (N,), centred at first; play 0 changes nothing.

    Args:
        values: (N,) in the channel's unit.
        widths: (N,) in the same unit.
    """
    out = values.copy()
    for k in range(1, len(values)):
        half = 0.5 * widths[k]
        out[k] = min(max(out[k - 1], values[k] - half), values[k] + half)
    return out


def clock(seconds: float, period_s: float) -> Array:
    """Sample instants (N,) from 0."""
    return np.arange(round(seconds / period_s), dtype=np.float64) * period_s


def levels(
    rng: np.random.Generator,
    t: Array,
    limits: tuple[float, float],
    hold_s: tuple[float, float],
    ramp_s: tuple[float, float],
) -> Array:
    """Held levels joined by ramps, at times t (N,); hold times are drawn evenly in their logarithm.

    Args:
        t: (N,) seconds.
        limits: of the levels.
        hold_s: least and most that a level lasts.
        ramp_s: least and most that a ramp does.
    """
    knots = [(0.0, rng.uniform(*limits))]
    while knots[-1][0] < t[-1]:
        leave = knots[-1][0] + float(np.exp(rng.uniform(*np.log(hold_s))))
        knots += [(leave, knots[-1][1]), (leave + rng.uniform(*ramp_s), rng.uniform(*limits))]
    times, values = np.array(knots).T
    return np.interp(t, times, values)
