"""What the augmented filter knows: its model of a machine as a record, and the room that a tick takes.

z = [n states, lags, nh health coordinates zeta, ny coloured-noise states, n slow errors of the operator], as ``parts``
has it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.machines.coordinates import Array, Coordinates
from twinbench.machines.machine import Machine
from twinbench.methods.deeponet_kalman.layout import scratch_type
from twinbench.methods.deeponet_kalman.parts import Parts, followers, parts_of
from twinbench.methods.deeponet_kalman.records import record
from twinbench.methods.deeponet_kalman.safeguards import (
    Envelope,
    Memories,
    Settings,
    memories_of,
    widest_of,
)
from twinbench.methods.modes import Modes
from twinbench.methods.noise import Sheet, coloured_keep, sheet_of
from twinbench.methods.operator import acting

SLOW_STATE_S = 60.0
"""A state that takes longer to cross its spread is slow. More of it lets slow states follow readings of which the
operator cannot say what they mean."""


class Lags(NamedTuple):
    """First-order lags behind estimated states, exact over a tick.

    Attributes:
        of: (nl,) dimensionless, the state that each follows.
        keep_log: (nl,) dimensionless logarithm of what is left of a gap after a tick.
        by: (nl,) dimensionless, the state with a power of which it quickens; -1: with none.
        power: (nl,) dimensionless, that power.
        least: (nl,) lowest value of that state, in its unit.
    """

    of: np.ndarray
    keep_log: Array
    by: np.ndarray
    power: Array
    least: Array


class Readings(NamedTuple):
    """What the outputs read: ``gain z[source] + bias``.

    Attributes:
        gain: (ny,) in the output's unit per unit of the state.
        source: (ny,) dimensionless, entry of z.
        bias: (ny,) dimensionless, which health parameter is added; -1: none.
        shifts: (ny,) dimensionless, entry of z that a shift is put down to: the bias if there is one, else the source.
    """

    gain: Array
    source: np.ndarray
    bias: np.ndarray
    shifts: np.ndarray


class Model(NamedTuple):
    """What the filter needs besides the operator's weights.

    Attributes:
        state_mean: (n,) means of the training states in their units.
        state_scale: (n,) their spreads in the same units.
        increment: (n,) spread of the states' change in a tick, in the same units.
        state_low: (n,) lowest values that the states may have, in the same units; -inf where any.
        Q: (N, N) process noise of one tick but for the walk of health, in the units of z squared.
        noise_keep: (ny,) dimensionless AR(1) factors of the coloured sensor noise.
        error_keep: AR(1) factor of the operator's slow errors.
        zeta_low: (nh,) dimensionless lower bounds of the coordinates, far outside a machine's life.
        zeta_high: (nh,) dimensionless upper bounds.
        prior_sd: (nh,) dimensionless sd of health's coordinates before the first reading.
        widest: (nh,) dimensionless variance of a coordinate of which nothing is known.
        acting: (na,) dimensionless, which health parameters act on the machine.
        slow: (N,) bool: what changes over minutes: slow states, health, slow errors.
        lags: behind estimated states.
        readings: of the outputs.
        health: the map of its coordinates.
        sheet: the sensors' noise.
        modes: in which health moves and outputs fail.
        memories: of the safeguards.
        settings: of the safeguards.
        envelope: where the operator was trained.
        period_s: from tick to tick.
    """

    state_mean: Array
    state_scale: Array
    increment: Array
    state_low: Array
    Q: Array
    noise_keep: Array
    error_keep: float
    zeta_low: Array
    zeta_high: Array
    prior_sd: Array
    widest: Array
    acting: np.ndarray
    slow: np.ndarray
    lags: Lags
    readings: Readings
    health: Coordinates
    sheet: Sheet
    modes: Modes
    memories: Memories
    settings: Settings
    envelope: Envelope
    period_s: float


def lags_of(machine: Machine) -> Lags:
    """The lags of a machine behind its estimated states, with the time constants of its plant: probes are known."""
    lags, theta, states = followers(machine), machine.plant.theta(), machine.estimated
    return Lags(
        np.array([states.index(lag.follows) for lag in lags], np.int64),
        np.array([-machine.sample_period_s / theta[machine.plant.index(lag.tau_s)] for lag in lags]),
        np.array([states.index(lag.faster_with) if lag.faster_with else -1 for lag in lags], np.int64),
        np.array([theta[machine.plant.index(lag.exponent)] if lag.exponent else 0.0 for lag in lags]),
        np.array([machine.least[lag.faster_with] if lag.faster_with else 0.0 for lag in lags]),
    )


def readings_of(machine: Machine) -> Readings:
    """What the outputs of a machine read, as entries of z.

    Raises:
        BadInput: an output reads what follows an input, which the filter does not estimate.
    """
    names, zeta = machine.estimated + tuple(lag.state for lag in followers(machine)), parts_of(machine).zeta
    for r in machine.readings:
        if r.state not in names:
            raise BadInput(f"deeponet_kalman: {r.output} reads {r.state}, which follows an input and is not estimated")
    source = np.array([names.index(r.state) for r in machine.readings])
    bias = np.array([machine.health_names.index(r.bias) if r.bias else -1 for r in machine.readings])
    gain = np.array([float(r.gain) for r in machine.readings])
    return Readings(gain, source, bias, np.where(bias < 0, source, zeta + bias))


def model_of(
    machine: Machine,
    scales: tuple[Array, Array, Array],
    Q: Array,
    error_keep: float,
    settings: Settings,
    envelope: Envelope,
    modes: Modes,
) -> Model:
    """The model of a machine.

    Args:
        machine: whose.
        scales: means, spreads and increments (n,) of the training states in their units.
        Q: (N, N) process noise of one tick but for the walk of health, in the units of z squared.
        error_keep: AR(1) factor of the operator's slow errors.
        settings: of the safeguards.
        envelope: where the operator was trained.
        modes: in which health moves and outputs fail.
    """
    parts, (mean, scale, increment) = parts_of(machine), scales
    slow = np.zeros(parts.size, np.bool_)
    slow[: parts.states] = machine.sample_period_s * scale > SLOW_STATE_S * increment
    slow[parts.zeta : parts.noise] = slow[parts.error :] = True
    return Model(
        state_mean=mean,
        state_scale=scale,
        increment=increment,
        state_low=np.array([machine.least.get(name, -np.inf) for name in machine.estimated]),
        Q=Q,
        noise_keep=coloured_keep(machine),
        error_keep=error_keep,
        zeta_low=machine.zeta_bounds[0],
        zeta_high=machine.zeta_bounds[1],
        prior_sd=np.sqrt(np.diag(machine.prior[1])),
        widest=widest_of(machine),
        acting=acting(machine),
        slow=slow,
        lags=lags_of(machine),
        readings=readings_of(machine),
        health=machine.coordinates,
        sheet=sheet_of(machine),
        modes=modes,
        memories=memories_of(machine),
        settings=settings,
        envelope=envelope,
        period_s=machine.sample_period_s,
    )


def _mixture(parts: Parts) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Fields of the filters of all modes: how likely each is, and its z and P."""
    count, n = parts.modes, parts.size
    return {"mu": ("f8", (count,)), "z": ("f8", (count, n)), "P": ("f8", (count, n, n))}


