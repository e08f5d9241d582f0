"""Faults of any machine's sensors and inputs, per channel.

A fault of an output is what the sensor makes of the clean reading. A fault of an input is what the
machine really got where another value was recorded: a slow, saturated or stuck actuator looks the
same as a recording that leads, overshoots or moves on its own, so one record stands for both.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twinbench.mismatch.limits import knee, knees, upper_limit
from twinbench.mismatch.place import bracketed
from twinbench.mismatch.reversal import Turned
from twinbench.mismatch.series import delay_reading, delay_steps, held, lag_reading, lag_steps, stuck_from
from twinbench.physics.simulator import Array, Port, Series, Simulator, Variable

Change = Callable[[Array, Array, Array], Array]
"""What a fault makes of a record: ``change(time_s, values, theta)``, times and values (N,), its parameters (p,)."""
_TYPICAL_DRIFT_S = 600.0  # a typical drift moves by one scale in ten minutes


@functools.cache
def faults(simulator: Simulator, sample_period_s: float = 0.05, turned: Turned | None = None) -> tuple[Series, ...]:
    """Bias, gain, lag, delay, drift, saturation, quantisation and a stuck channel, for every output and input.

    All but saturation have one parameter, the size; 0 is none. What saturates keeps a fifth of its excess at most.
    An input may saturate on both sides. Where nothing drives the machine a sensor's delay is a later start, and is left
    out. NaN in the values is held over.

    Args:
        sample_period_s: lags and delays are typically two of them.
        turned: inputs that did not reverse are not said to saturate on both sides; unknown if left out.
    """
    return tuple(
        fault
        for place, variables in (("output", simulator.outputs), ("input", simulator.inputs))
        for v in variables
        for fault in _Channel(
            place, v, sample_period_s, turned is None or v.name in turned.reversed, bool(simulator.inputs)
        ).all()
    )


@dataclass(frozen=True)
class _Channel:
    """A sensor or an input that can be at fault: the words for it, and its faults one by one.

    A sensor's lags and delays are those of readings, an input's those of steps.
    """

    place: str
    variable: Variable
    sample_period_s: float
    turns: bool
    driven: bool

    def all(self) -> tuple[Series, ...]:
        return (
            self._bias(),
            self._gain(),
            self._lag(),
            *([self._delay()] if self.driven else []),
            self._drift(),
            self._saturation(),
            *([self._saturation_both()] if self.place == "input" and self.turns else []),
            self._quantisation(),
            self._stuck(),
        )

    @property
    def name(self) -> str:
        return self.variable.name

    @property
    def span(self) -> float:
        """The width of its range; ten scales where it has none."""
        v = self.variable
        return v.high - v.low if np.isfinite(v.high - v.low) and v.high > v.low else 10.0 * v.scale

    def _size(self, name: str, unit: str, low: float, high: float, typical: float) -> Variable:
        says = f"{name.removesuffix('_s')} of {self.name}"
        return Variable(f"{name}_{self.name}", unit, low, high, typical, typical, says)

    def _fault(
        self, name: str, says: str, formula: str, series: Change, *parameters: Variable, contains: str = ""
    ) -> Series:
        def over_gaps(time_s: Array, values: Array, theta: Array) -> Array:
            return series(time_s, held(np.asarray(values, dtype=np.float64)), theta)

        sensor = self.place == "output"
        kind = "sensor" if sensor else "input"
        who = f"the sensor of {self.name}" if sensor else f"what drives the machine as {self.name}"
        return Series(
            f"{kind}_{name}@{self.name}",
            f"{who} {says}",
            Port(self.place, self.name),
            parameters,
            series=over_gaps,
            formula=formula,
            kind=kind,
            contains=contains,
        )

    def _bias(self) -> Series:
        size = self._size("bias", self.variable.unit, -self.span, self.span, self.variable.scale)
        formula = f"{self.name} + {{bias_{self.name}}}"
        return self._fault("bias", "is off by a constant", formula, lambda t, y, p: y + p[0], size)

    def _gain(self) -> Series:
        size = self._size("gain", "1", -0.5, 0.5, 0.05)
        formula = f"(1 + {{gain_{self.name}}}) {self.name}"
        return self._fault("gain", "is off in proportion", formula, lambda t, y, p: (1.0 + p[0]) * y, size)

    def _lag(self) -> Series:
        lag = lag_reading if self.place == "output" else lag_steps
        size = self._size("lag_s", "s", 0.0, 500.0 * self.sample_period_s, 2.0 * self.sample_period_s)
        formula = f"first-order lag of {self.name} by {{lag_s_{self.name}}}"
        return self._fault("lag", "follows late, as a first-order lag", formula, lambda t, y, p: lag(t, y, p[0]), size)

    def _delay(self) -> Series:
        delay = delay_reading if self.place == "output" else delay_steps
        size = self._size("delay_s", "s", 0.0, 200.0 * self.sample_period_s, 2.0 * self.sample_period_s)
        formula = f"{self.name}(t - {{delay_s_{self.name}}})"
        return self._fault("delay", "comes late by a fixed time", formula, lambda t, y, p: delay(t, y, p[0]), size)

    def _drift(self) -> Series:
        most, typical = self.span / _TYPICAL_DRIFT_S, self.variable.scale / _TYPICAL_DRIFT_S
        size = self._size("drift", f"{bracketed(self.variable.unit)}/s", -most, most, typical)
        formula = f"{self.name} + {{drift_{self.name}}} (t - t_0)"
        says = "drifts at a steady rate from the start of the record"
        return self._fault("drift", says, formula, lambda t, y, p: y + p[0] * (t - t[0]), size)

    def _saturation(self) -> Series:
        n = self.name
        size = self._size("saturation", "1", 0.8, 1.0, 1.0)
        formula = f"{n} - {{saturation_{n}}} max(0, {n} - {{limit_{n}}})"

        def series(t: Array, y: Array, p: Array) -> Array:
            return y - p[0] * np.maximum(0.0, y - p[1])

        limit = knee(self.variable, "limit", upper_limit(self.variable), f"highest value of {n}")
        return self._fault("saturation", "does not go above a limit", formula, series, size, limit)

    def _saturation_both(self) -> Series:
        """An input may be limited on both sides, as a valve, a pump or an amplifier is."""
        n = self.name
        limits = knees(self.variable, "saturation_both", lower=True)
        size = self._size("saturation_both", "1", 0.8, 1.0, 1.0)
        names = " and ".join("{" + v.name + "}" for v in limits)
        formula = f"{n} less {{{size.name}}} of what is beyond {'+-' if len(limits) == 1 else ''}{names}"

        def series(t: Array, y: Array, p: Array) -> Array:
            low = p[1] if len(limits) > 1 else -p[1]
            return y - p[0] * (y - np.clip(y, low, max(low, p[-1])))

        says = "does not go beyond its limits, above or below"
        return self._fault("saturation_both", says, formula, series, size, *limits, contains=f"input_saturation@{n}")

    def _quantisation(self) -> Series:
        size = self._size("quantisation", self.variable.unit, 0.0, self.span, 0.5 * self.variable.scale)
        formula = f"{self.name} rounded to steps of {{quantisation_{self.name}}}"

        def series(t: Array, y: Array, p: Array) -> Array:
            return y if p[0] <= 0.0 else np.round(y / p[0]) * p[0]

        return self._fault("quantisation", "moves in steps", formula, series, size)

    def _stuck(self) -> Series:
        size = self._size("stuck", "1", 0.0, 1.0, 0.2)
        formula = f"{self.name} constant over the last {{stuck_{self.name}}} of the record"
        says = "stands still from some time on"
        return self._fault("stuck", says, formula, lambda t, y, p: stuck_from(t, y, p[0]), size)


def channel_of(simulator: Simulator, fault: Series) -> tuple[str, int]:
    """Whether a fault is at an input or an output, and at which."""
    return fault.port.place, fault.port.index(simulator)


def with_fault(fault: Series, time_s: Array, values: Array, column: int, sizes: Array, not_there: np.ndarray) -> Array:
    """Channels (N, C) in their units, of which one is faulty.

    Args:
        time_s: (N,) seconds.
        values: (N, C) before the fault, in the channels' units.
        sizes: (k,) the fault's parameters, each in its unit.
        not_there: (N,) bool, when the fault is not there yet.
    """
    changed = values.copy()
    faulty = fault.series(time_s, values[:, column].copy(), sizes)
    changed[:, column] = np.where(not_there, values[:, column], faulty)
    return changed
