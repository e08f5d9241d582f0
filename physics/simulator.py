"""One description of any lumped machine: its variables, its equations, what they may leave out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Equation = Callable[[Array, Array, Array], Array]
"""``f(x, u, theta)`` in plain scalar NumPy style, so that numba can compile it.

x (nx,), u (nu,) and theta (np,) are states, inputs and parameters in the order and the units of their Variables.
"""


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
class Mechanism:
    """Physics that a model can leave out.

    It acts in one of four ways, told by ``port``, ``term`` and ``series``:

    - ``balance:STATE``, ``output:NAME`` or ``input:NAME`` with a ``term``: added there;
    - ``flux:NAME`` with a ``term``: added to a flux that several balances share;
    - ``output:NAME`` or ``input:NAME`` with a ``series``: a fault of that sensor, which needs its
      whole record (a delay, a stuck reading);
    - any port with neither: the parameters are amplitudes inside the simulator's own
      equations, ``absent`` when the mechanism is switched off.

    Attributes:
        name: as commands and reports call it.
        says: what it is, in one sentence.
        port: where it acts, as above.
        parameters: for a term or series its own, appended to the simulator's; for amplitudes those
            of the simulator by name. The first is the size, others shape it (a threshold, an
            exponent, a time constant). ``nominal`` is the typical value when the mechanism is present.
        absent: the values that switch it off, in the order and the units of ``parameters``; for a term or
            series that of the first parameter alone, 0 if left out.
        states: the mechanism's own states (a lag, a second thermal mass), appended.
        term: ``term(x, u, theta) -> float``, in the unit of what it is added to, per second at a balance. x (nx,) and
            theta (np,) are the whole vectors, the mechanism's own entries last; u is (nu,). Each entry is in the
            unit of its Variable.
        derivative: ``derivative(x, u, theta) -> (n_own_states,)``, needed if ``states``: their rates of change, each
            in its state's unit per second.
        initial: ``initial(x0, u0, theta) -> (n_own_states,)``: where they start, each in its unit, if not at their
            nominal values. x0 and theta as for the term, its own states still nominal.
        series: ``series(time_s, values, theta) -> values``. time_s (N,) is in seconds, values (N,) in the
            channel's unit, theta (n_own,) holds its own parameters in their units. At an output it gives what the
            sensor makes of the clean reading, at an input what the machine got where ``values`` were recorded.
        formula: the term for people, its parameters in braces: ``"-{b_Nms} omega"``.
        kind: "physics", "sensor" or "input": what is to blame.
        contains: the name of a simpler mechanism that this one can become.
    """

    name: str
    says: str
    port: str
    parameters: tuple[Variable, ...]
    absent: tuple[float, ...] = ()
    states: tuple[Variable, ...] = ()
    term: Callable[[Array, Array, Array], float] | None = None
    derivative: Equation | None = None
    initial: Equation | None = None
    series: Callable[[Array, Array, Array], Array] | None = None
    formula: str = ""
    kind: str = "physics"
    contains: str = ""


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

    def __post_init__(self) -> None:
        if (self.flux is None) != (self.balance is None):
            raise ValueError(f"simulator {self.name!r}: give both flux and balance, or neither")
        if self.rhs is None and self.flux is None:
            raise ValueError(f"simulator {self.name!r}: give rhs, or flux and balance")
        for kind in ("states", "inputs", "outputs", "parameters"):
            names = [v.name for v in getattr(self, kind)]
            twice = {n for n in names if names.count(n) > 1}
            if twice:
                raise ValueError(f"simulator {self.name!r}: {kind} named twice: {sorted(twice)}")
        for name in (*self.calibrate, *self.drifts):
            self.index(name)

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
