"""The truth of every lumped network: one compiled law, the network packed into its parameters.

No machine costs a compilation. Effects have forms that the catalogue approximates and does not contain.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from numba import njit

from twinbench.physics.simulator import Array
from twinbench.proof.concealed.integrate import LAW
from twinbench.proof.lumped.network import INDUCTOR, ORIFICE, RESISTANCE, SOURCE, SPRING, Network, tables

MOST_STATES, MOST_OWN, MOST_LINKS, SLOT_COUNT, MOST_READ = 6, 20, 16, 20, 4
"""What a network may have at most: the places in the parameter vector are fixed."""


class Form(IntEnum):
    """What an effect does; its numbers are (form, at, of, reach, centre, width, tau, memory).

    ``at`` is the state whose rate it changes, ``of`` the state that it depends on, ``memory`` its own state.
    """

    OFFSET = 0
    POWER = 1  # tau is the power that the catalogue has
    ROOT = 2
    DRY = 3  # centre is its size backward over its size forward
    BRISTLE = 4  # tau is the travel to full force
    PERIODIC = 5  # tau is the period, centre the phase
    SECOND_MASS = 6
    CONVECTION = 7
    RIM = 8
    STOP = 9  # centre is half the free play
    GAP = 10  # at an input
    PLAY = 11  # at an input, which the machine's driver takes care of
    BY_STATE = 12  # at a link, whose parameter depends on a state
    BY_USE = 13  # at a link, whose parameter falls with use


_DRAWN = ("ripple", "ripple_phase", "ambient", "ambient_phase", "exponent")
_LINK, _EFFECT = 6, 8  # numbers of each
_RIPPLE, _PHASE, _DRIFT, _DRIFT_PHASE, _EXPONENT = range(len(_DRAWN))
OWN = len(_DRAWN)
SLOTS = OWN + MOST_OWN
_SIZES = SLOTS + SLOT_COUNT
_N_STATES, _N_INPUTS, _N_LINKS, _N_EFFECTS, _AMBIENT, _AMBIENT_S = range(_SIZES, _SIZES + 6)
_RIPPLED, _PER_DRIVE, _OF_STATE, _PER_STATE = range(_SIZES + 6, _SIZES + 10)
_STORES = _SIZES + 10
_READS = _STORES + MOST_STATES
_LINKS = _READS + MOST_READ
_EFFECTS = _LINKS + _LINK * MOST_LINKS
STILL = np.zeros(4)
"""No ripple: it does not turn."""
LENGTH = _EFFECTS + _EFFECT * SLOT_COUNT


@njit(cache=True, error_model="numpy", inline="always")
def _node(i, x, v, p, room):  # type: ignore[no-untyped-def]
    """What is at a node: a state, an input, the ambient or another parameter, nothing."""
    n, nu = int(p[_N_STATES]), int(p[_N_INPUTS])
    if i < 0:
        return 0.0
    if i < n:
        return x[i]
    if i < n + nu:
        return v[i - n]
    own = i - n - nu
    return p[OWN + own] + (room if own == int(p[_AMBIENT]) else 0.0)


@njit(cache=True, error_model="numpy", inline="always")
def _signed(x, power, s, like):  # type: ignore[no-untyped-def]
    """A power of x with its sign, equal to the power ``like`` at s."""
    return math.copysign(abs(x) ** power, x) * s ** (like - power)


@njit(cache=True, error_model="numpy", inline="always")
def _soft(x, w):  # type: ignore[no-untyped-def]
    """What exceeds zero, with a knee of width w."""
    return w * math.log1p(math.exp(min(x / w, 60.0))) if x < 60.0 * w else x


@njit(cache=True, error_model="numpy")
def _rate(e, a, t, x, p, room):  # type: ignore[no-untyped-def]
    """What effect e of amplitude a adds to the rate of its state, in the state's unit per second."""
    at = _EFFECTS + _EFFECT * e
    form, of = int(p[at]), int(p[at + 2])
    s, centre, w, tau = p[at + 3], p[at + 4], p[at + 5], p[at + 6]
    n = p[_EXPONENT]
    q = x[of]
    if form == Form.OFFSET:
        return a * (1.0 + 0.04 * math.tanh((q - centre) / s))
    if form == Form.POWER:
        return -a * _signed(q, tau * 0.5 * n, s, tau)
    if form == Form.ROOT:
        return -a * max(q - centre, 0.0) ** (0.25 * n)
    if form == Form.DRY:
        side = 1.0 if q > 0.0 else centre
        return -a * side * q / math.sqrt(q * q + w * w) * (1.0 + 0.05 * math.exp(-((q / s) ** 2)))
    if form == Form.BRISTLE:
        return -a * x[int(p[at + 7])]
    if form == Form.PERIODIC:
        turn = 2.0 * math.pi * t / tau + centre
        return a * (math.sin(turn) + 0.15 * math.sin(3.0 * turn + 1.0))
    if form == Form.SECOND_MASS:
        behind = q - x[int(p[at + 7])]
        return -a * behind * (1.0 + 0.05 * abs(behind) / s)
    if form == Form.CONVECTION:
        return -a * _signed(q - p[OWN + int(p[_AMBIENT])] - room, n - 0.8, s, 1.0)
    if form == Form.RIM:
        return -a * _soft(q - centre, w)
    if form == Form.STOP:
        return -a * (_soft(q - centre, w) - _soft(-q - centre, w))
    return 0.0


