"""What tells innovations from white noise: bands of frequencies, against closed forms and against chance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motor_friction import friction_found

from twinbench.mismatch.naming.effect import Effect
from twinbench.mismatch.naming.settle import Settled, settled
from twinbench.mismatch.naming.whiteness import Coloured, coloured, told_band
from twinbench.mismatch.variants import Variant, typical

N = 1024


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=N)


def test_white_noise_is_seldom_told_from_white_noise():
    nats = np.array([told_band(noise(seed)).nats for seed in range(400)])
    assert np.mean(nats > 0.0) < 0.5
    assert np.mean(nats > 3.0) < 0.05, "one in e^3"


@pytest.mark.parametrize("amplitude", [0.5, 1.0])
def test_a_line_tells_by_its_power(amplitude):
    line = amplitude * np.sin(2.0 * np.pi * 40.0 * np.arange(N) / N)
    power = 0.25 * N * amplitude**2
    found = np.mean([told_band(noise(seed) + line).nats for seed in range(50)])
    assert found == pytest.approx(power - np.log(power) - np.log(3 * N / 2), abs=0.1 * power)
    band = told_band(noise(0) + line)
    assert band.lowest <= 40 <= band.highest <= band.lowest + 1
    assert band.power > 0.2 * power


@pytest.mark.parametrize("ratio", [0.7, 1.3])
def test_more_or_less_power_everywhere_tells(ratio):
    found = np.mean([told_band(np.sqrt(ratio) * noise(seed)).nats for seed in range(50)])
    half = N / 2 - 1  # bands are as wide as a power of two at most
    assert found == pytest.approx(half / 2.0 * (ratio - 1.0 - np.log(ratio)) - np.log(3 * N / 2), abs=6.0)


def test_a_series_too_short_to_tell_anything_tells_nothing():
    assert told_band(np.ones(2)).nats <= 0.0 >= told_band(np.empty(0)).nats


def hypothesis(hum: float) -> Settled:
    """The friction that is there, on readings in which the first output hums too, by so many noise sds."""
    d = friction_found().diagnosis
    problem, z = d.before
    (which,) = (i for i, c in enumerate(d.machine.candidates) if c.name == "coulomb_friction@omega_rad_s")
    ground = d.answer.naming.ground
    first = np.eye(len(ground.variance))[0] * np.sqrt(ground.variance)
    tracks = [t.reading(t.y + hum * np.sin(t.time_s)[:, None] * first) for t in problem.tracks]
    sd = abs(typical(d.machine.candidates[which]))
    effect = Effect(Variant(which, ()), 1.2, sd, -2.0)
    return settled(replace(problem, tracks=tracks), z, [effect], ground, ground.s)


def told(hum: float) -> Coloured:
    return coloured(hypothesis(hum), friction_found().diagnosis.answer.naming.ground)


def test_a_hum_that_no_state_makes_is_seen_and_noise_is_not():
    assert told(0.0).nats < 5.0
    heard = told(2.0)
    assert heard.nats > 50.0
    assert heard.channel == 0
    assert heard.swings_with(2.0 * np.pi)
    assert not heard.swings_with(3.0)


@pytest.mark.parametrize(("nats", "power", "sure"), [(9.9, 4.0, False), (10.1, 4.0, True), (10.1, 0.5, False)])
def test_what_is_not_beyond_doubt_or_softer_than_noise_is_no_hum(nats, power, sure):
    colour = Coloured(nats, 0, power, 7.0, 8.0)
    assert colour.sure == colour.swings_with(7.5) == sure
