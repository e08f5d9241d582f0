"""Faults of the concealed machines' sensors and actuators.

At an output ``faulty`` is what the recorder gets in place of the clean reading; at an input it is what
the machine got in place of the recorded command.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from twinbench.physics.simulator import Array
from twinbench.proof.concealed.machine import Effect, Machine

KINDS = ("bias", "gain", "lag", "delay", "drift", "saturation", "quantisation", "stuck")
_COMPARABLE = {"bias": "bias", "gain": "gain", "lag": "lag_s", "delay": "delay_s", "quantisation": "quantisation"}
_ABSORBED = {
    "sensor_bias@T_dis_K", "sensor_drift@T_dis_K", "sensor_gain@T_probe_K", "sensor_bias@T_probe_K",
    "input_gain@valve", "input_bias@valve", "input_gain@pump_V", "input_lag@T_suc_K", "input_delay@T_suc_K",
}  # fmt: skip
"""What a parameter or the machine's slowness hides, so that no size of it that makes sense would be a case."""
_AT_INPUTS = ("bias", "gain", "lag", "delay", "drift", "saturation")


def all_faults(machine: Machine) -> tuple[Effect, ...]:
    """Every fault that somebody may blame."""
    found = []
    for where, group, kinds in (("sensor", machine.outputs, KINDS), ("input", machine.inputs, _AT_INPUTS)):
        for channel in group:
            port = f"{'output' if where == 'sensor' else 'input'}:{channel}"
            for kind in kinds:
                size = f"{_COMPARABLE[kind]}_{channel}" if kind in _COMPARABLE else ""
                found.append(Effect(f"{where}_{kind}@{channel}", "", 0.0, 0.0, (port,), size))
    return tuple(found)


def faults(machine: Machine) -> tuple[Effect, ...]:
    """Every fault of a machine that is drawn: none that is the same as another parameter value."""
    listed = [e for e in all_faults(machine) if e.name not in _ABSORBED]
    return tuple(e for e in listed if not e.name.startswith("input_drift"))


def parts(effect: Effect) -> tuple[str, str]:
    """Kind and channel of a fault."""
    head, _, channel = effect.name.partition("@")
    return head.partition("_")[2], channel


def faulty(kind: str, size: float, time_s: Array, values: Array, span: tuple[float, float], last: bool) -> Array:
    """The series (N,) that a fault makes of another.

    Args:
        size: bias and quantisation step in the channel's unit; drift in units per hour from the start of
            a recording; lag and delay in s; gain a share; saturation the share of the span that is cut
            off; stuck the share of a recording at its end.
        time_s: (N,) seconds.
        values: (N,) in the channel's unit.
        span: lowest and highest value of the channel in training.
        last: is this the last training recording? A sensor sticks in that one only.
    """
    if size <= 0.0 or (kind == "stuck" and not last):
        return values
    if kind == "bias":
        return values + size
    if kind == "gain":
        return values * (1.0 + size)
    if kind == "lag":
        return _lagged(values, (time_s[1] - time_s[0]) / size)
    if kind == "delay":
        return np.interp(time_s - size, time_s, values)
    if kind == "drift":
        return values + size * (time_s - time_s[0]) / 3600.0
    if kind == "quantisation":
        return size * np.floor(values / size + 0.5)
    if kind == "saturation":
        limit, knee = span[1] - size * (span[1] - span[0]), 0.005 * (span[1] - span[0])
        return limit - knee * np.logaddexp(0.0, (limit - values) / knee)
    if kind == "stuck":
        first = round((1.0 - size) * len(values))
        return np.where(np.arange(len(values)) < first, values, values[first])
    raise ValueError(f"fault {kind!r} is not known")


def _lagged(values: Array, period: float) -> Array:
    """What a first-order lag makes of a series (N,), exactly, settled at the first.

    It is the same for readings, which are points of lines, and for steps and the mean over each.

    Args:
        values: (N,) in the channel's unit.
        period: of the samples, in time constants.
    """
    keep = np.exp(-period)
    mean = (1.0 - keep) / period
    return np.asarray(lfilter([1.0 - mean, mean - keep], [1.0, -keep], values, zi=[mean * values[0]])[0])


def first_size(kind: str, sigma: float, span: tuple[float, float], period_s: float) -> tuple[float, float]:
    """A size to start scaling from, and the largest that makes sense; a lag shorter than a sample shows nowhere."""
    width = span[1] - span[0]
    sigma = sigma if sigma > 0.0 else 0.01 * width
    start, most = {
        "bias": (sigma, 0.5 * width),
        "gain": (0.02, 0.4),
        "lag": (max(0.5, 2.0 * period_s), max(20.0, 40.0 * period_s)),
        "delay": (max(0.3, 2.0 * period_s), max(10.0, 20.0 * period_s)),
        "drift": (10.0 * sigma, 10.0 * width),
        "saturation": (0.15, 0.6),
        "quantisation": (sigma, 0.3 * width),
        "stuck": (0.2, 0.4),
    }[kind]
    return min(start, most), most


def span_of(series: Sequence[Array]) -> tuple[float, float]:
    """Lowest and highest value of several series.

    Args:
        series: (N,) each, all in one unit.
    """
    return min(float(s.min()) for s in series), max(float(s.max()) for s in series)
