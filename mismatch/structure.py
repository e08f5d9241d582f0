"""What a simulator's equations say of themselves when they are asked at points: rates, positions, dependences."""

from __future__ import annotations

import contextlib
from typing import NamedTuple

import numpy as np

from twinbench.mismatch.natures import MASS_FLOWS, PRESSURES, SPEEDS
from twinbench.mismatch.seed import ENGINE_SEED
from twinbench.physics.compose import plain_rhs
from twinbench.physics.simulator import Array, Equation, Simulator, Variable

STRUCTURE_POINTS = 5
"""Points at which the equations are asked which state is whose rate."""
ROUND_OFF = 1e-9
"""Relative difference up to which two results of the same equations are one, as rounding leaves them."""
_SLOWEST_S = 10.0  # a state that nothing seems to move: its scale in ten times this
_MOVED_SCALES = 0.1  # by which a variable is moved to see what depends on it


def positions_of(simulator: Simulator) -> dict[int, int]:
    """For each state that is the rate of another, where that other stands: by the equations, else by the units."""
    states = simulator.states
    found = _rates_of_others(simulator)
    for i, v in enumerate(states):
        if i not in found and v.unit in SPEEDS and v.unit.endswith("/s"):
            free = [j for j, w in enumerate(states) if f"{w.unit}/s" == v.unit and j not in found.values()]
            found.update((i, j) for j in free[:1])
    return found


def _rates_of_others(simulator: Simulator) -> dict[int, int]:
    """States that the equations take for another's rate as they are, and that other, wherever the machine is."""
    n, (x, u) = len(simulator.states), scattered(simulator)
    rates = at_points(plain_rhs(simulator), n, x, u, simulator.theta())
    return {i: j for j in range(n) for i in range(n) if i != j and np.array_equal(rates[:, j], x[:, i])}


def scattered(simulator: Simulator) -> tuple[Array, Array]:
    """Points within a scale of the nominal one, always the same: states (5, nx) and inputs (5, nu), in their units."""
    rng = np.random.default_rng(ENGINE_SEED)

    def of(variables: tuple[Variable, ...]) -> Array:
        nominal, scale = (np.array([getattr(v, name) for v in variables], dtype=float) for name in ("nominal", "scale"))
        low, high = ([getattr(v, name) for v in variables] for name in ("low", "high"))
        return np.clip(nominal + scale * rng.uniform(-1.0, 1.0, (STRUCTURE_POINTS, len(variables))), low, high)

    return of(simulator.states), of(simulator.inputs)


def typical_rates(simulator: Simulator) -> Array:
    """How fast each state commonly changes, (nx,), in its unit per second.

    The root sum of squares of what one scale of each state and input does to its rate at the nominal
    point; where that is nothing, the rate there; where that is nothing too, a slow guess.
    """
    rhs, theta = plain_rhs(simulator), simulator.theta()
    x, u = (np.array([v.nominal for v in group], dtype=np.float64) for group in (simulator.states, simulator.inputs))
    scales = np.array([v.scale for v in simulator.states])
    with np.errstate(all="ignore"):
        base = np.asarray(rhs(x, u, theta), dtype=np.float64)
        moved = [np.asarray(rhs(x + step, u, theta)) - base for step in np.diag(scales)]
        moved += [np.asarray(rhs(x, u + step, theta)) - base for step in np.diag([v.scale for v in simulator.inputs])]
    rates = np.sqrt(np.sum(np.square(np.nan_to_num(moved, posinf=0.0, neginf=0.0)), axis=0))
    rates = np.where(rates > 0.0, rates, np.abs(np.nan_to_num(base, posinf=0.0, neginf=0.0)))
    return np.where(rates > 0.0, rates, scales / _SLOWEST_S)


def depends(simulator: Simulator, rate: int, state: int) -> bool:
    """Does the rate of one state depend on another state anywhere near the nominal point?"""
    rhs, theta, (x, u) = plain_rhs(simulator), simulator.theta(), scattered(simulator)
    moved = x.copy()
    moved[:, state] += _MOVED_SCALES * simulator.states[state].scale
    before, after = (at_points(rhs, x.shape[1], at, u, theta)[:, rate] for at in (x, moved))
    return not np.array_equal(before, after, equal_nan=True)


def at_points(function: Equation, n: int, x: Array, u: Array, theta: Array) -> Array:
    """What an equation gives (N, n) at some points; NaN where it fails, in plain Python.

    Args:
        x: (N, nx) each state in its unit.
        u: (N, nu) inputs in their units.
        theta: (np,) parameters, each in its unit.
    """
    out = np.full((len(x), n), np.nan)
    for k, point in enumerate(zip(x, u, strict=True)):
        # A root of a negative number, a division by zero: in machine code they are NaN too.
        with np.errstate(all="ignore"), contextlib.suppress(ValueError, ArithmeticError):
            out[k] = function(*point, theta)
    return out


class Pressure(NamedTuple):
    """A pressure among the states or the inputs, and where it stands there."""

    variable: Variable
    at: int
    is_input: bool


def flows(simulator: Simulator, flux: int) -> bool:
    """Is a flux ever there, near the nominal point? One that an amplitude of zero switches off has no laws."""
    return bool(_flows(simulator, flux, None).any())


def chokes(simulator: Simulator, flux: int) -> list[tuple[Pressure, Pressure]]:
    """Pressures before and behind a mass flow that the equations take as choked.

    Such a flow is in proportion to the pressure before it and does not depend on that behind it. Which pressure is
    behind the opening the equations cannot say: each that is nominally lower, in the same unit, may be.
    """
    if simulator.flux is None or simulator.fluxes[flux].unit not in MASS_FLOWS:
        return []
    groups = ((simulator.states, False), (simulator.inputs, True))
    pressures = [
        Pressure(v, i, is_input) for group, is_input in groups for i, v in enumerate(group) if v.unit in PRESSURES
    ]
    plain, twice = _flows(simulator, flux, None), {p: _flows(simulator, flux, p) for p in pressures}
    before = [p for p in pressures if plain.any() and np.allclose(twice[p], 2.0 * plain, rtol=ROUND_OFF, atol=0.0)]
    behind = [p for p in pressures if np.array_equal(twice[p], plain)]
    return [
        (up, down)
        for up in before
        for down in behind
        if down.variable.unit == up.variable.unit and down.variable.nominal < up.variable.nominal
    ]


def _flows(simulator: Simulator, flux: int, doubled: Pressure | None) -> Array:
    """A flux (5,) at points near the nominal one, in its unit; with one pressure twice as high."""
    x, u = scattered(simulator)
    if doubled is not None:
        (u if doubled.is_input else x)[:, doubled.at] *= 2.0
    assert simulator.flux is not None
    return at_points(simulator.flux, len(simulator.fluxes), x, u, simulator.theta())[:, flux]
