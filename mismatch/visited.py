"""The catalogue sized for where the machine was in these recordings, not for where somebody guessed it would be.

Typical sizes and the ranges of thresholds follow from what a state commonly is and how fast it moves. A simulator's
nominal values say so before there are recordings; the calibrated run says it better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.faults import faults
from twinbench.mismatch.fit import Problem
from twinbench.mismatch.machine import Candidate
from twinbench.mismatch.periods import loudest_periods_s
from twinbench.mismatch.reversal import RARE_SHARE, Turned
from twinbench.mismatch.structure import at_points
from twinbench.physics.simulator import Array, Mechanism, Simulator, Variable

PERIODS = 8
"""So often must something come back within a recording to be called periodic."""
FLUX_BLOCKS = 500
"""Blocks of a recording at which fluxes are worked out, in plain Python: for quantiles they are enough."""


def resized(candidates: Sequence[Candidate], problem: Problem, z: Array, period_s: float) -> list[Candidate]:
    """Candidates of the generic catalogue with sizes and thresholds that fit the run of a fitted problem.

    Laws that need a reversal are left out where nothing turned round.

    Of the size that was declared and the one that the run shows the larger holds: where the simulator lacks
    what moves a state, its run shows too little.

    Args:
        z: (K,) where the problem's unknowns stand, each in its own unit.
        period_s: between samples.
    """
    states = _states(problem, z)
    there, turned = moved(problem, z, states), _turned(problem, z, states)
    longest_s = max(float(t.time_s[-1] - t.time_s[0]) for t in problem.tracks) / PERIODS
    white = [problem.white(r) for r in problem.residuals(z)]
    periods_s = loudest_periods_s(problem.tracks, white, longest_s)
    known = {m.name: m for m in (*generic(there, periods_s, turned), *faults(there, period_s, turned))}
    declared = problem.machine.simulator
    offered = {m.name: m for m in (*generic(declared), *faults(declared, period_s))}
    return [
        _resized(c, known[c.name]) if _is_generic(c, known) else c
        for c in candidates
        if c.name in known or not _is_generic(c, offered)
    ]


def _is_generic(candidate: Candidate, known: dict[str, Mechanism]) -> bool:
    return candidate.name in known and [v.name for v in known[candidate.name].parameters] == [
        v.name for v in candidate.mechanism.parameters
    ]


def _resized(candidate: Candidate, seen: Mechanism) -> Candidate:
    declared = candidate.mechanism.parameters
    size = declared[0]
    if seen.kind == "physics":
        size = max(declared[0], seen.parameters[0], key=lambda v: abs(v.nominal))
    parameters = (size, *seen.parameters[1:])
    null = np.array([candidate.null[0], *(v.nominal for v in parameters[1:])])
    return replace(
        candidate,
        mechanism=replace(candidate.mechanism, parameters=parameters),
        null=null,
        typical=np.array([v.nominal for v in parameters]),
    )


def _states(problem: Problem, z: Array) -> list[Array]:
    """(B, nx) per recording, the simulator's own."""
    return [problem.states(r, z)[:, : len(problem.machine.simulator.states)] for r in range(len(problem.tracks))]


def moved(problem: Problem, z: Array, states: Sequence[Array] = ()) -> Simulator:
    """The simulator with its fitted parameters, and every variable's nominal value and scale where the machine was.

    Args:
        z: (K,) where the problem's unknowns stand, each in its own unit.
        states: (B, nx) per recording, in the states' units, if they are known.
    """
    states = states or _states(problem, z)
    simulator, tracks = problem.machine.simulator, problem.tracks
    x = np.concatenate(states)
    u, y = (np.concatenate([getattr(t, name) for t in tracks]) for name in ("u", "y"))
    f = np.concatenate(_fluxes(problem, z, states))
    return replace(
        _fitted(problem, z),
        states=tuple(_seen(v, column) for v, column in zip(simulator.states, x.T, strict=True)),
        inputs=tuple(_seen(v, column) for v, column in zip(simulator.inputs, u.T, strict=True)),
        outputs=tuple(_seen(v, column) for v, column in zip(simulator.outputs, y.T, strict=True)),
        fluxes=tuple(_seen(v, column) for v, column in zip(simulator.fluxes, f.T, strict=True)),
    )


def _turned(problem: Problem, z: Array, states: Sequence[Array]) -> Turned:
    """Which states, inputs and fluxes turned round in the recordings."""
    simulator, tracks = problem.machine.simulator, problem.tracks
    groups = (
        (simulator.states, states),
        (simulator.inputs, [t.u for t in tracks]),
        (simulator.fluxes, _fluxes(problem, z, states)),
    )
    courses = {v.name: [run[:, k] for run in runs] for variables, runs in groups for k, v in enumerate(variables)}
    return Turned.seen(courses)


def _fitted(problem: Problem, z: Array) -> Simulator:
    values = {v.name: z[k] for k, v in enumerate(problem.unknowns) if v.kind == "parameter"}
    return problem.machine.simulator.with_values(**values)


def _fluxes(problem: Problem, z: Array, states: Sequence[Array]) -> list[Array]:
    """Fluxes (n, nf) of each recording at some of its blocks, in the fluxes' units."""
    simulator = _fitted(problem, z)
    if simulator.flux is None:
        return [np.empty((0, 0)) for _ in states]
    out = []
    for x, track in zip(states, problem.tracks, strict=True):
        rows = slice(None, None, max(1, len(x) // FLUX_BLOCKS))
        u = np.add.reduceat(track.u, track.starts) / track.coarse.samples[:, None]
        out.append(at_points(simulator.flux, len(simulator.fluxes), x[rows], u[rows], simulator.theta()))
    return out


def _seen(v: Variable, values: Array) -> Variable:
    """A variable where it was; as declared if it hardly moved."""
    values = values[np.isfinite(values)]
    if not len(values):
        return v
    low, high = np.clip(np.quantile(values, (RARE_SHARE, 1.0 - RARE_SHARE)), v.low, v.high)
    if high - low < 0.5 * v.scale:
        return v
    return replace(v, nominal=0.5 * (low + high), scale=0.5 * (high - low))
