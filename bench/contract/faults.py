"""Promises about what is reported when sensors fail."""

from __future__ import annotations

import numpy as np

from twinbench.bench.contract.outcome import at_most, need
from twinbench.bench.contract.promise import promise
from twinbench.bench.contract.subject import FAULTS, FLOAT64_ROUND_OFF, JUDGED_TICKS, LONG_RUN, Subject, Trace
from twinbench.machines.coordinates import Array


def _error(s: Subject, trace: Trace) -> Array:
    """(B,) root mean square error of all estimates where recovery is judged, in typical changes."""
    gap = (trace.mean - s.ground.truth.estimated[:, :LONG_RUN].swapaxes(0, 1)) / s.machine.scales
    return np.sqrt((gap[-JUDGED_TICKS:] ** 2).mean(axis=(0, 2)))


def _recovers(s: Subject, name: str) -> str:
    """Finite throughout, and at the end hardly worse than without the fault."""
    trace = s.trace(name)
    s.finite(trace)
    after, before = _error(s, trace), _error(s, s.trace("undisturbed"))
    says = f"error afterwards {after.max():.2f} typical changes, undisturbed {before.max():.2f}"
    need((after <= 1.5 * before + 0.5).all(), says)
    return says


@promise("survives missing channels")
def _missing(s: Subject) -> str:
    return _recovers(s, "missing")


@promise("survives a beginning without readings")
def _late(s: Subject) -> str:
    s.finite(s.trace("late"))
    return f"finite from the first of {40 * s.machine.sample_period_s:g} s without readings on"


@promise("survives spikes")
def _spiked(s: Subject) -> str:
    return _recovers(s, "spiked")


@promise("survives a stuck channel")
def _stuck(s: Subject) -> str:
    return _recovers(s, "stuck")


@promise("health stays in its physical bounds, whatever is read")
def _in_bounds(s: Subject) -> str:
    nearest, names, own = np.inf, s.machine.health_names, s.machine.coordinates
    for name in s.recordings:
        trace = s.trace(name)
        s.finite(trace)
        for part in ("mean", "low", "high"):
            health = getattr(trace, part)[..., -len(names) :]
            inside = np.minimum(health - own.low, own.high - health).min(axis=(0, 1))
            worst = int(np.argmin(inside / (own.high - own.low)))
            what = f"{part} of {names[worst]}"
            need(inside[worst] >= 0.0, f"{what} is {-inside[worst]:.2g} outside ({name})")
            nearest = min(nearest, float((inside / (own.high - own.low)).min()))
    return f"at least {100 * nearest:.2g} % of the range inside, readings up to a million spreads"


@promise("the covariance is symmetric and positive semidefinite")
def _covariance(s: Subject) -> str:
    lowest, skew = np.inf, 0.0
    for name in FAULTS:
        cov = s.trace(name).cov
        s.finite(s.trace(name))
        variance = np.diagonal(cov, axis1=-2, axis2=-1)
        need((variance >= 0.0).all(), f"a negative variance ({name})")
        # As correlations, so that small units count as much as large ones; a zero variance stays a zero row.
        sd = np.sqrt(np.maximum(variance, 1e-30))
        correlation = cov / (sd[..., :, None] * sd[..., None, :])
        skew = max(skew, float(np.abs(correlation - correlation.swapaxes(-1, -2)).max()))
        lowest = min(lowest, float(np.linalg.eigvalsh(0.5 * (correlation + correlation.swapaxes(-1, -2))).min()))
    at_most(skew, FLOAT64_ROUND_OFF, "as correlations, asymmetric by")
    at_most(-lowest, FLOAT64_ROUND_OFF, "as correlations, an eigenvalue below zero by")
    return f"as correlations, smallest eigenvalue {lowest:.2g}, asymmetric by {skew:.2g}"


@promise("intervals are ordered and have width")
def _intervals(s: Subject) -> str:
    narrowest = np.inf
    for name in FAULTS:
        trace = s.trace(name)
        s.finite(trace)
        need(((trace.low <= trace.mean) & (trace.mean <= trace.high)).all(), f"low <= mean <= high fails ({name})")
        narrow = ((trace.high - trace.low) / s.machine.scales).min(axis=(0, 1))
        need(narrow.min() > 0.0, f"an interval of {s.machine.quantities[int(narrow.argmin())]} has no width ({name})")
        narrowest = min(narrowest, float(narrow.min()))
    return f"narrowest {narrowest:.2g} typical changes"
