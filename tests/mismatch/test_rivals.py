"""What cannot be told apart: losses on fitted and on other recordings, and names for one thing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from motor import MOTOR
from motor_case import NOISE, record

from twinbench.mismatch.calibrate import own_unknowns, shared_unknowns
from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.explanation import Explanation, refit
from twinbench.mismatch.fit import Problem
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.noise import Whitener
from twinbench.mismatch.picture import picture, variants
from twinbench.mismatch.proof import held_out
from twinbench.mismatch.rivals import NEAR_UNITS, rivals
from twinbench.mismatch.solve import solve
from twinbench.mismatch.tracks import prepare

NAMES = ("coulomb_friction@omega_rad_s", "quadratic_friction@omega_rad_s", "offset@omega_rad_s")


@pytest.fixture(scope="module")
def fits():
    """The calibrated motor, and one explanation by dry friction, of recordings with dry friction; the friction."""
    listed = tuple(m for m in generic(MOTOR) if m.name in NAMES)
    machine = Machine(MOTOR, listed)

    def dry(t, x, u):
        return np.array([0.0, -4.0 * np.tanh(x[1] / 2.0), 0.0])

    tracks = prepare([record(f"run {k}", k, dry) for k in (1, 2)], MOTOR)
    machine.settle_step(tracks, NOISE)
    unknowns = (*shared_unknowns(MOTOR), *own_unknowns(MOTOR, tracks))
    problem = Problem(machine, tracks, unknowns, Whitener(np.zeros((3, 0)), NOISE))
    z, cost = solve(problem, problem.z0)
    choices = variants(machine.candidates)
    shown = picture(problem, z, choices)
    (dry_one,) = (i for i, v in enumerate(shown.variants) if machine.candidates[v.candidate].name == NAMES[0])
    return Explanation((), (), problem, z, cost), refit(problem, z, shown, (dry_one,), rounds=3), dry


def other(best: Explanation, name: str, behind: float) -> Explanation:
    return dataclasses.replace(best, names=(name,), cost=best.cost + behind)


def test_what_lies_far_behind_on_other_recordings_is_no_rival(fits):
    before, best, _ = fits
    near, far = other(best, NAMES[1], 3.0), other(best, NAMES[2], 3.0)
    (both,) = rivals(before, best, [near, far])
    assert both.names == [NAMES[2], NAMES[1]]
    (one,) = rivals(before, best, [near, far], lambda e: 100.0 if e is far else 0.0)
    assert one.names == [NAMES[1]]
    (back,) = rivals(before, best, [other(best, NAMES[1], 50.0)], lambda e: -40.0)
    assert back.names == [NAMES[1]]


def test_names_for_one_thing_count_once(fits):
    before, best, _ = fits
    twins = [other(best, NAMES[1], 4.0), other(best, NAMES[2], 4.1)]
    assert rivals(before, best, twins)[0].things == 2
    assert rivals(before, best, [twins[0], other(best, NAMES[2], 6.0)])[0].things == 3
    assert rivals(before, best, [])[0] == ([], 1, ((NAMES[0],),))


def test_more_effects_have_no_form_to_excuse(fits):
    before, best, _ = fits
    pair = dataclasses.replace(best, names=NAMES[1:], chosen=best.chosen * 2, cost=best.cost)
    assert pair.score(16.0) - best.score(16.0) > NEAR_UNITS
    assert rivals(before, best, [pair])[0].names == []


def test_what_stands_for_another_effect_is_no_rival(fits, monkeypatch):
    """Best a + b; a2 does for a, and without b nearly as well: a2 is no name for b."""
    before, alone, _ = fits
    a, b, a2 = NAMES
    monkeypatch.setattr("twinbench.mismatch.rivals._tied", lambda best: np.zeros((2, 2), bool))
    best = dataclasses.replace(alone, names=(a, b), chosen=alone.chosen * 2)
    swap = dataclasses.replace(best, names=(a2, b), cost=best.cost + 2.0)
    less = dataclasses.replace(alone, names=(a2,), cost=best.cost + 18.0)
    of_a, of_b = rivals(before, best, [swap, less])
    assert a2 in of_a.names
    assert a2 not in of_b.names


def test_a_held_out_fit_does_not_depend_on_whose_columns_it_begins_with(fits):
    _, best, dry = fits
    tracks = prepare([record("held", 7, dry, reach=1.3)], MOTOR)
    own = own_unknowns(MOTOR, tracks)
    alone = held_out(best.problem, best.z, tracks, own)
    elsewhere = alone._replace(own=[z + 5.0 for z in alone.own], columns=[-c for c in alone.columns])
    from_there = held_out(best.problem, best.z, tracks, own, elsewhere)
    assert from_there.rmse == pytest.approx(alone.rmse, rel=2e-3)
