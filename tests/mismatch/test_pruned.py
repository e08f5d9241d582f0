"""All physics at once, then fewer: several effects that cover each other, and odds that one of them is needless."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record

from twinbench.mismatch.asked import Asked
from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.naming.answer import name_of
from twinbench.mismatch.naming.name import Naming, all_physics
from twinbench.mismatch.naming.pruned import all_at_once, odds_without
from twinbench.mismatch.naming.settle import Settled, settled
from twinbench.mismatch.naming.weighed import weighed

SIZES = {
    "offset@current_A": 60.0,
    "quadratic_loss@current_A": 0.02,
    "coulomb_friction@omega_rad_s": 8.0,
    "offset@T_winding_K": 0.8,
}


def four(t, x, u):
    """Written out here on its own."""
    loss = SIZES["quadratic_loss@current_A"] * x[0] * abs(x[0])
    friction = SIZES["coulomb_friction@omega_rad_s"] * np.tanh(x[1] / 0.5)
    return np.array([SIZES["offset@current_A"] - loss, -friction, SIZES["offset@T_winding_K"]])


@cache
def naming() -> Naming:
    several = [record(f"run {s}", s, four) for s in (1, 2, 3)]
    return weighed(Asked(MOTOR, several[:2], several[2:], generic(MOTOR))).answer.naming


@cache
def left_over() -> Settled:
    null, everything = naming().null, all_physics(naming())
    assert len(everything) > 3 * len(SIZES)
    return all_at_once(null.problem, null.z, everything, naming().ground)


def names(found: Settled) -> list[str]:
    return [name_of(found.problem.machine, e) for e in found.effects]


def test_what_is_left_of_all_at_once_is_what_is_there_or_contains_it():
    found = left_over().problem.machine.candidates
    contains = {c.name: c.mechanism.contains or c.name for c in found}
    assert {contains[name] for name in names(left_over())} == set(SIZES)


def test_what_is_there_is_the_likeliest_of_all():
    found = naming().best
    assert set(names(found)) == set(SIZES)
    for name, size, sd in zip(names(found), found.sizes, found.sds, strict=True):
        assert size == pytest.approx(SIZES[name], abs=3.0 * sd)
        assert sd < 0.3 * SIZES[name]


def test_the_odds_of_an_effects_absence_are_the_evidence_without_it():
    exact = naming().ground.exact
    found = left_over()
    more = [e for e in all_physics(naming()) if name_of(found.problem.machine, e) == "offset@omega_rad_s"]
    whole = settled(found.bare, found.own, [*found.now, *more], exact, exact.s)
    needless = names(whole).index("offset@omega_rad_s")
    less = settled(whole.bare, whole.own, whole.now[:needless], exact, exact.s)
    assert odds_without(whole)[needless] == pytest.approx(less.log - whole.log, abs=1.0)
    assert (np.delete(odds_without(whole), needless) < -5.0).all()


def test_on_an_exact_ground_the_sizes_of_effects_are_the_same_everywhere():
    found, exact = left_over(), naming().ground.exact
    again = settled(found.bare, found.own, found.now, exact, exact.s)
    assert len(again.mean) == len(again.z)
