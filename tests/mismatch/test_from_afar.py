"""Hypotheses that lie far from the calibrated simulator: in time, and where a run breaks off."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record

from twinbench.data.recording import Recording
from twinbench.mismatch import Verdict, diagnose
from twinbench.mismatch.asked import Asked
from twinbench.mismatch.model import load_simulator
from twinbench.mismatch.naming.effect import Effect
from twinbench.mismatch.naming.misfit import diverged
from twinbench.mismatch.naming.settle import SETTLED, settled
from twinbench.mismatch.naming.weighed import weighed
from twinbench.mismatch.place import Place
from twinbench.mismatch.variants import Variant
from twinbench.proof.real_recordings import ROOT

OPENED_S, RATE_1_S = 7.3, 0.08
"""When a valve is opened, and the share of the pressure that is then lost."""
OMEGA = 1


@functools.cache
def verdict() -> Verdict:
    rng = np.random.default_rng(5)
    time_s = np.arange(0.0, 120.0, 0.1)
    p_bar = 7.5 * np.exp(-RATE_1_S * np.maximum(time_s - OPENED_S, 0.0))
    readings = p_bar + 0.004 * rng.normal(size=time_s.size)
    chamber = load_simulator(str(ROOT / "examples" / "air_chamber.py"))
    return diagnose(chamber, [Recording("run", time_s, ("p_gauge_bar",), readings[:, None])])


def test_the_calibrated_simulator_is_far_off():
    assert verdict().diagnosis.answer.naming.far


def test_a_leak_that_begins_is_found_with_its_beginning():
    best = verdict().diagnosis.answer.chosen
    assert [best.problem.machine.candidates[c].name for c in best.candidates] in (
        ["linear_leak@p_bar"],
        ["overflow@p_bar"],  # over a floor at nothing it is the same
    )
    assert best.since_s == pytest.approx(OPENED_S, abs=0.5)
    assert best.sizes[0] == pytest.approx(RATE_1_S, rel=0.03)


def test_the_mended_simulator_errs_by_little_more_than_the_noise():
    learnt, held_out = verdict().fit
    assert learnt.rmse_after < 0.01 < 0.5 < learnt.rmse_before
    assert held_out.rmse_after < 0.01 < 0.1 < held_out.rmse_before


def test_what_begins_where_the_machine_runs_away_comes_back():
    """A torque that feeds on the speed, far larger where its fit begins than the machine survives; there is none."""
    state = MOTOR.states[OMEGA]
    place = Place(OMEGA, state, state.scale / 2.0)

    def runaway(x, u, theta):
        return theta[-1] * x[OMEGA] * abs(x[OMEGA])

    size = place.size("runaway", "1/rad", place.reach**2, generous=1e6)
    torque = place.add("runaway", "a torque feeds on the speed", "{0} omega |omega|", runaway, size)
    asked = weighed(Asked(MOTOR, [record("one", 1)], [record("two", 2)], (torque,)))
    ground, problem, z = asked.answer.naming.ground, asked.fit.problem, asked.fit.z
    large = Effect(Variant(0, ()), size.high, size.scale, -1.0)
    found = settled(problem, z, [large], ground, ground.s)
    whole = found.problem
    assert diverged(whole, whole.residuals(np.append(z, size.high))), "it does run away there"
    near = settled(problem, z, [replace(large, size=0.0)], ground, ground.s)
    assert found.log == pytest.approx(near.log, abs=3.0 * SETTLED)
    assert found.sizes == pytest.approx(near.sizes, abs=float(near.sds[0]))
