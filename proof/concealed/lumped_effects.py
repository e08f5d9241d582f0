"""What a lumped machine may have that its twin has not: a truth for each name in its twin's catalogue that has one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from twinbench.mismatch.catalogue import generic
from twinbench.physics.simulator import Array, Mechanism, Simulator
from twinbench.proof.concealed.lumped_law import SLOT_COUNT, SLOTS, Form
from twinbench.proof.concealed.lumped_parts import Rhythm
from twinbench.proof.concealed.machine import Effect
from twinbench.proof.concealed.networks import even
from twinbench.proof.lumped.network import Network

MOST_DRAWN, MOST_REMEMBERED = 12, 3
"""Effects of a machine that the catalogue approximates, and those of them that have a state of their own."""
MOST_FOREIGN = 2
"""Of either kind."""
GREATEST = 50.0
"""An amplitude may grow to this many times the catalogue's typical size."""
SHORTEST_PERIODS = 8.0
"""A periodic force lasts at least so many samples."""
_POWERS = {"viscous_friction": 1, "linear_loss": 1, "linear_leak": 1, "quadratic_friction": 2, "quadratic_loss": 2,
           "quadratic_leak": 2, "cubic_friction": 3, "cubic_loss": 3}  # fmt: skip


@dataclass(frozen=True)
class Ground:
    """What the effects of a machine are made from.

    Attributes:
        x: (N, nx) where its states go, in training and then held out, each in its unit.
        u: (N, nu) its inputs there, in their units.
    """

    network: Network
    twin: Simulator
    x: Array
    u: Array
    rhythm: Rhythm

    @property
    def mean(self) -> Array:
        """Of the states, (nx,)."""
        return np.mean(self.x, axis=0)

    @property
    def sd(self) -> Array:
        """Of the states, (nx,)."""
        return np.std(self.x, axis=0)

    @property
    def size(self) -> Array:
        """Rms of the states, (nx,)."""
        return np.sqrt(np.mean(self.x**2, axis=0))


@dataclass(frozen=True)
class Made:
    """An effect and how the law has it.

    Attributes:
        numbers: (8,) in the law's parameters, as ``Form`` describes them: positions, and sizes each in its unit.
    """

    effect: Effect
    numbers: Array


def effects(ground: Ground, rng: np.random.Generator) -> tuple[tuple[Made, ...], tuple[Made, ...], dict[str, str]]:
    """The effects of a machine, those foreign to every catalogue, and the slot of every input's free play."""
    offered = list(generic(ground.twin))
    n, slots, memory = len(ground.network.states), iter(range(SLOTS, SLOTS + SLOT_COUNT)), 0
    made: list[Made] = []
    played: dict[str, str] = {}
    for i in rng.permutation(len(offered)):
        numbers = _numbers(offered[i], ground, rng)
        if numbers is None or len(made) == MOST_DRAWN:
            continue
        if numbers[0] in (Form.BRISTLE, Form.SECOND_MASS):
            if memory == MOST_REMEMBERED:
                continue
            numbers[7] = n + memory
            memory += 1
        slot = f"effect_{next(slots) - SLOTS}"
        made.append(Made(_effect(offered[i], slot, ground.network), numbers))
        if numbers[0] == Form.PLAY:
            played[offered[i].port.variable] = slot
    foreign = []
    for numbers, what in _foreign(ground, rng, n + memory):
        ports = _ends(ground.network, int(numbers[1]))
        most = 0.6 if numbers[0] == Form.BY_STATE else 3.0
        foreign.append(Made(Effect(what, f"effect_{next(slots) - SLOTS}", 0.05, most, ports), numbers))
    return tuple(made), tuple(foreign), played


def _effect(term: Mechanism, slot: str, network: Network) -> Effect:
    size, ports = term.parameters[0], [str(term.port)]
    if term.port.place == "input":
        fed = [link for link in network.links if link.a == term.port.variable]
        ports += [f"balance:{link.b}" for link in fed if link.b]
    return Effect(term.name, slot, size.nominal, GREATEST * size.nominal, tuple(ports), size.name)


def _numbers(term: Mechanism, ground: Ground, rng: np.random.Generator) -> Array | None:
    """The law's numbers of a catalogue's mechanism; None where it is a parameter of the twin, or has no truth here."""
    effect, network = term.name.partition("@")[0], ground.network
    if term.port.place == "input":
        form = {"dead_zone": Form.GAP, "backlash": Form.PLAY}.get(effect)
        at = [v.name for v in network.inputs].index(term.port.variable)
        return None if form is None else _packed(form, at)
    if term.port.place != "balance":
        return None
    state = term.port.variable
    i = [v.name for v in network.states].index(state)
    mean, sd, size = ground.mean[i], ground.sd[i], ground.size[i]
    shape = {v.name: v for v in term.parameters}
    if effect in _POWERS:
        absorbed = _POWERS[effect] == 1 and _is_grounded(network, state)
        return None if absorbed else _packed(Form.POWER, i, i, reach=size, tau=_POWERS[effect])
    if effect == "offset":
        # A steady force on what a spring holds only stretches the spring.
        return None if _is_held(network, state) else _packed(Form.OFFSET, i, i, reach=2.0 * sd, centre=mean)
    if effect in ("coulomb_friction", "constant_drop"):
        return _packed(Form.DRY, i, i, reach=sd, centre=1.0, width=0.03 * network.states[i].scale)
    if effect in ("coulomb_friction_unequal", "constant_drop_unequal"):
        back = rng.uniform(0.0, 0.4)
        return _packed(Form.DRY, i, i, reach=sd, centre=back, width=0.03 * network.states[i].scale)
    if effect == "hysteresis":
        return _packed(Form.BRISTLE, i, i, tau=_about(shape[f"hysteresis_travel_{state}"].nominal, rng))
    if effect == "periodic":
        period_s = max(
            _about(shape[f"periodic_period_s_{state}"].nominal, rng), SHORTEST_PERIODS * ground.rhythm.period_s
        )
        return _packed(Form.PERIODIC, i, i, centre=rng.uniform(-np.pi, np.pi), tau=period_s)
    if effect == "second_thermal_mass":
        return _packed(Form.SECOND_MASS, i, i, reach=sd, tau=_about(shape[f"{effect}_tau_s_{state}"].nominal, rng))
    if effect == "loss_to_ambient":
        excess = max(abs(mean - _ambient(network)), sd)
        return None if _is_grounded(network, state) else _packed(Form.CONVECTION, i, i, reach=excess)
    if effect == "leak":
        return _packed(Form.ROOT, i, i, centre=max(0.0, mean - 2.5 * sd) * rng.uniform(0.0, 0.8))
    if effect == "overflow":
        return _rim(i, ground, rng)
    if effect in ("hardening_spring", "backlash"):
        return _of_position(effect, i, ground, rng)
    return None


