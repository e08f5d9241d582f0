"""The augmented filter of an untrained operator, part by part."""

from __future__ import annotations

import numpy as np

from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.deeponet_kalman.augmented import correct, expect, foresee, remember
from twinbench.methods.deeponet_kalman.cycle import memory_type, said_type, scaling_of, scratch, twin_record
from twinbench.methods.deeponet_kalman.model import room_type
from twinbench.methods.deeponet_kalman.parts import parts_of
from twinbench.methods.deeponet_kalman.safeguards import Settings, empty_safety
from twinbench.methods.deeponet_kalman.tick import tick
from twinbench.methods.frontend import Fitted
from twinbench.methods.modes import in_the_long_run, modes_of
from twinbench.physics.compressor import M_REF_KG_S

PARTS = parts_of(COMPRESSOR)
PROBE, ZETA, NOISE, ERROR, SIZE = PARTS.states, PARTS.zeta, PARTS.noise, PARTS.error, PARTS.size
BIAS, HEALTH = NOISE - 1, COMPRESSOR.coordinates
OFF = Settings(
    trust_reach=np.inf, extrapolation=0.0, least_information=0.0, q_gain=0.0, q_most=30.0, r_gain=0.0, r_most=25.0,
    channel_gate=np.inf, difference=0.0,
)  # fmt: skip
"""No safeguard at all: the plain augmented filter."""
MODES = modes_of(COMPRESSOR, 0.0, 0.0, 0.0)
ALIKE = MODES._replace(out=np.zeros_like(MODES.out))
"""Modes in all of which health stands still and no output fails: together they are one filter."""
WHITE, COLOURED = np.array([0.012, 0.6, 1e-3]), np.array([0.008, 0.4, 6e-4])


def corrected(problem, safety, z, P, measured, white, coloured, clip, model=None):
    """z, P, innovation, the same of what was used, and S after a correction of one filter; ``safety`` (1,) moves on."""
    own, z, P, room = kept(problem, model), z.copy(), P.copy(), np.zeros(1, room_type(problem[0], PARTS))
    foresee(own, safety[0], z, P, measured, white, coloured, clip, room[0])
    expect(z, P, z.copy(), room[0])
    correct(own, safety[0], z, P, clip, room[0])
    remember(own, safety[0], white, coloured, room[0])
    return z, P, *(room[name][0] for name in ("innovation", "used", "S"))


def off_by(z: np.ndarray, sd: float) -> np.ndarray:
    """Readings that lie so many standard deviations of the sensors above what is expected."""
    bias = HEALTH.to_theta(z[ZETA:NOISE])[4]
    return np.array([z[1], z[PROBE] + bias, M_REF_KG_S * z[4]]) + COLOURED * z[NOISE:ERROR] + sd * WHITE


def machine(problem, machines=1):
    """A twin whose front end lets everything pass, and the memory of so many machines that are as in ``problem``."""
    weights, model, base, z, P = problem
    mean = np.array([0.95, 298.0, 1350.0, 0.64, 3.1, 430.0, 0.12])
    query = np.array([1350.0, 3.3, 298.0, 0.95, 0.64])
    front = Fitted(mean, 0.1 * mean, 0.01 * mean, np.full(7, np.inf), np.inf, COMPRESSOR.sample_period_s)
    memory = np.zeros(machines, memory_type(weights, PARTS))
    memory["z"], memory["P"], memory["safety"] = z, P, empty_safety(PARTS, machines)
    memory["modes"]["mu"] = in_the_long_run(model.modes.turn)
    memory["modes"]["z"], memory["modes"]["P"] = z, P
    memory["stream"]["ticks"], memory["stream"]["base"] = 1, base
    return twin_record(model, front, scaling_of(COMPRESSOR, query, 0.1 * query), PARTS, 1), memory


def kept(problem, model=None):
    """The filter's model, or another, as twins keep it: what is compiled for twins serves these tests, too."""
    weights, own, *rest = problem
    return machine((weights, model or own, *rest))[0]["filter"][0]


def ticked(problem, measured, lag=(0.0, 0.0, 0.0), mode=None, **safety):
    """z, P and diagnostics after a tick of one machine whose outputs (3,) were read ``lag`` (3,) ticks ago.

    Fields of its safety are set as given; ``mode`` is the one in which it surely is.
    """
    weights = problem[0]
    twin, memory = machine(problem)
    for name, value in safety.items():
        memory["safety"][name] = value
    if mode is not None:
        memory["modes"]["mu"] = np.arange(PARTS.modes) == mode
    said, room = np.zeros(1, said_type(PARTS)), scratch(weights, PARTS)
    query, measured = np.zeros(5, np.float32), np.array(measured)
    arguments = (query, measured, np.array(lag), WHITE, COLOURED, 6.0, said[0], room["filter"][0])
    tick(weights[0], twin["filter"][0], memory[0], *arguments)
    return memory["z"][0], memory["P"][0], said
