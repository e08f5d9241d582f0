"""What a hypothesis foretells of readings that it has not seen, against densities written out in full."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motor_friction import friction_found
from scipy.stats import multivariate_normal

from twinbench.mismatch.calibrate import own_unknowns
from twinbench.mismatch.naming.effect import Effect
from twinbench.mismatch.naming.foretold import UNFORETOLD, density, foretold
from twinbench.mismatch.naming.settle import Settled, settled
from twinbench.mismatch.variants import Variant, typical


def told(hypothesis: Settled, shift: float = 0.0) -> float:
    """Of the held-out recording of the motor, its readings shifted by so many sds of the noise."""
    d = friction_found().diagnosis
    own, ground = own_unknowns(d.simulator, d.held), d.answer.naming.ground
    tracks = [replace(t, means=t.means + shift * d.noise_sd) for t in d.held]
    return foretold(hypothesis, ground, tracks, own, d.held_before.own)


def test_the_density_is_that_of_a_gaussian_written_out():
    rng = np.random.default_rng(3)
    white = rng.normal(size=(12, 2, 5))
    X, y = white.reshape(24, 5)[:, :-1], white.reshape(24, 5)[:, -1]
    whole = multivariate_normal(np.zeros(24), np.eye(24) + X @ X.T)
    assert density(white) == pytest.approx(whole.logpdf(y) + 12.0 * np.log(2.0 * np.pi))


def test_what_is_there_foretells_the_held_out_recording_better_than_nothing_does():
    naming = friction_found().diagnosis.answer.naming
    assert told(naming.best) > told(naming.null) + 20.0


def test_readings_that_are_shifted_are_foretold_worse():
    best = friction_found().diagnosis.answer.naming.best
    assert told(best, 3.0) < told(best) - 20.0


def test_what_is_not_there_foretells_less():
    d = friction_found().diagnosis
    (which,) = (i for i, c in enumerate(d.machine.candidates) if c.name == "offset@omega_rad_s")
    sd = abs(typical(d.machine.candidates[which]))
    ground = d.answer.naming.ground
    wrong = settled(*d.before, [Effect(Variant(which, ()), 0.1, sd, -2.0)], ground, ground.s)
    assert told(wrong) < told(d.answer.naming.best) - 20.0


def test_a_run_beyond_all_numbers_foretells_nothing():
    best = friction_found().diagnosis.answer.naming.best
    z = best.z.copy()
    z[[u.name for u in best.problem.unknowns].index("J_kg_m2")] = -1.0
    assert told(replace(best, z=z)) == UNFORETOLD
