"""A lumped machine as plain data: stores, links between them, sources, sensors.

A store holds what its state measures: a mass its velocity, a capacity its temperature, a tank its level, a capacitor
its voltage. A link carries a flow from its node ``a`` to its node ``b``, driven by the difference of the two:

| kind | flow, with its parameter k |
|---|---|
| conductance | k (a - b) |
| resistance | (a - b)/k |
| orifice | k root(a - b), root(d) = d/(d^2 + knee^2)^(1/4) |
| source | k a; k is 1 where it has no parameter |
| spring | k s; its own state s is its elongation, ds/dt = a - b |
| inductor | s; its own state s is its current, L ds/dt = a - b - k s |

A node is a state, an input, a parameter (the ambient), or nothing (standstill, ground, an empty tank). The rate of a
store's state is the sum of what flows in, less what flows out, over its size. All units fit without factors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from twinbench.physics.simulator import Array, Variable

KINDS = ("conductance", "resistance", "orifice", "source", "spring", "inductor")
CONDUCTANCE, RESISTANCE, ORIFICE, SOURCE, SPRING, INDUCTOR = range(len(KINDS))


@dataclass(frozen=True)
class Link:
    """A flow from node ``a`` to node ``b``.

    Attributes:
        kind: one of KINDS.
        a: a state, an input, a parameter, or empty.
        b: a state, or empty.
        parameter: k; empty if it is 1.
        state: a spring's elongation, an inductor's current.
        knee: of an orifice, in the unit of the nodes: the root is smooth so near zero.
    """

    kind: str
    a: str
    b: str
    parameter: str = ""
    state: str = ""
    knee: float = 0.0


@dataclass(frozen=True)
class Network:
    """A lumped machine.

    Attributes:
        stores: by state, the parameter that is its size; an inductor's current has one, a spring's elongation none.
        reads: the state that each output reads.
        known: parameters that the twin need not calibrate, because they were measured.
    """

    name: str
    says: str
    states: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    stores: Mapping[str, str]
    links: tuple[Link, ...]
    reads: tuple[str, ...]
    known: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain data that ``from_json`` makes the same network of."""
        return asdict(self)

    @classmethod
    def from_json(cls, given: Mapping[str, Any]) -> Network:
        """The network that ``to_json`` wrote down."""
        groups = ("states", "inputs", "outputs", "parameters")
        variables = {group: tuple(Variable(**v) for v in given[group]) for group in groups}
        links = tuple(Link(**link) for link in given["links"])
        own = {"links": links, "reads": tuple(given["reads"]), "known": tuple(given["known"])}
        return cls(**{**given, **variables, **own})


class Tables(NamedTuple):
    """A network as numbers, in the order of its states, inputs and parameters.

    Attributes:
        kind: (L,) positions in KINDS.
        a: (L,) positions of the nodes that links come from, in states, then inputs, then parameters; -1 is none.
        b: (L,) likewise, of those that they go to.
        k: (L,) positions of the links' parameters, -1 where k is 1.
        state: (L,) positions of the links' own states, -1 where they have none.
        knee: (L,) in the unit of the nodes.
        store: (nx,) positions of the stores' parameters, -1 for an elongation.
        read: (ny,) positions of the states that outputs read.
    """

    kind: np.ndarray
    a: np.ndarray
    b: np.ndarray
    k: np.ndarray
    state: np.ndarray
    knee: Array
    store: np.ndarray
    read: np.ndarray


def tables(network: Network) -> Tables:
    """The network as numbers."""
    states, inputs, parameters = (
        [v.name for v in group] for group in (network.states, network.inputs, network.parameters)
    )
    nodes = [*states, *inputs, *parameters]

    def at(names: list[str], wanted: list[str]) -> np.ndarray:
        return np.array([names.index(name) if name else -1 for name in wanted], dtype=np.int64)

    links = network.links
    return Tables(
        np.array([KINDS.index(link.kind) for link in links], dtype=np.int64),
        at(nodes, [link.a for link in links]),
        at(nodes, [link.b for link in links]),
        at(parameters, [link.parameter for link in links]),
        at(states, [link.state for link in links]),
        np.array([link.knee for link in links]),
        at(parameters, [network.stores.get(name, "") for name in states]),
        at(states, list(network.reads)),
    )
