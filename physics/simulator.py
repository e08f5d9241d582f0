"""One description of any lumped machine: its variables, its equations, what they may leave out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Equation = Callable[[Array, Array, Array], Array]
"""``f(x, u, theta)`` in plain scalar NumPy style, so that numba can compile it.

x (nx,), u (nu,) and theta (np,) are states, inputs and parameters in the order and the units of their Variables.
"""
Run = Callable[[Array, Array, Array, Array], Array]
"""``f(u, seconds, x0, theta)``: a whole run, of a machine that can only be stepped.

u (S, nu) holds over stretches of so many seconds (S,); x0 (nx,) is where it starts. It returns readings and states
(S, ny + nx) at the begin of each stretch, under its inputs; NaN from where the machine cannot go on.
"""
PLACES = ("balance", "flux", "output", "input")
"""What a mechanism can act on: a state's rate, a flux that several balances share, a reading, an input."""


@dataclass(frozen=True)
class Variable:
    """A state, input, output or parameter.

    Attributes:
        name: as recordings, mechanisms and reports call it.
        unit: in which all numbers about it are; "1" or nothing if it is dimensionless.
        low: its lower bound, in ``unit``; may be infinite.
        high: its upper bound, in ``unit``; may be infinite.
        nominal: where it usually is, in ``unit``.
        scale: a typical size of change, in ``unit``. Left out, it is a sixth of the range, or a fifth of the nominal
            value where a bound is infinite.
        says: what it is, in words.
    """

    name: str
    unit: str
    low: float
    high: float
    nominal: float
    scale: float = 0.0
    says: str = ""

    def __post_init__(self) -> None:
        if not self.scale:
            span = self.high - self.low
            default = span / 6.0 if math.isfinite(span) and span > 0.0 else abs(self.nominal) / 5.0
            object.__setattr__(self, "scale", default or 1.0)
        if not self.low <= self.nominal <= self.high:
            raise ValueError(f"variable {self.name!r}: nominal {self.nominal} is outside [{self.low}, {self.high}]")


@dataclass(frozen=True)
class Port:
    """Where something acts on a simulator: a place of one of four kinds, and the variable that is there.

    It reads ``balance:STATE``, ``flux:NAME``, ``output:NAME`` or ``input:NAME``.

    Raises:
        ValueError: one line; there is no such place, or no variable is named.
    """

    place: str
    variable: str

    def __post_init__(self) -> None:
        if self.place not in PLACES or not self.variable:
            raise ValueError(
                f"port {str(self).rstrip(':')!r} must read {', '.join(f'{place}:NAME' for place in PLACES)}"
            )

    @classmethod
    def parse(cls, text: str) -> Port:
        """The port that reads so."""
        place, _, variable = text.partition(":")
        return cls(place, variable)

    def __str__(self) -> str:
        return f"{self.place}:{self.variable}"

    def index(self, simulator: Simulator) -> int:
        """Where its variable stands among those of its place.

        Raises:
            ValueError: the simulator has no such variable.
        """
        complaint = f"simulator {simulator.name!r} has no {self.place}"
        return index_of(_variables_at(simulator, self.place), self.variable, complaint)

    def variable_of(self, simulator: Simulator) -> Variable:
        """The simulator's variable that is there; at a balance the state."""
        return _variables_at(simulator, self.place)[self.index(simulator)]


@dataclass(frozen=True, init=False)
class Mechanism:
    """What a model can leave out: a ``Term``, an ``Amplitude`` or a ``Series``. It is never built itself.

    Attributes:
        name: as verdicts, tables and files call it.
        says: what it is, in words.
        port: where it acts; given as the text that ``Port`` describes, or as a ``Port``.
        parameters: the first is the size, others shape it (a threshold, an exponent, a time constant). ``nominal`` is
            the typical value when the mechanism is present.
        absent: the values that switch it off, in the order of ``parameters``. Of a term or series that of the first
            parameter is enough, and 0 if left out.
        formula: the mechanism for people, its parameters in braces: ``"-{b_Nms} omega"``.
        kind: "physics", "sensor" or "input": what is to blame.
        contains: the name of a simpler mechanism that this one can become.
    """

    name: str
    says: str
    port: Port
    parameters: tuple[Variable, ...]
    absent: tuple[float, ...] = ()
    formula: str = field(default="", kw_only=True)
    kind: str = field(default="physics", kw_only=True)
    contains: str = field(default="", kw_only=True)

    def __init__(self, *args: Any, **given: Any) -> None:
        name = given.get("name", args[0] if args else "")
        acts = {"series": "Series", "term": "Term"}
        write = next((kind for what, kind in acts.items() if given.get(what) is not None), "Amplitude")
        raise TypeError(
            f"mechanism {name!r}: write {write}(...) in place of Mechanism(...); a mechanism is a Term, an Amplitude "
            "or a Series"
        )

    def __post_init__(self) -> None:
        who = f"mechanism {self.name!r}"
        if not isinstance(self.port, Port):
            try:
                object.__setattr__(self, "port", Port.parse(str(self.port)))
            except ValueError as error:
                raise ValueError(f"{who}: {error}") from None
        if self.kind not in ("physics", "sensor", "input"):
            raise ValueError(f"{who}: kind is {self.kind!r}, must be physics, sensor or input")
        if not self.parameters:
            raise ValueError(f"{who}: has no parameters; the first is its size")

    @property
    def off(self) -> float:
        """The value of the first parameter that switches it off."""
        return float(self.absent[0]) if self.absent else 0.0

    @property
    def brings(self) -> tuple[Variable, ...]:
        """The variables that the simulator has not by itself: its own states, then its own parameters."""
        return self.parameters