@njit(cache=True, error_model="numpy")
def _remember(e, x, p, dx):  # type: ignore[no-untyped-def]
    """The rate of effect e's own state."""
    at = _EFFECTS + _EFFECT * e
    form, q, s, tau, m = int(p[at]), x[int(p[at + 2])], p[at + 3], p[at + 6], int(p[at + 7])
    if form == Form.BRISTLE:
        toward = 1.0 - x[m] if q > 0.0 else 1.0 + x[m]
        dx[m] = q / tau * max(toward, 0.0) ** 1.1
    elif form == Form.SECOND_MASS:
        dx[m] = (q - x[m]) * (1.0 + 0.05 * abs(q - x[m]) / s) / tau
    elif form == Form.BY_USE:
        dx[m] = (abs(q) / s - x[m]) / tau


@njit(cache=True, error_model="numpy")
def _times(link, d, t, x, p):  # type: ignore[no-untyped-def]
    """What ripple, drift and effects multiply the parameter of a link by, driven by d."""
    made = 1.0
    if link == int(p[_RIPPLED]):
        wave = math.sin(p[_PER_DRIVE] * d + p[_PHASE]) * math.cos(p[_PER_STATE] * x[int(p[_OF_STATE])])
        made += p[_RIPPLE] * wave
        if p[_AMBIENT] < 0.0:
            made *= 1.0 + p[_DRIFT] * math.sin(2.0 * math.pi * t / p[_AMBIENT_S] + p[_DRIFT_PHASE])
    for e in range(int(p[_N_EFFECTS])):
        a, at = p[SLOTS + e], _EFFECTS + _EFFECT * e
        form = int(p[at])
        if a != 0.0 and form >= Form.BY_STATE and int(p[at + 1]) == link:
            if form == Form.BY_STATE:
                made *= 1.0 + a * math.tanh((x[int(p[at + 2])] - p[at + 4]) / p[at + 3])
            else:
                made /= 1.0 + a * x[int(p[at + 7])]
    return made


