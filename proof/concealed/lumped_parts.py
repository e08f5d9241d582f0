"""What a random machine is operated by, what its background ripples with, and where it settles from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from twinbench.physics.simulator import Array, Equation
from twinbench.proof.concealed.lumped_law import OWN, STILL, Form, law, packed
from twinbench.proof.concealed.machine import clock, levels
from twinbench.proof.concealed.networks import Sketch
from twinbench.proof.lumped.network import Network, tables
from twinbench.proof.lumped.twin import steady

_OPERATED = {"train": (0.0, 1.0), "held": (0.15, 1.25), "poor": (0.5, 0.5005)}
"""Shares of an input's range that a regime goes through."""
_BY_DRIVE, _BY_STATE = 1.5, 1.2  # radians that a ripple turns per sd of a link's drive and of a state: a few waves


@dataclass(frozen=True)
class Rhythm:
    """How fast a network is: its sample period, its slowest time constant, and how many samples a recording has."""

    period_s: float
    slowest_s: float
    samples: int


@dataclass(frozen=True)
class Drive:
    """``Machine.operate`` of a network: held levels in the range of every input."""

    limits: tuple[tuple[float, float], ...]
    rhythm: Rhythm

    @classmethod
    def of(cls, sketch: Sketch, rhythm: Rhythm) -> Self:
        """Over the ranges that a sketch gives its inputs."""
        return cls(tuple((low, high) for *_, low, high in sketch.inputs.values()), rhythm)

    def __call__(self, rng: np.random.Generator, seconds: float, regime: str) -> Array:
        """Inputs (N, nu) in their units."""
        period_s, slow = self.rhythm.period_s, self.rhythm.slowest_s
        low, high = _OPERATED[regime]
        hold, ramp = (0.3 * slow, 3.0 * slow), (2.0 * period_s, 2.0 * period_s + 0.3 * slow)
        between = [(a + low * (b - a), a + high * (b - a)) for a, b in self.limits]
        return np.stack([levels(rng, clock(seconds, period_s), limits, hold, ramp) for limits in between], axis=-1)


@dataclass(frozen=True)
class Waves:
    """``Machine.ripple_arguments`` of a network: what drives a link, and a state, in radians.

    Attributes:
        link: whose parameter ripples.
        per_drive: radians per unit of what drives it.
        of: the state's place.
        per_state: radians per unit of the state.
    """

    network: Network
    link: int
    per_drive: float
    of: int
    per_state: float

    @classmethod
    def drawn(cls, network: Network, x: Array, u: Array, rng: np.random.Generator) -> Self:
        """Of a link that has a parameter, over where the machine goes.

        Args:
            x: (N, nx) each state in its unit.
            u: (N, nu) inputs in their units.
        """
        links = [j for j, link in enumerate(network.links) if link.parameter and link.kind != "inductor"]
        link, of = links[int(rng.integers(len(links)))], int(rng.integers(len(network.states)))
        per_drive = _BY_DRIVE / float(np.std(driven_by(network, link, x, u)))
        return cls(network, link, per_drive, of, _BY_STATE / float(np.std(x[:, of])))

    @property
    def parameter(self) -> str:
        """The link's."""
        return self.network.links[self.link].parameter

    @property
    def numbers(self) -> Array:
        """What the law needs of it, (4,)."""
        return np.array([self.link, self.per_drive, self.of, self.per_state])

    def __call__(self, x: Array, u: Array) -> Array:
        """(N, 2) radians, of states x (N, nx) and inputs u (N, nu), each in its unit."""
        drive = driven_by(self.network, self.link, x, u)
        return np.stack([self.per_drive * drive, self.per_state * x[:, self.of]], axis=-1)


def driven_by(network: Network, link: int, x: Array, u: Array) -> Array:
    """What drives a link (N,): the difference of its nodes, a source's input, a spring's elongation.

    Args:
        x: (N, nx) each state in its unit.
        u: (N, nu) inputs in their units.
    """
    t, kind = tables(network), network.links[link].kind
    if kind == "spring":
        return x[:, t.state[link]]
    own = np.tile([v.nominal for v in network.parameters], (len(x), 1))
    nodes = np.concatenate([x[:, : len(network.states)], u, own, np.zeros((len(x), 1))], axis=-1)  # -1 is nothing
    return nodes[:, t.a[link]] - (0.0 if kind == "source" else nodes[:, t.b[link]])


@dataclass(frozen=True)
class Start:
    """``Machine.start`` of a network: its steady state, and what the effects that remember do there.

    Attributes:
        remembering: numbers (8,) of each of these, in the order of their own states.
    """

    network: Network
    remembering: tuple[tuple[float, ...], ...]

    def __call__(self, u: Array, p: Array) -> Array:
        """The state (nx + remembering,) under inputs u (nu,) and parameters p (n_parameters,), each in its unit."""
        variables = self.network.states
        nominal, scale = (np.array([getattr(v, name) for v in variables]) for name in ("nominal", "scale"))
        theta = p[OWN : OWN + len(self.network.parameters)]
        x = steady(rates_of(self.network), u, theta, nominal, scale)
        own = []
        for form, _, of, reach, *_ in self.remembering:
            q = x[int(of)]
            own.append({Form.SECOND_MASS: q, Form.BY_USE: abs(q) / reach}.get(Form(int(form)), 0.0))
        return np.concatenate([x, own])


def rates_of(network: Network) -> Equation:
    """The network's own rates by the truth's law, ``rhs(x, u, theta)``, nothing being wrong with it."""
    p = np.array(list(packed(network, (), STILL, np.inf).values()))

    def rhs(x: Array, u: Array, theta: Array) -> Array:
        p[OWN : OWN + len(theta)] = theta
        dx = np.empty_like(x)
        law(0.0, x, u, p, dx)
        return dx

    return rhs
