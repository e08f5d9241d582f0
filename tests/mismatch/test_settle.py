"""A hypothesis brought to its own fixed point, from near and far."""

from __future__ import annotations

import numpy as np
import pytest
from motor import MOTOR
from motor_friction import friction_found

from twinbench.mismatch.mixture import Mixture
from twinbench.mismatch.naming.settle import SETTLED, Effect, Settled, settled
from twinbench.mismatch.variants import Variant, typical

SIZE = 1.2
"""Of the dry friction that is there, rad/s^2."""


def hypothesis(size: float, name: str = "coulomb_friction@omega_rad_s") -> Settled:
    d = friction_found().diagnosis
    (which,) = (i for i, c in enumerate(d.machine.candidates) if c.name == name)
    sd = abs(typical(d.machine.candidates[which]))
    naming = d.answer.naming
    return settled(*d.before, [Effect(Variant(which, ()), size, sd, -2.0)], naming.ground, naming.ground.s)


@pytest.mark.parametrize("size", [0.0, 0.3, 3.0])
def test_a_known_size_is_found_wherever_it_begins(size):
    found = hypothesis(size)
    assert found.sizes[0] == pytest.approx(SIZE, rel=0.08)
    assert found.sds[0] < 0.1 * SIZE
    assert found.at[found.entries(0)][0] == pytest.approx(found.sizes[0])
    true = {"R_ohm": 0.65, "J_kg_m2": 1.35}
    for k, u in enumerate(found.problem.unknowns):
        if u.name in true:
            assert found.at[k] == pytest.approx(true[u.name], rel=0.01)


def test_its_evidence_is_the_same_wherever_it_begins():
    logs = [hypothesis(size).log for size in (0.0, 0.3, 3.0)]
    assert np.ptp(logs) < 3.0 * SETTLED


def test_what_is_there_is_likelier_than_nothing_and_what_is_not_is_less_likely():
    null = friction_found().diagnosis.answer.naming.null
    assert hypothesis(1.0).log > null.log + 50.0
    assert hypothesis(0.0, "sensor_gain@T_probe_K").log < null.log


def test_where_it_stands_its_residuals_are_those_of_runs_sample_by_sample():
    """What blocks leave out under an effect is another than without: stale, it drives the size away from the truth."""
    found = hypothesis(0.3)
    for r, residual in enumerate(found.problem.residuals(found.z)):
        track = found.problem.tracks[r]
        exact = track.means - track.block_means(found.problem.readings(r, found.z))
        assert residual == pytest.approx(exact, abs=1e-9, nan_ok=True)


def test_the_null_is_the_problem_as_it_was():
    null = friction_found().diagnosis.answer.naming.null
    assert null.effects == ()
    assert len(null.at) == null.first == len(null.bare.unknowns)
    assert {u.name for u in null.problem.unknowns if u.kind == "parameter"} == {v.name for v in MOTOR.parameters}


def test_an_interval_of_a_mixture_holds_nine_tenths():
    rng = np.random.default_rng(0)
    mixture = Mixture(np.array([0.7, 0.3]), np.array([0.0, 5.0]), np.array([1.0, 0.2]))
    which = rng.random(200_000) < 0.7
    drawn = np.where(which, rng.normal(0.0, 1.0, 200_000), rng.normal(5.0, 0.2, 200_000))
    low, high = mixture.interval()
    assert (low, high) == pytest.approx(np.quantile(drawn, (0.05, 0.95)), abs=0.02)
    assert mixture.interval(0.0, 4.0) == (0.0, 4.0)
