"""Faults of any machine's sensors and inputs, per channel.

A fault of an output is what the sensor makes of the clean reading. A fault of an input is what the
machine really got where another value was recorded: a slow, saturated or stuck actuator looks the
same as a recording that leads, overshoots or moves on its own, so one record stands for both.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from twinbench.mismatch.place import bracketed
from twinbench.mismatch.series import delay_reading, delay_steps, held, lag_reading, lag_steps, stuck_from
from twinbench.physics.simulator import Array, Mechanism, Simulator, Variable

Series = Callable[[Array, Array, Array], Array]
_DRIFT_S = 600.0  # a typical drift moves by one scale in ten minutes


@functools.cache
def faults(simulator: Simulator, sample_period_s: float = 0.05) -> tuple[Mechanism, ...]:
    """Bias, gain, lag, delay, drift, saturation, quantisation and a stuck channel, for every output and input.

    All but saturation have one parameter, the size; 0 is none. What saturates keeps a fifth of its excess at most.
    NaN in the values is held over.

    Args:
        sample_period_s: lags and delays are typically two of them.
    """
    return tuple(
        fault
        for port, variables in (("output", simulator.outputs), ("input", simulator.inputs))
        for v in variables
        for fault in _of_channel(port, v, sample_period_s)
    )


def _of_channel(port: str, v: Variable, sample_period_s: float) -> list[Mechanism]:
    kind = "sensor" if port == "output" else "input"
    lag, delay = (lag_reading, delay_reading) if port == "output" else (lag_steps, delay_steps)
    n, unit, span = v.name, v.unit, _span(v)
    who = f"the sensor of {n}" if port == "output" else f"what drives the machine as {n}"

    def size(name: str, size_unit: str, low: float, high: float, typical: float) -> Variable:
        return Variable(f"{name}_{n}", size_unit, low, high, typical, typical, f"{name.removesuffix('_s')} of {n}")

    def fault(name: str, says: str, formula: str, series: Series, parameter: Variable, *shape: Variable) -> Mechanism:
        def over_gaps(time_s: Array, values: Array, theta: Array) -> Array:
            return series(time_s, held(np.asarray(values, dtype=np.float64)), theta)

        return Mechanism(
            f"{kind}_{name}@{n}",
            f"{who} {says}",
            f"{port}:{n}",
            (parameter, *shape),
            series=over_gaps,
            formula=formula,
            kind=kind,
        )

    return [
        fault(
            "bias",
            "is off by a constant",
            f"{n} + {{bias_{n}}}",
            lambda t, y, p: y + p[0],
            size("bias", unit, -span, span, v.scale),
        ),
        fault(
            "gain",
            "is off in proportion",
            f"(1 + {{gain_{n}}}) {n}",
            lambda t, y, p: (1.0 + p[0]) * y,
            size("gain", "1", -0.5, 0.5, 0.05),
        ),
        fault(
            "lag",
            "follows late, as a first-order lag",
            f"first-order lag of {n} by {{lag_s_{n}}}",
            lambda t, y, p: lag(t, y, p[0]),
            size("lag_s", "s", 0.0, 500.0 * sample_period_s, 2.0 * sample_period_s),
        ),
        fault(
            "delay",
            "comes late by a fixed time",
            f"{n}(t - {{delay_s_{n}}})",
            lambda t, y, p: delay(t, y, p[0]),
            size("delay_s", "s", 0.0, 200.0 * sample_period_s, 2.0 * sample_period_s),
        ),
        fault(
            "drift",
            "drifts at a steady rate from the start of the record",
            f"{n} + {{drift_{n}}} (t - t_0)",
            lambda t, y, p: y + p[0] * (t - t[0]),
            size("drift", f"{bracketed(unit)}/s", -span / _DRIFT_S, span / _DRIFT_S, v.scale / _DRIFT_S),
        ),
        fault(
            "saturation",
            "does not go above a limit",
            f"{n} - {{saturation_{n}}} max(0, {n} - {{limit_{n}}})",
            lambda t, y, p: y - p[0] * np.maximum(0.0, y - p[1]),
            size("saturation", "1", 0.8, 1.0, 1.0),
            _limit(v),
        ),
        fault(
            "quantisation",
            "moves in steps",
            f"{n} rounded to steps of {{quantisation_{n}}}",
            lambda t, y, p: y if p[0] <= 0.0 else np.round(y / p[0]) * p[0],
            size("quantisation", unit, 0.0, span, 0.5 * v.scale),
        ),
        fault(
            "stuck",
            "stands still from some time on",
            f"{n} constant over the last {{stuck_{n}}} of the record",
            lambda t, y, p: stuck_from(t, y, p[0]),
            size("stuck", "1", 0.0, 1.0, 0.2),
        ),
    ]


def _span(v: Variable) -> float:
    """The width of a channel's range; ten scales where it has none."""
    return v.high - v.low if np.isfinite(v.high - v.low) and v.high > v.low else 10.0 * v.scale


def _limit(v: Variable) -> Variable:
    """Where a channel saturates: within two scales of its nominal value, typically half a scale above."""
    low, high = max(v.low, v.nominal - 2.0 * v.scale), min(v.high, v.nominal + 2.0 * v.scale)
    typical = min(v.nominal + 0.5 * v.scale, high)
    return Variable(f"limit_{v.name}", v.unit, low, high, typical, v.scale, f"highest value of {v.name}")
