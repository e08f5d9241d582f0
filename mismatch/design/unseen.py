"""Rivals as their catalogue has them, where there are no recordings: nominal machine, typical sizes, wide priors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.mismatch.calibrate import shared_unknowns
from twinbench.mismatch.design.candidates import Candidate
from twinbench.mismatch.design.clock import Clock
from twinbench.mismatch.design.gather import check_fitted
from twinbench.mismatch.design.limits import Limits
from twinbench.mismatch.design.trials import track_of
from twinbench.mismatch.fit import Problem
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.model import as_bad_input
from twinbench.mismatch.naming.discrepancy import discrepancy
from twinbench.mismatch.naming.effect import Effect, may_wander, unknowns_of, with_effects
from twinbench.mismatch.naming.ground import Ground, Products
from twinbench.mismatch.naming.marginal import DISCREPANCY_PCT, Learnt
from twinbench.mismatch.naming.name import common
from twinbench.mismatch.naming.settle import Settled
from twinbench.mismatch.naming.view import WANDERS, View
from twinbench.mismatch.sensors import SensorNoise
from twinbench.mismatch.stage_audit import is_fitted
from twinbench.mismatch.steps import settle_step
from twinbench.mismatch.variants import Variant, is_amplitude, typical
from twinbench.physics.simulator import Array, Mechanism, Series, Simulator

BLOCKS_UNSEEN = 400
"""Blocks of an experiment where no recordings say how long a block has to be."""


class Unseen(NamedTuple):
    """Rivals that were never looked for, and what is assumed of noise and discrepancy."""

    rivals: list[Settled]
    ground: Ground
    clock: Clock


def without_recordings(
    simulator: Simulator,
    faults: Sequence[Series],
    effects: Sequence[Mechanism],
    limits: Limits,
    candidates: Sequence[Candidate],
    linear: bool,
) -> Unseen:
    """Rivals of one effect each; the simulator as it is where there are none.

    Raises:
        BadInput: the limits do not say the noise of an output, or the simulator diverges.
    """
    machine = Machine(simulator, [m for m in effects if is_fitted(simulator, m)], faults)
    check_fitted(machine, [[m.name] for m in effects])
    clock = _clock(simulator, limits, linear)
    blocks = track_of(candidates[0], clock, np.ones(len(simulator.outputs), dtype=bool))
    nominal = np.tile([v.nominal for v in simulator.outputs], (len(blocks.time_s), 1))
    track = blocks.reading(nominal)
    with as_bad_input():
        settle_step(machine, [track], np.sqrt(clock.noise.variance))
    problem = Problem(machine, [track], shared_unknowns(simulator), np.sqrt(clock.noise.variance))
    view = View.around(problem, problem.z0)
    if not np.isfinite(view.courses[0].means).all():
        raise BadInput(f"simulator {simulator.name!r} diverges in {candidates[0].says}; narrow the limits")
    d = discrepancy(view.courses, common(view, simulator))
    ports, many = len(d.ports), len(d.points)
    ground = Ground(
        clock.noise, (), (), np.zeros((0, 0, 0)), np.repeat(np.arange(ports), many), d.ports,
        np.full(ports, DISCREPANCY_PCT), d, tuple((p, np.eye(many)) for p in range(ports)),
    )  # fmt: skip
    empty = Problem(machine, [], problem.unknowns, problem.sd)
    effects_of = [[_typical(machine, k)] for k in range(len(machine.candidates))] or [[]]
    return Unseen([_as_it_is(empty, one, ground) for one in effects_of], ground, clock)


def _clock(simulator: Simulator, limits: Limits, linear: bool) -> Clock:
    for v in simulator.outputs:
        if v.name not in limits.noise:
            raise BadInput(
                f"the noise of {v.name} is not known: add [noise] {v.name} = SD to the limits, the standard deviation "
                "of a reading, or give --verdict"
            )
    block = max(1, len(limits.time_s) // BLOCKS_UNSEEN)
    white = np.array([limits.noise[v.name] ** 2 / block for v in simulator.outputs])
    return Clock(0.0, block, linear, SensorNoise(white, 1e-9 * white, np.ones(len(white))))


def _typical(machine: Machine, k: int) -> Effect:
    candidate = machine.candidates[k]
    shape = () if is_amplitude(candidate) else tuple(v.nominal for v in candidate.mechanism.parameters[1:])
    size = typical(candidate)
    return Effect(Variant(k, shape), size, abs(size), 0.0)


def _as_it_is(problem: Problem, effects: Sequence[Effect], ground: Ground) -> Settled:
    """A hypothesis where it begins: nothing was learnt of it."""
    many, parameters = len(problem.unknowns), tuple(u for e in effects for u in unknowns_of(problem, e))
    whole = Problem(problem.machine, [], (*problem.unknowns, *parameters), problem.sd)
    z, firsts = with_effects(whole, problem.z0, effects)
    wanders = [k for k, e in zip(firsts, effects, strict=True) if may_wander(whole, e)]
    nothing = Products(*(np.zeros((0, 0, 0)) for _ in range(3)))
    sizes: Array = np.array([e.size for e in effects])
    learnt = Learnt(0.0, ground.s, np.zeros(len(ground.group)))
    return Settled(
        tuple(effects), whole, z, many, 0.0, sizes, np.abs(sizes), learnt, z, np.eye(len(z)), nothing, wanders, WANDERS,
        np.zeros(len(z)),
    )  # fmt: skip