@dataclass(frozen=True)
class Term(Mechanism):
    """A term that is added to a balance, a flux, an output or an input.

    Its parameters and states are appended to the simulator's. A flux may be shared by several balances.

    Attributes:
        term: ``term(x, u, theta) -> float``. x (nx,) and theta (np,) are the simulator's whole vectors, the
            mechanism's own entries last. The term is in the port's units, at a balance in the state's unit per second.
        states: the mechanism's own states (a lag, a second thermal mass).
        derivative: ``derivative(x, u, theta) -> (n_own_states,)``, in those states' units per second; needed if there
            are ``states``.
        initial: ``initial(x0, u0, theta) -> (n_own_states,)``: where they start, in their units, if not at their
            nominal values. x0 and theta are as for the term, its own states still nominal.
        sees_own: the term is called as ``term(x, u, theta, own)``. ``own`` is what the simulator itself has at the
            port: the flux, the state's rate, the input or the reading, in the port's unit.
        into: a second balance. What the term takes from its own balance goes into this one.
        ratio: ``ratio(x, u, theta) -> float``: the second balance gains so much for each unit that the first loses, in
            its unit per unit of the first; needed if there is ``into``.
    """

    term: Callable[..., float] = field(kw_only=True)
    states: tuple[Variable, ...] = field(default=(), kw_only=True)
    derivative: Equation | None = field(default=None, kw_only=True)
    initial: Equation | None = field(default=None, kw_only=True)
    sees_own: bool = field(default=False, kw_only=True)
    into: Port | None = field(default=None, kw_only=True)
    ratio: Callable[[Array, Array, Array], float] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.into is None) != (self.ratio is None):
            raise ValueError(f"mechanism {self.name!r}: into and ratio go together; give both or neither")
        if self.into is not None and (self.into.place, self.port.place) != ("balance", "balance"):
            raise ValueError(f"mechanism {self.name!r}: goes from one balance into another; no other port can")
        if bool(self.states) != (self.derivative is not None):
            raise ValueError(f"mechanism {self.name!r}: states and derivative go together; give both or neither")
        if self.initial is not None and not self.states:
            raise ValueError(f"mechanism {self.name!r}: has initial but no states; give both or leave it out")

    @property
    def brings(self) -> tuple[Variable, ...]:
        return self.states + self.parameters


