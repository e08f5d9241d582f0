"""Of what z is made: [n states, lags that follow one of them, nh coordinates of health, ny coloured noises, n slow
errors].

Record types are built from these sizes, and compiled code finds them again as the sizes of its model's arrays.
"""

from __future__ import annotations

from typing import NamedTuple

from numba import njit

from twinbench.machines.machine import Machine
from twinbench.machines.parts import Lag
from twinbench.methods.modes import count_of


class Parts(NamedTuple):
    """How much of what a machine has.

    Attributes:
        states: n, estimated ones.
        lags: that follow one of them.
        health: nh, parameters.
        outputs: ny.
        inputs: nu.
        query: entries of the operator's query.
        modes: of ``methods.modes``.
    """

    states: int
    lags: int
    health: int
    outputs: int
    inputs: int
    query: int
    modes: int

    @property
    def zeta(self) -> int:
        """Where health begins in z, and how many entries it acts on: states and lags."""
        return self.states + self.lags

    @property
    def noise(self) -> int:
        """Where the coloured noises begin in z."""
        return self.zeta + self.health

    @property
    def error(self) -> int:
        """Where the slow errors begin in z."""
        return self.noise + self.outputs

    @property
    def size(self) -> int:
        """Entries of z."""
        return self.error + self.states

    @property
    def channels(self) -> int:
        """Inputs and outputs."""
        return self.inputs + self.outputs


def parts_of(machine: Machine) -> Parts:
    """The sizes of a machine's z and of what belongs to it."""
    return Parts(
        states=len(machine.estimated),
        lags=len(followers(machine)),
        health=len(machine.health),
        outputs=len(machine.outputs),
        inputs=len(machine.inputs),
        query=len(machine.operating),
        modes=count_of(machine),
    )


def followers(machine: Machine) -> tuple[Lag, ...]:
    """Lags that follow an estimated state. What follows an input, the operator learns from its window."""
    return tuple(lag for lag in machine.lags if lag.follows in machine.estimated)


@njit(cache=True, error_model="numpy")
def places(model):  # type: ignore[no-untyped-def]
    """Where health, the coloured noises and the slow errors begin in z."""
    zeta = model.state_mean.size + model.lags.of.size
    noise = zeta + model.prior_sd.size
    return zeta, noise, noise + model.noise_keep.size
