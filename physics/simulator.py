"""One description of any lumped machine: its variables, its equations, what they may leave out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Equation = Callable[[Array, Array, Array], Array]
"""``f(x, u, theta)`` in plain scalar NumPy style, so that numba can compile it."""


@dataclass(frozen=True)
class Variable:
    """A state, input, output or parameter. ``scale`` is a typical size of change, in ``unit``.

    Left out, the scale is a sixth of the range, or a fifth of the nominal value where a bound is infinite.
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
        parameters: for a term or series its own, appended to the simulator's; for amplitudes those
            of the simulator by name. The first is the size, others shape it (a threshold, an
            exponent, a time constant). ``nominal`` is the typical value when the mechanism is present.
        absent: the values that switch it off, in the order of ``parameters``; for a term or series
            that of the first parameter alone, 0 if left out.
        states: the mechanism's own states (a lag, a second thermal mass), appended.
        term: ``term(x, u, theta) -> float``; x and theta are the whole vectors, the mechanism's own
            entries last.
        derivative: ``derivative(x, u, theta) -> (n_own_states,)``, needed if ``states``.
        initial: ``initial(x0, u0, theta) -> (n_own_states,)``: where they start, if not at their nominal
            values. x0 and theta as for the term, its own states still nominal.
        series: ``series(time_s, values, theta) -> values``, all (N,) but its own theta; at an output
            what the sensor makes of the clean reading, at an input what the machine got where
            ``values`` were recorded.
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
        rhs: ``rhs(x, u, theta) -> dx/dt``, shapes (nx,), (nu,), (np,) -> (nx,).
        output: ``output(x, u, theta) -> y``, the sensors' noise-free readings, (ny,).
        initial: ``initial(u0, y0, theta) -> x0`` from the first inputs and readings.
        fluxes, flux, balance: optionally the same rhs in two steps, ``flux(x, u, theta) -> f`` and
            ``balance(x, u, theta, f) -> dx``, so that a mechanism can act on a shared flux. ``rhs``
            is then made from them and may be left out.
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
        """The parameters' nominal values, (np,)."""
        return np.array([v.nominal for v in self.parameters])

    def index(self, parameter: str) -> int:
        """Where a parameter stands in theta."""
        return index_of(self.parameters, parameter, f"simulator {self.name!r} has no parameter")

    def with_values(self, **values: float) -> Simulator:
        """The same machine with other nominal parameter values."""
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
