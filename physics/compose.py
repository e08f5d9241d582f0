"""A simulator with mechanisms' terms added at their ports: again a simulator, compiled once for all of them.

The equations of the whole are written out as source, so that sixty candidate terms make one function.
A term whose size is at its absent value is not even called.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from physics.compile import jit
from physics.simulator import Array, Equation, Mechanism, Simulator, Variable, index_of


class _Part(NamedTuple):
    """Where one mechanism acts, and where its own states and parameters stand in the whole vectors."""

    number: int
    mechanism: Mechanism
    kind: str
    at: int
    state: int
    parameter: int


def compose(simulator: Simulator, mechanisms: Sequence[Mechanism]) -> Simulator:
    """Append the mechanisms' parameters and states, and add their terms at their ports.

    The same call gives the same simulator, compiled once.

    Each term sees the simulator's own states and parameters, then its own. Switched off is a
    mechanism whose first parameter is at its ``absent`` value.

    Raises:
        ValueError: a port that does not exist, states without their derivative, a name that is there twice.
    """
    return _composed(simulator, tuple(mechanisms))


@functools.cache
def _composed(simulator: Simulator, mechanisms: tuple[Mechanism, ...]) -> Simulator:
    parts = []
    n, m = len(simulator.states), len(simulator.parameters)
    for number, mechanism in enumerate(mechanisms):
        parts.append(_part(simulator, mechanism, number, n, m))
        n += len(mechanism.states)
        m += len(mechanism.parameters)
    source = _source(simulator, parts, n)
    rhs, output = _build(source, simulator, parts, lambda f: f)
    # Compiled code calls compiled functions; a term that numba refuses leaves the plain ones.
    for made, native in zip((rhs, output), _build(source, simulator, parts, jit), strict=True):
        made.__dict__["native"] = native
    n_own = len(simulator.parameters)

    def initial(u0: Array, y0: Array, theta: Array) -> Array:
        own = [v.nominal for mechanism in mechanisms for v in mechanism.states]
        return np.concatenate((simulator.initial(u0, y0, theta[:n_own]), own))

    return replace(
        simulator,
        states=simulator.states + tuple(v for mechanism in mechanisms for v in mechanism.states),
        parameters=_named_once(simulator, mechanisms),
        rhs=rhs,
        output=output,
        initial=initial,
        fluxes=(),
        flux=None,
        balance=None,
    )


def _named_once(simulator: Simulator, mechanisms: Sequence[Mechanism]) -> tuple[Variable, ...]:
    """All parameters; one whose name is taken gets its mechanism's name before it."""
    parameters = list(simulator.parameters)
    for mechanism in mechanisms:
        taken = {v.name for v in parameters}
        parameters += [
            replace(v, name=f"{mechanism.name}.{v.name}") if v.name in taken else v for v in mechanism.parameters
        ]
    return tuple(parameters)


def _part(simulator: Simulator, mechanism: Mechanism, number: int, state: int, parameter: int) -> _Part:
    if mechanism.term is None or bool(mechanism.states) != (mechanism.derivative is not None):
        raise ValueError(f"mechanism {mechanism.name!r}: a term is needed, and states with a derivative or neither")
    kind, _, target = mechanism.port.partition(":")
    ports = {
        "balance": simulator.states,
        "flux": simulator.fluxes,
        "output": simulator.outputs,
        "input": simulator.inputs,
    }
    if kind not in ports:
        raise ValueError(f"mechanism {mechanism.name!r}: port {mechanism.port!r} is none of {', '.join(ports)}")
    at = index_of(ports[kind], target, f"simulator {simulator.name!r} has no {kind}")
    return _Part(number, mechanism, kind, at, state, parameter)


def _source(simulator: Simulator, parts: Sequence[_Part], n_states: int) -> str:
    """The whole's ``rhs`` and ``output`` as Python source; functions are named after their part's number."""
    n, m = len(simulator.states), len(simulator.parameters)

    def added(kind: str, to: str, u: str) -> list[str]:
        return [
            f"    if theta[{p.parameter}] != {_absent(p.mechanism)!r}:\n"
            f"        {to}[{p.at}] += term_{p.number}({_own(p, n, m, u)})"
            for p in parts
            if p.kind == kind
        ]

    acted = ["    v = u.copy()", *added("input", "v", "u")]
    start = [f"    b, p = x[:{n}], theta[:{m}]", *acted]
    if simulator.flux is not None:
        rates = ["    f = np.asarray(flux(b, v, p)).copy()", *added("flux", "f", "v"), "    d = balance(b, v, p, f)"]
    else:
        rates = ["    d = rates(b, v, p)"]
    # Numbers one by one: numba takes a second to compile each assignment of a slice.
    rates += [f"    dx = np.zeros({n_states})", f"    for i in range({n}):", "        dx[i] = d[i]"]
    rates += added("balance", "dx", "v")
    for p in parts:
        if p.mechanism.states:
            rates.append(
                f"    if theta[{p.parameter}] != {_absent(p.mechanism)!r}:\n"
                f"        own_{p.number} = derivative_{p.number}({_own(p, n, m, 'v')})\n"
                f"        for i in range({len(p.mechanism.states)}):\n"
                f"            dx[{p.state} + i] = own_{p.number}[i]"
            )
    readings = ["    y = np.asarray(reading(b, v, p)).copy()", *added("output", "y", "v")]
    return "\n".join(
        ["def rhs(x, u, theta):", *start, *rates, "    return dx", "",
         "def output(x, u, theta):", *start, *readings, "    return y", ""]
    )  # fmt: skip


def _absent(mechanism: Mechanism) -> float:
    return float(mechanism.absent[0]) if mechanism.absent else 0.0


def _own(part: _Part, n: int, m: int, u: str) -> str:
    """The arguments of a mechanism's functions: the simulator's states and parameters, then its own."""
    states = (part.state, part.state + len(part.mechanism.states))
    parameters = (part.parameter, part.parameter + len(part.mechanism.parameters))
    return f"own(x, {n}, {states[0]}, {states[1]}), {u}, own(theta, {m}, {parameters[0]}, {parameters[1]})"


def _concatenated(v: Any, n: int, start: int, stop: int) -> Any:
    whole = np.empty(n + stop - start)
    for i in range(n):
        whole[i] = v[i]
    for i in range(start, stop):
        whole[n + i - start] = v[i]
    return whole


def _build(
    source: str, simulator: Simulator, parts: Sequence[_Part], prepare: Callable[[Any], Any]
) -> tuple[Equation, Equation]:
    """``rhs`` and ``output`` from their source, calling the functions as ``prepare`` leaves them."""
    names: dict[str, Any] = {"np": np, "own": prepare(_concatenated), "reading": prepare(simulator.output)}
    if simulator.flux is not None:
        names |= {"flux": prepare(simulator.flux), "balance": prepare(simulator.balance)}
    else:
        names["rates"] = prepare(simulator.rhs)
    for part in parts:
        names[f"term_{part.number}"] = prepare(part.mechanism.term)
        if part.mechanism.derivative is not None:
            names[f"derivative_{part.number}"] = prepare(part.mechanism.derivative)
    exec(source, names)  # our own text: port numbers and parameter places, nothing that a user wrote
    return names["rhs"], names["output"]


def plain_rhs(simulator: Simulator) -> Equation:
    """The simulator's ``rhs``, made from flux and balance where it is given as those."""
    return simulator.rhs if simulator.rhs is not None else compose(simulator, ()).rhs  # type: ignore[return-value]
