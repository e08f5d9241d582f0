"""A simulator with a mechanism's term added at a port: again a simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from physics.compile import jit
from physics.simulator import Array, Equation, Mechanism, Simulator, index_of


def with_term(simulator: Simulator, mechanism: Mechanism) -> Simulator:
    """Append the mechanism's parameters and states, and add its term at its port.

    Raises:
        ValueError: the port does not exist, or states come without their derivative.
    """
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
        known = ", ".join(ports)
        raise ValueError(f"mechanism {mechanism.name!r}: port {mechanism.port!r} is none of {known}")
    at = index_of(ports[kind], target, f"simulator {simulator.name!r} has no {kind}")
    n_parameters = len(simulator.parameters)
    rhs, output = _at_port(simulator, kind, at, jit(mechanism.term))
    if mechanism.derivative is not None:
        rhs = _with_own_states(jit(rhs), jit(mechanism.derivative))

    def initial(u0: Array, y0: Array, theta: Array) -> Array:
        own = np.array([v.nominal for v in mechanism.states])
        return np.concatenate((simulator.initial(u0, y0, theta[:n_parameters]), own))

    return replace(
        simulator,
        states=simulator.states + mechanism.states,
        parameters=simulator.parameters + mechanism.parameters,
        rhs=rhs,
        output=output,
        initial=initial,
        fluxes=(),
        flux=None,
        balance=None,
    )


def _at_port(simulator: Simulator, kind: str, at: int, term: Callable[..., Any]) -> tuple[Equation, Equation]:
    """rhs and output of the simulator with the term acting on entry ``at`` of its port."""
    n, p = len(simulator.states), len(simulator.parameters)
    base_rhs, base_output = jit(plain_rhs(simulator)), jit(simulator.output)

    def same_rhs(x: Array, u: Array, theta: Array) -> Array:
        return np.asarray(base_rhs(x[:n], u, theta[:p]))

    def same_output(x: Array, u: Array, theta: Array) -> Array:
        return np.asarray(base_output(x[:n], u, theta[:p]))

    if kind == "input":

        def input_rhs(x: Array, u: Array, theta: Array) -> Array:
            acted = u.copy()
            acted[at] += term(x, u, theta)
            return base_rhs(x[:n], acted, theta[:p])

        def input_output(x: Array, u: Array, theta: Array) -> Array:
            acted = u.copy()
            acted[at] += term(x, u, theta)
            return base_output(x[:n], acted, theta[:p])

        return input_rhs, input_output

    if kind == "output":

        def output_output(x: Array, u: Array, theta: Array) -> Array:
            y = base_output(x[:n], u, theta[:p])
            y[at] += term(x, u, theta)
            return y

        return same_rhs, output_output

    if kind == "flux":
        flux, balance = jit(simulator.flux), jit(simulator.balance)

        def flux_rhs(x: Array, u: Array, theta: Array) -> Array:
            f = flux(x[:n], u, theta[:p])
            f[at] += term(x, u, theta)
            return balance(x[:n], u, theta[:p], f)

        return flux_rhs, same_output

    def balance_rhs(x: Array, u: Array, theta: Array) -> Array:
        dx = base_rhs(x[:n], u, theta[:p])
        dx[at] += term(x, u, theta)
        return dx

    return balance_rhs, same_output


def _with_own_states(rhs: Callable[..., Any], derivative: Callable[..., Any]) -> Equation:
    def extended(x: Array, u: Array, theta: Array) -> Array:
        return np.concatenate((rhs(x, u, theta), derivative(x, u, theta)))

    return extended


def plain_rhs(simulator: Simulator) -> Equation:
    """The simulator's ``rhs``, made from flux and balance where it is given as those."""
    if simulator.rhs is not None:
        return simulator.rhs
    flux, balance = jit(simulator.flux), jit(simulator.balance)

    def rhs(x: Array, u: Array, theta: Array) -> Array:
        return balance(x, u, theta, flux(x, u, theta))

    return rhs
