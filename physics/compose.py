"""A simulator with mechanisms' terms added at their ports: again a simulator, compiled once for all of them.

The equations of the whole are written out as source (``physics.source``), so that sixty candidate terms make one
function, and their machine code is kept from process to process (``physics.native``). A term whose size is at its
absent value is not even called.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from twinbench.physics.native import executed, native
from twinbench.physics.simulator import Amplitude, Array, Equation, Mechanism, Simulator, Term, Variable
from twinbench.physics.source import Part, write

ONLY_STEPPED = "can only be stepped: it does not tell the rates of its states, and this needs them"
"""Why equations cannot be had of it."""


def compose(simulator: Simulator, mechanisms: Sequence[Term]) -> Simulator:
    """Append the mechanisms' parameters and states, and add their terms at their ports.

    The same call gives the same simulator, compiled once.

    Each term sees the simulator's own states and parameters, then its own. Switched off is a
    mechanism whose first parameter is at its ``absent`` value. A simulator with fluxes keeps them.

    Raises:
        ValueError: a port that does not exist, a name that is there twice, or a simulator that can only be stepped.
    """
    if simulator.stepped is not None:
        raise ValueError(f"simulator {simulator.name!r} {ONLY_STEPPED}; export it for model exchange")
    return _composed(simulator, tuple(mechanisms))


def with_mechanism(simulator: Simulator, mechanism: Mechanism) -> Simulator:
    """The same machine with a mechanism switched on at its nominal size; again a Simulator.

    Raises:
        ValueError: as ``compose``, amplitudes that the simulator does not have, or a fault that no equation can hold.
    """
    named = replace(simulator, mechanisms=(*simulator.mechanisms, mechanism.name))
    match mechanism:
        case Term():
            return compose(named, (mechanism,))
        case Amplitude():
            return named.with_values(**{v.name: v.nominal for v in mechanism.parameters})
    raise ValueError(f"mechanism {mechanism.name!r}: needs whole records, so no equations can hold it")


@functools.cache
def _composed(simulator: Simulator, mechanisms: tuple[Term, ...]) -> Simulator:
    parts = []
    n, m = len(simulator.states), len(simulator.parameters)
    for number, mechanism in enumerate(mechanisms):
        parts.append(_part(simulator, mechanism, number, n, m))
        n += len(mechanism.states)
        m += len(mechanism.parameters)
    text, called = write(simulator, parts, n)
    made = executed(text, called)
    for name in ("rhs", "output", "flux", "balance"):
        if name in made:
            # Compiled code calls compiled functions; a term that numba refuses leaves the plain ones.
            made[name].native = functools.partial(_native, name, text, tuple(called.items()))
    return replace(
        simulator,
        states=simulator.states + tuple(v for mechanism in mechanisms for v in mechanism.states),
        parameters=_named_once(simulator, mechanisms),
        rhs=made["rhs"],
        output=made["output"],
        flux=made.get("flux"),
        balance=made.get("balance"),
        initial=functools.partial(_initial, simulator, tuple(parts)),
    )


def _native(name: str, text: str, called: tuple[tuple[str, Callable[..., Any]], ...]) -> Any:
    return native(text, called)[name]


def _initial(simulator: Simulator, parts: Sequence[Part], u0: Array, y0: Array, theta: Array) -> Array:
    base = theta[: len(simulator.parameters)]
    x0 = np.asarray(simulator.initial(u0, y0, base), dtype=np.float64)
    whole = [x0]
    for part in parts:
        mechanism = part.mechanism
        own = np.array([v.nominal for v in mechanism.states])
        if mechanism.initial is not None:
            its = theta[part.parameter : part.parameter + len(mechanism.parameters)]
            own = np.asarray(mechanism.initial(np.concatenate((x0, own)), u0, np.concatenate((base, its))))
        whole.append(own)
    return np.concatenate(whole)


def _named_once(simulator: Simulator, mechanisms: Sequence[Term]) -> tuple[Variable, ...]:
    """All parameters; one whose name is taken gets its mechanism's name before it."""
    parameters = list(simulator.parameters)
    for mechanism in mechanisms:
        taken = {v.name for v in parameters}
        parameters += [
            replace(v, name=f"{mechanism.name}.{v.name}") if v.name in taken else v for v in mechanism.parameters
        ]
    return tuple(parameters)


def _part(simulator: Simulator, mechanism: Term, number: int, state: int, parameter: int) -> Part:
    into = mechanism.into.index(simulator) if mechanism.into is not None else -1
    return Part(number, mechanism, mechanism.port.index(simulator), state, parameter, into)


def plain_rhs(simulator: Simulator) -> Equation:
    """The simulator's ``rhs``, made from flux and balance where it is given as those.

    Raises:
        ValueError: it can only be stepped.
    """
    return simulator.rhs if simulator.rhs is not None else compose(simulator, ()).rhs  # type: ignore[return-value]