def _rim(i: int, ground: Ground, rng: np.random.Generator) -> Array:
    """At a level that training recordings exceed too, within the catalogue's range."""
    v, trained = ground.network.states[i], ground.x[: len(ground.x) // 2, i]
    sd = float(np.std(trained))
    centre = max(float(np.mean(trained)) + rng.uniform(-0.2, 0.5) * sd, v.nominal - 0.9 * v.scale)
    return _packed(Form.RIM, i, i, centre=centre, width=0.06 * sd)


def _of_position(effect: str, i: int, ground: Ground, rng: np.random.Generator) -> Array | None:
    """By the elongation of the spring that ties a mass to the ground: one between masses would pull at both."""
    network = ground.network
    names = [v.name for v in network.states]
    tied = [link.state for link in network.links if link.kind == "spring" and link.a == names[i] and not link.b]
    if not tied:
        return None
    q = names.index(tied[0])
    if effect == "hardening_spring":
        return _packed(Form.POWER, i, q, reach=ground.size[q], tau=3.0)
    return _packed(Form.STOP, i, q, centre=rng.uniform(0.3, 1.0) * ground.sd[q], width=0.05 * ground.sd[q])


def _foreign(ground: Ground, rng: np.random.Generator, memory: int) -> Iterator[tuple[Array, str]]:
    """Links whose parameter depends on a state that is not one of their ends, and links whose parameter falls with use.

    Args:
        memory: where the first state of their own stands.
    """
    network = ground.network
    links = [j for j, link in enumerate(network.links) if link.parameter and link.kind not in ("source", "inductor")]
    names = [v.name for v in network.states]
    for j in rng.permutation(links)[:MOST_FOREIGN]:
        ends = {network.links[j].a, network.links[j].b, network.links[j].state}
        others = [i for i, name in enumerate(names) if name not in ends] or list(range(len(names)))
        i = others[int(rng.integers(len(others)))]
        by_state = _packed(Form.BY_STATE, j, i, reach=1.5 * ground.sd[i], centre=ground.mean[i])
        yield by_state, f"{network.links[j].parameter}_depends_on_{names[i]}"
    for j in rng.permutation(links)[:MOST_FOREIGN]:
        at = next(names.index(end) for end in (network.links[j].a, network.links[j].b) if end in names)
        by_use = _packed(Form.BY_USE, j, at, reach=ground.size[at], tau=4.0 * ground.rhythm.slowest_s)
        by_use[7] = memory
        memory += 1
        yield by_use, f"{network.links[j].parameter}_falls_with_use"


def _packed(
    form: Form, at: int, of: int = 0, *, reach: float = 1.0, centre: float = 0.0, width: float = 1.0, tau: float = 1.0
) -> Array:
    return np.array([form, at, of, reach, centre, width, tau, -1.0], dtype=float)


def _about(value: float, rng: np.random.Generator) -> float:
    return value * even(rng, 0.4, 1.6)


def _is_grounded(network: Network, state: str) -> bool:
    """Does a linear link tie the state to what does not move, so that a linear loss is a parameter of the twin?"""
    states, fixed = {v.name for v in network.states}, {v.name for v in network.parameters} | {""}
    links = [link for link in network.links if link.kind in ("conductance", "resistance")]
    ended = {(link.a, link.b) for link in links} | {(link.b, link.a) for link in links}
    is_current = any(link.kind == "inductor" and link.state == state for link in network.links)
    return is_current or (state in states and any((state, end) in ended for end in fixed))


def _is_held(network: Network, state: str) -> bool:
    """Do springs tie the state to what does not move, directly or through other masses, none with a sensor on it?"""
    springs = [link for link in network.links if link.kind == "spring"]
    ends, tied = [{link.a, link.b} for link in springs], {state}
    for _ in ends:
        tied = tied.union(*(pair for pair in ends if pair & (tied - {""})))
    return "" in tied and not {link.state for link in springs} & set(network.reads)


def _ambient(network: Network) -> float:
    return next((v.nominal for v in network.parameters if v.name == "T_amb_K"), 0.0)


def _ends(network: Network, link: int) -> tuple[str, ...]:
    """Balances that a link takes part in."""
    names: Mapping[str, str] = network.stores
    own = network.links[link]
    return tuple(f"balance:{end}" for end in (own.a, own.b) if end in names)