def modes_type(parts: Parts) -> np.dtype[np.void]:
    """What the filters of all modes carry. ``stays`` is how likely each goes on from the tick before, and ``offset`` by
    how much the output that fails in it reads too high, with the variance of that."""
    return record({**_mixture(parts), "stays": ("f8", (parts.modes,)), "offset": ("f8", (parts.modes, 2))})


def room_type(weights: np.ndarray, parts: Parts) -> np.dtype[np.void]:
    """Room for what one tick reckons in between.

    Args:
        weights: (1,) of ``layout.pack``, a record of dimensionless weights.
        parts: of the machine.
    """
    n, nh, ny = parts.size, parts.health, parts.outputs
    return record(
        {
            "operator": (scratch_type(weights), ()),
            **dict.fromkeys(("F", "M"), ("f8", (n, n))),
            **dict.fromkeys(("H", "HP", "own_HP", "X"), ("f8", (ny, n))),
            "K": ("f8", (n, ny)),
            **dict.fromkeys(("R", "S", "own_S", "L"), ("f8", (ny, ny))),
            **dict.fromkeys(("innovation", "used", "own", "r", "now", "whitened", "noise_var"), ("f8", (ny,))),
            **dict.fromkeys(("accuracy", "surprise"), ("f8", (ny,))),
            **dict.fromkeys(("ahead", "score", "weight"), ("f8", (parts.modes,))),
            "mixed": (record(_mixture(parts)), ()),
            **dict.fromkeys(("before", "apart", "column"), ("f8", (n,))),
            "rows": ("f8", (nh, ny)),
            "push": ("f8", (nh,)),
            "variance": ("f8", (nh,)),
            "after": ("f8", (parts.zeta, nh)),
            "complex": ("c16", (nh, 2 * nh)),
        }
    )
