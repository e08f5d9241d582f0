"""The compressor where its health is known: five inputs more, in place of five parameters that drift."""

from __future__ import annotations

from dataclasses import replace

from numba import njit

from twinbench.physics import compressor
from twinbench.physics.compressor import HEALTH, INPUTS
from twinbench.physics.jit import jit
from twinbench.physics.simulator import Array, Simulator

N_INPUTS, N_HEALTH = len(INPUTS), len(HEALTH)
_output = jit(compressor.output)


def with_known_health(simulator: Simulator) -> Simulator:
    """A simulator with the compressor's equations that reads its health off the recordings.

    The inputs (9,) are the machine's own four, then the five of HEALTH, each in its unit. The parameters stay where
    they are, but those of HEALTH no longer act.
    """
    return replace(
        simulator,
        inputs=simulator.inputs + HEALTH,
        rhs=None,
        flux=_flux,
        balance=_balance,
        output=_read,
        initial=_initial,
        drifts=(),
    )


@njit(cache=True, error_model="numpy")
def _at(theta, u):  # type: ignore[no-untyped-def]
    """Parameters (np,) with the recorded health, which stands first among them."""
    theta = theta.copy()
    theta[:N_HEALTH] = u[N_INPUTS:]
    return theta


@njit(cache=True, error_model="numpy")
def _flux(x, u, theta):  # type: ignore[no-untyped-def]
    return compressor.flux(x, u[:N_INPUTS], _at(theta, u))


@njit(cache=True, error_model="numpy")
def _balance(x, u, theta, f):  # type: ignore[no-untyped-def]
    return compressor.balance(x, u[:N_INPUTS], _at(theta, u), f)


@njit(cache=True, error_model="numpy")
def _read(x, u, theta):  # type: ignore[no-untyped-def]
    return _output(x, u[:N_INPUTS], _at(theta, u))


def _initial(u0: Array, y0: Array, theta: Array) -> Array:
    """A warm machine at the first reading.

    Args:
        u0: (9,) first inputs in their units, the health last.
        y0: (3,) first readings in their units.
        theta: (np,) in the parameters' units.
    """
    return compressor.initial(u0[:N_INPUTS], y0, _at(theta, u0))
