"""Where what an effect remembers starts is unknown, recording by recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record

from twinbench.mismatch.asked import Asked
from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.heat import second_thermal_mass
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.naming.effect import Effect, memory_starts
from twinbench.mismatch.naming.settle import Settled, settled
from twinbench.mismatch.naming.view import View
from twinbench.mismatch.naming.weighed import weighed
from twinbench.mismatch.place import Place
from twinbench.mismatch.variants import Variant
from twinbench.physics.simulator import Array

EXCHANGE_1_S, TAU_S = 0.02, 60.0
AHEAD_K = 12.0, -8.0, 5.0
"""How much warmer the second mass is than the winding when each recording begins."""
WINDING = 2


@dataclass
class Frame:
    """A second mass beside the winding, written out here on its own."""

    T_K: float
    at_s: float = 0.0

    def __call__(self, t: float, x: Array, u: Array) -> Array:
        self.T_K += (t - self.at_s) * (x[WINDING] - self.T_K) / TAU_S
        self.at_s = t
        return np.array([0.0, 0.0, -EXCHANGE_1_S * (x[WINDING] - self.T_K)])


@pytest.fixture(scope="module")
def found() -> Settled:
    several = [record(f"run {s}", s, Frame(305.0 + ahead)) for s, ahead in enumerate(AHEAD_K)]
    state = MOTOR.states[WINDING]
    mass = second_thermal_mass(Place(WINDING, state, state.scale / 60.0))
    asked = weighed(Asked(MOTOR, several[:2], several[2:], (mass,)))
    ground, problem, z = asked.answer.naming.ground, asked.fit.problem, asked.fit.z
    return settled(problem, z, [Effect(Variant(0, (TAU_S,)), 0.01, 0.05, -1.0)], ground, ground.s)


def test_its_size_is_found_where_it_does_not_start_in_balance(found: Settled) -> None:
    assert found.sizes[0] == pytest.approx(EXCHANGE_1_S, abs=2.5 * found.sds[0])
    assert found.sds[0] < 0.25 * EXCHANGE_1_S


def test_so_is_where_it_starts(found: Settled) -> None:
    starts = [k for k in found.entries(0) if found.problem.unknowns[k].kind == "start"]
    assert [found.problem.unknowns[k].recording for k in starts] == [0, 1]
    assert found.at[starts] == pytest.approx(AHEAD_K[:2], abs=3.0)


def test_its_column_is_that_of_forward_runs(found: Settled) -> None:
    problem, z = found.problem, found.z
    (k, _) = [k for k in found.entries(0) if problem.unknowns[k].kind == "start"]
    column = View.around(problem, z).unknowns()[0][:, WINDING, k] / problem.unknowns[k].sd
    ahead, back = z.copy(), z.copy()
    ahead[k] += 0.1
    back[k] -= 0.1
    change = (problem.residual(0, back) - problem.residual(0, ahead))[:, WINDING] / 0.2
    assert np.abs(column - change).max() < 0.01 * np.abs(change).max()


def test_what_counts_time_has_no_start_of_its_own() -> None:
    (force,) = (m for m in generic(MOTOR) if m.name == "periodic@omega_rad_s")
    machine = Machine(MOTOR, [force])
    assert len(machine.own_states(machine.candidates[0])) == 1
    assert memory_starts(machine, [Effect(Variant(0, (5.0, 0.0)), 1.0, 1.0, 0.0)], 2) == []