@dataclass(frozen=True)
class Amplitude(Mechanism):
    """Parameters inside the simulator's own equations, by name; ``absent`` has the value of each that switches it off.

    The port says what it acts on.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.absent) != len(self.parameters):
            raise ValueError(
                f"mechanism {self.name!r}: absent has {len(self.absent)} values for {len(self.parameters)} "
                "parameters; give the value of each that switches it off"
            )

    @property
    def brings(self) -> tuple[Variable, ...]:
        return ()


@dataclass(frozen=True)
class Series(Mechanism):
    """A fault of a sensor or an input, which needs its whole record (a delay, a stuck reading).

    Attributes:
        series: ``series(time_s, values, theta) -> values``. time_s and both values are (N,), theta holds its own
            parameters alone. At an output it gives what the sensor makes of the clean reading, at an input what the
            machine got where ``values`` were recorded. time_s is in seconds, values are in the channel's unit.
    """

    series: Callable[[Array, Array, Array], Array] = field(kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.port.place not in ("output", "input"):
            raise ValueError(
                f"mechanism {self.name!r}: a series acts on an output or an input, not on {str(self.port)!r}"
            )


@dataclass(frozen=True)
class Simulator:
    """A machine as ordinary differential equations.

    Attributes:
        name: as reports and messages call it.
        states: nx of them, in the order of x.
        inputs: nu of them, in the order of u; recordings hold them.
        outputs: ny of them, in the order of y; recordings hold them.
        parameters: np of them, in the order of theta.
        output: ``output(x, u, theta) -> y``, the sensors' noise-free readings, (ny,), in the outputs' units.
        initial: ``initial(u0, y0, theta) -> x0``, the state (nx,) in the states' units, from the first inputs (nu,)
            and readings (ny,) in theirs.
        rhs: ``rhs(x, u, theta) -> dx/dt``, shapes (nx,), (nu,), (np,) -> (nx,), in the states' units per second.
        fluxes: what ``flux`` gives: nf of them, in the order of f.
        flux: optionally the same rhs in two steps, this and ``balance``, so that a mechanism can act on a shared flux:
            ``flux(x, u, theta) -> f``, (nf,), in the fluxes' units. ``rhs`` is then made of the two and may be left
            out.
        balance: ``balance(x, u, theta, f) -> dx/dt``, (nx,), in the states' units per second.
        says: what it is, in words.
        calibrate: parameters that a fit may move; all of them if left out.
        drifts: those of the parameters that may change while the machine runs (its health).
        mechanisms: names of the mechanisms that were switched on.
        reads: pairs of an input and an output, in the same unit: a controller inside the equations reads the output's
            sensor, and the input is that reading. A recording of the output is one of the input too. So a fault of
            the sensor acts on the controller as it did in the machine.
        stepped: a whole run, of a machine that can only be stepped: it tells no rates. Then there is neither rhs nor
            flux, and ``output`` tells the readings of a start state. The states are those that it can start in.
    """

    name: str
    states: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    output: Equation
    initial: Equation
    rhs: Equation | None = None
    fluxes: tuple[Variable, ...] = ()
    flux: Equation | None = None
    balance: Callable[[Array, Array, Array, Array], Array] | None = None
    says: str = ""
    calibrate: tuple[str, ...] = ()
    drifts: tuple[str, ...] = ()
    mechanisms: tuple[str, ...] = ()
    reads: tuple[tuple[str, str], ...] = ()
    stepped: Run | None = None

    def __post_init__(self) -> None:
        if (self.flux is None) != (self.balance is None):
            raise ValueError(f"simulator {self.name!r}: give both flux and balance, or neither")
        if (self.rhs is None and self.flux is None) != (self.stepped is not None):
            raise ValueError(f"simulator {self.name!r}: give rhs, or flux and balance, or stepped alone")
        for kind in ("states", "inputs", "outputs", "parameters"):
            names = [v.name for v in getattr(self, kind)]
            twice = {n for n in names if names.count(n) > 1}
            if twice:
                raise ValueError(f"simulator {self.name!r}: {kind} named twice: {sorted(twice)}")
        for name in (*self.calibrate, *self.drifts):
            self.index(name)
        for into, of in self.reads:
            who = f"simulator {self.name!r}: reads {into!r} of {of!r}, but"
            read = self.inputs[index_of(self.inputs, into, f"{who} has no input")]
            sensor = self.outputs[index_of(self.outputs, of, f"{who} has no output")]
            if read.unit != sensor.unit:
                raise ValueError(f"{who} one is in {read.unit!r} and the other in {sensor.unit!r}; give both one unit")

    def theta(self) -> Array:
        """The parameters' nominal values, (np,), each in its unit."""
        return np.array([v.nominal for v in self.parameters])

    def index(self, parameter: str) -> int:
        """Where a parameter stands in theta.

        Args:
            parameter: its name.

        Raises:
            ValueError: there is none of that name.
        """
        return index_of(self.parameters, parameter, f"simulator {self.name!r} has no parameter")

    def with_values(self, **values: float) -> Simulator:
        """The same machine with other nominal parameter values, by name and in the parameters' units."""
        parameters = list(self.parameters)
        for name, value in values.items():
            i = self.index(name)
            variable = parameters[i]
            parameters[i] = replace(
                variable, nominal=value, low=min(variable.low, value), high=max(variable.high, value)
            )
        return replace(self, parameters=tuple(parameters))


def index_of(variables: tuple[Variable, ...], name: str, complaint: str) -> int:
    names = [v.name for v in variables]
    if name not in names:
        raise ValueError(f"{complaint} {name!r}; it has: {', '.join(names)}")
    return names.index(name)


def _variables_at(simulator: Simulator, place: str) -> tuple[Variable, ...]:
    return {
        "balance": simulator.states,
        "flux": simulator.fluxes,
        "output": simulator.outputs,
        "input": simulator.inputs,
    }[place]