@njit(LAW, cache=True, error_model="numpy")
def law(t, x, u, p, dx):  # type: ignore[no-untyped-def]
    """Rates of change of the network's states and of what effects remember, each in its unit per second."""
    n, effects = int(p[_N_STATES]), int(p[_N_EFFECTS])
    room = 0.0
    if p[_AMBIENT] >= 0.0:
        room = p[_DRIFT] * math.sin(2.0 * math.pi * t / p[_AMBIENT_S] + p[_DRIFT_PHASE])
    v = u.copy()
    for e in range(effects):
        gap, at = p[SLOTS + e], _EFFECTS + _EFFECT * e
        if gap > 0.0 and int(p[at]) == Form.GAP:
            i = int(p[at + 1])
            v[i] -= gap * math.tanh(v[i] / gap)  # a dead zone with a soft knee
    for i in range(x.size):
        dx[i] = 0.0
    for link in range(int(p[_N_LINKS])):
        at = _LINKS + _LINK * link
        kind, a, b, k, own = int(p[at]), int(p[at + 1]), int(p[at + 2]), int(p[at + 3]), int(p[at + 4])
        d = _node(a, x, v, p, room) - (0.0 if kind == SOURCE else _node(b, x, v, p, room))
        size = 1.0 if k < 0 else p[OWN + k] * _times(link, x[own] if kind == SPRING else d, t, x, p)
        flow = size * d
        if kind == RESISTANCE:
            flow = d / size
        elif kind == ORIFICE:
            flow = flow / math.sqrt(math.sqrt(d * d + p[at + 5] ** 2))
        elif kind == SPRING:
            flow = size * x[own]
            dx[own] += d
        elif kind == INDUCTOR:
            flow = x[own]
            dx[own] += d - size * flow
        if 0 <= a < n:
            dx[a] -= flow
        if b >= 0:
            dx[b] += flow
    for i in range(n):
        store = int(p[_STORES + i])
        if store >= 0:
            dx[i] /= p[OWN + store]
    for e in range(effects):
        at = _EFFECTS + _EFFECT * e
        if p[SLOTS + e] != 0.0 and int(p[at]) < Form.GAP:
            dx[int(p[at + 1])] += _rate(e, p[SLOTS + e], t, x, p, room)
        if p[at + 7] >= 0.0:  # there or not: an effect that sets in finds what it remembers up to date
            _remember(e, x, p, dx)
    return 0.0


@njit(LAW, cache=True, error_model="numpy")
def reading(t, x, u, p, y):  # type: ignore[no-untyped-def]
    """What the sensors read: states."""
    for i in range(y.size):
        y[i] = x[int(p[_READS + i])]
    return 0.0


@njit(LAW, cache=True, error_model="numpy")
def states(t, x, u, p, y):  # type: ignore[no-untyped-def]
    """The states themselves, as if each had a sensor."""
    for i in range(y.size):
        y[i] = x[i]
    return 0.0


def packed(network: Network, effects: Sequence[Array], ripple: Array, ambient_period_s: float) -> dict[str, float]:
    """The law's parameters by name: nominal values, no amplitudes, and the network's structure.

    Args:
        effects: (8,) each, as ``Form`` describes them: positions, and sizes each in its unit.
        ripple: (4,) the link whose parameter ripples, how many radians it turns per unit of its drive, a state that
            it depends on too, and radians per unit of that.
    """
    t, own = tables(network), tuple(v.name for v in network.parameters)
    ambient = own.index("T_amb_K") if "T_amb_K" in own else -1
    p = np.zeros(LENGTH)
    p[_EXPONENT] = 2.0
    p[OWN : OWN + len(own)] = [v.nominal for v in network.parameters]
    p[_SIZES:_RIPPLED] = (
        len(network.states),
        len(network.inputs),
        len(network.links),
        len(effects),
        ambient,
        ambient_period_s,
    )
    p[_RIPPLED:_STORES] = ripple
    p[_STORES : _STORES + len(t.store)] = t.store
    p[_READS : _READS + len(t.read)] = t.read
    for i, link in enumerate(np.stack([t.kind, t.a, t.b, t.k, t.state, t.knee], axis=-1)):
        p[_LINKS + _LINK * i : _LINKS + _LINK * (i + 1)] = link
    for i, effect in enumerate(effects):
        p[_EFFECTS + _EFFECT * i : _EFFECTS + _EFFECT * (i + 1)] = effect
    return dict(zip(_names(own), p.tolist(), strict=True))


def _names(own: tuple[str, ...]) -> list[str]:
    """Names of the law's parameters in order; ``own`` are the machine's."""
    spare = [f"spare_{i}" for i in range(len(own), MOST_OWN)]
    slots = [f"effect_{i}" for i in range(SLOT_COUNT)]
    structure = [f"structure_{i}" for i in range(LENGTH - _SIZES)]
    return [*_DRAWN, *own, *spare, *slots, *structure]
