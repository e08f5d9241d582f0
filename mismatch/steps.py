"""How finely a machine is integrated: as coarsely as its readings allow."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from twinbench.mismatch.machine import Machine, Setting
from twinbench.mismatch.march import RUNGE_KUTTA, legendre
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array

HALVINGS = 7
"""Times that the step is halved before a simulator is called too stiff: 128 steps to a reading. Fewer would call more
of them so. What settles earlier does not depend on it."""
PARTS, STEPS, STAGES = (1, 2, 4, 8, 16, 32), (1, 2, 4, 8, 16, 32), (0, 5, 7, 10)
"""How a run by blocks may be made, the cheapest first that does: parts of a block that each have an input of their
own, integration steps of each part, and stages of the stabilised integrator or none for Runge-Kutta's."""
MARGIN = 2.5
"""Times so many stages: a fit moves time constants, and beyond its limit the integrator ends in states of its own.
Rates may grow by its square, sixfold. With 1.4 a compressor's intake chattered under effects that clean its filter, and
the likeliest set came to rest 22 nats lower. With 4 it came to rest where it does with 2.5."""
BLOCKED = 0.02
"""Share of a signal that a run by blocks may miss."""


def settle_step(machine: Machine, tracks: Sequence[Track], noise: Array) -> str:
    """Halve a machine's integration steps until the readings no longer move by a share of the noise, rms.

    Args:
        tracks: the recordings; the shortest is tried.
        noise: (ny,) in the outputs' units.

    Returns:
        A remark if even the finest step tried was not fine enough; else nothing.

    Raises:
        ValueError: the simulator diverges however small the step.
    """
    track = min(tracks, key=lambda t: len(t.time_s))
    setting = Setting(track, machine.theta, machine.start(track))
    remark, exact = "", _settle_fine(machine, setting, 0.05 * noise)
    if exact is None:
        remark = (
            f"a step of {machine.step_s:.3g} s is still too coarse for simulator {machine.simulator.name!r} to be "
            "integrated to a twentieth of the noise; it is stiff, or its equations jump"
        )
        exact = machine.run(setting)
    # What blocks leave out is added back where it is known (``Problem.refined``), so shares of a signal do.
    enough = np.maximum(0.2 * noise, BLOCKED * np.std(exact, axis=0))
    means, fine_s = track.block_means(exact), machine.block_step_s
    all_of_them = _evaluations(1, int(np.ceil(track.fine.seconds / fine_s - 1e-6).clip(1.0).sum()), 0)
    for parts, steps, stages in sorted(product(PARTS, STEPS, STAGES), key=lambda plan: _evaluations(*plan)):
        machine.parts = parts
        grid = machine.grid(track)
        if len(grid.u) * _evaluations(1, steps, stages) >= all_of_them:
            break
        machine.block_step_s = float(np.median(grid.seconds[grid.seconds > 0.0])) / steps
        machine.scheme = legendre(stages) if stages else RUNGE_KUTTA
        missed = machine.run(setting, blocks=True) - means
        if np.isfinite(missed[np.isfinite(means)]).all() and (_rms(missed) < enough).all():
            machine.scheme = legendre(round(MARGIN * stages)) if stages else RUNGE_KUTTA
            return remark
    machine.parts, machine.block_step_s, machine.scheme = track.finest, fine_s, RUNGE_KUTTA
    return remark


def _settle_fine(machine: Machine, setting: Setting, most: Array) -> Array | None:
    """Halve ``step_s`` until the readings no longer move by so much.

    The last half is kept: what one reading hides, many add up to in a parameter. A fit by blocks does without it.

    Args:
        most: (ny,) by how much halving may move the readings, rms, in the outputs' units.

    Returns:
        The readings (N, ny), in the outputs' units; None if no step was fine enough.
    """
    seconds = setting.track.fine.seconds
    machine.step_s = machine.block_step_s = float(np.median(seconds[seconds > 0.0]))
    coarse = machine.run(setting)
    for _ in range(HALVINGS):
        machine.step_s = 0.5 * machine.block_step_s
        fine = machine.run(setting)
        if np.isfinite(coarse).all() and (_rms(fine - coarse) < most).all():
            return fine
        coarse, machine.block_step_s = fine, machine.step_s
    if not np.isfinite(coarse).all():
        k, track = int(np.argmax(~np.isfinite(coarse).all(axis=1))), setting.track
        stops = "diverges" if machine.simulator.stepped is None else "diverges, or reports an error at a step,"
        raise ValueError(
            f"simulator {machine.simulator.name!r} {stops} on recording {track.name} at "
            f"{track.time_s[k]:.6g} s, at its nominal parameters; check its equations, units and initial state"
        )
    return None


def _rms(values: Array) -> Array:
    return np.sqrt(np.nanmean(values**2, axis=0)) if np.isfinite(values).any() else np.full(values.shape[1], np.inf)


def _evaluations(parts: int, steps: int, stages: int) -> int:
    """Of the equations per block, by its parts, each part's steps and each step's stages."""
    return parts * steps * (stages or 4)
