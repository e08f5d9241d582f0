"""The simulator as it came, fitted: its parameters, where recordings start, and what drifts in each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from twinbench.mismatch.fit import KNOT_EVERY_S, KNOTS_LEAST, Problem, Unknown
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.noise import noise_floor
from twinbench.mismatch.solve import NEARLY, solve
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Amplitude, Array, Mechanism, Simulator

PRIOR_SD = 4.0
"""Prior standard deviation of a parameter or start state, in its scales."""


def calibrated(
    machine: Machine, tracks: Sequence[Track], floor: Array, advance: Callable[[float], None] = lambda share: None
) -> tuple[Problem, Array]:
    """The simulator as it came, fitted; and where its unknowns stand, (K,), each in its own unit.

    Args:
        floor: (ny,) least noise of block means, in the outputs' units.
        advance: told the share that is done.
    """
    unknowns = (*shared_unknowns(machine.simulator), *own_unknowns(machine.simulator, tracks))
    problem = Problem(machine, tracks, unknowns, floor)
    z, _ = solve(problem, problem.z0, 12, share=NEARLY, advance=lambda share: advance(0.6 * share))
    # What blocks leave out depends on where the fit is.
    problem = problem.refined(z)
    z, _ = solve(problem, z, 4, share=NEARLY, advance=lambda share: advance(0.6 + 0.2 * share))
    # What errors are to be expected is learnt last: an output that is far off must not decide for the others.
    problem = problem.refined(z)
    problem = replace(problem, sd=np.maximum(_rms(problem.residuals(z)), floor))
    return problem, solve(problem, z, 4, advance=lambda share: advance(0.8 + 0.2 * share))[0]


def _rms(residuals: Sequence[Array]) -> Array:
    """(ny,) over all recordings; nothing where nothing was measured."""
    squares = np.concatenate([np.square(r) for r in residuals])
    return np.array([np.sqrt(np.mean(c[np.isfinite(c)])) if np.isfinite(c).any() else 0.0 for c in squares.T])


def is_parameter(simulator: Simulator, mechanism: Mechanism) -> bool:
    """Is the mechanism only a parameter that calibration moves anyway?"""
    return isinstance(mechanism, Amplitude) and any(v.name in free_names(simulator) for v in mechanism.parameters)


def free_names(simulator: Simulator) -> tuple[str, ...]:
    """Parameters that calibration may move."""
    return (*simulator.calibrate, *simulator.drifts) or tuple(v.name for v in simulator.parameters)


def block_noise(tracks: Sequence[Track], simulator: Simulator) -> Array:
    """Noise (ny,) of block means; at least a ten-thousandth of what the channel does."""
    floor = noise_floor([t.means for t in tracks])
    whole = np.concatenate([t.means for t in tracks])
    scale = np.array([v.scale for v in simulator.outputs])
    span = np.array([np.nanstd(y) if np.isfinite(y).any() else 0.0 for y in whole.T])
    least = 1e-4 * np.where(span > 0, span, scale)
    return np.maximum(np.nan_to_num(floor), least)


def shared_unknowns(simulator: Simulator) -> tuple[Unknown, ...]:
    """The parameters that all recordings have in common."""
    names = free_names(simulator)
    return tuple(
        Unknown(v.name, "parameter", i, v.low, v.high, v.nominal, PRIOR_SD * v.scale, v.scale)
        for i, v in enumerate(simulator.parameters)
        if v.name in names and v.name not in simulator.drifts and v.low < v.high
    )


def own_unknowns(simulator: Simulator, tracks: Sequence[Track]) -> tuple[Unknown, ...]:
    """What each recording has for itself: where it starts, and how its drifting parameters go."""
    found = []
    for r, track in enumerate(tracks):
        for i, v in enumerate(simulator.states):
            found.append(
                Unknown(f"start of {v.name}", "start", i, -np.inf, np.inf, 0.0, PRIOR_SD * v.scale, 0.2 * v.scale, r)
            )
        for name in simulator.drifts:
            i = simulator.index(name)
            v = simulator.parameters[i]
            found += [
                Unknown(name, "drift", i, v.low - v.nominal, v.high - v.nominal, 0.0, PRIOR_SD * v.scale, v.scale, r, k)
                for k in range(max(KNOTS_LEAST, 1 + round((track.time_s[-1] - track.time_s[0]) / KNOT_EVERY_S)))
            ]
    return tuple(found)
