"""Is what an explanation adds in the held-out readings, whatever else is in them?"""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.mismatch.noise import HIGHEST_LEVEL, levels
from twinbench.mismatch.proof import BorneOut, Gain, Held, borne_out, gain
from twinbench.mismatch.weigh import refusal

RNG = np.random.default_rng(3)
N = 600
EFFECT = np.sin(np.arange(N) / 9.0)[:, None] * np.array([1.0, 0.5])
RIPPLE = 1.2 * np.cos(np.arange(N) / 31.0)[:, None] * np.array([1.0, 1.0])
NOISE = 0.3 * RNG.normal(size=(N, 2))
VARIANCE = np.full(2, 0.09)


def held(residual: np.ndarray) -> Held:
    return Held([residual], np.sqrt(np.mean(residual**2, axis=0)), [], [], [1.0])


@pytest.mark.parametrize(("share", "ratio"), [(1.0, 1.0), (0.0, -1.0), (0.5, 0.0)])
def test_the_error_falls_by_the_square_of_what_is_there(share, ratio):
    before, after = held(share * EFFECT + NOISE), held(share * EFFECT + NOISE - EFFECT)
    found = borne_out(before, after, VARIANCE)
    assert found.ratio == pytest.approx(ratio, abs=0.05)
    assert found.low <= found.ratio <= found.high


def test_what_nobody_models_hides_the_share_of_an_effect_but_not_that_it_is_there():
    before, after = held(EFFECT + RIPPLE + NOISE), held(RIPPLE + NOISE)
    share = gain(before, after, VARIANCE)
    assert share.share < 0.5
    assert refusal(share, borne_out(before, after, VARIANCE)) == ""
    absent = borne_out(held(RIPPLE + NOISE), held(RIPPLE + NOISE - EFFECT), VARIANCE)
    assert refusal(share, absent).startswith("on held-out recordings it removes")


def test_noisier_sensors_in_another_regime_are_not_held_against_a_model():
    louder = np.sqrt(1.7) * NOISE
    small = 0.3 * EFFECT
    level = levels([small + NOISE], [small + louder])[0]
    assert level == pytest.approx(1.7, rel=0.25)
    before, after = (held(r)._replace(level=[level]) for r in (small + louder, louder))
    assert gain(before, after, VARIANCE).share == pytest.approx(1.0, abs=0.25)
    unaware = gain(held(small + louder), held(louder), VARIANCE)
    assert unaware.share < 0.5


def test_what_may_be_chance_is_the_usual_noise_and_what_is_far_more_is_no_noise():
    assert levels([NOISE], [1.05 * NOISE, 0.5 * NOISE])[0] == pytest.approx(1.0)
    assert levels([NOISE], [1.05 * NOISE, 0.5 * NOISE])[1] == pytest.approx(1.0)
    assert levels([NOISE], [10.0 * NOISE])[0] == pytest.approx(HIGHEST_LEVEL)
    assert levels([0.0 * NOISE], [NOISE])[0] == pytest.approx(1.0)


def test_where_a_model_diverges_the_rest_is_compared():
    before = EFFECT + NOISE
    before[:300] = np.nan
    after = NOISE
    assert borne_out(held(before), held(after), VARIANCE).ratio == pytest.approx(1.0, abs=0.05)
    assert gain(held(before), held(after), VARIANCE).share == pytest.approx(1.0, abs=0.05)


def test_little_is_not_plain():
    small = Gain(0.3, 0.2, 0.4, 0.5)
    assert refusal(small, BorneOut(1.0, 0.9, 1.1, 150.0))
    assert not refusal(small, BorneOut(1.0, 0.9, 1.1, 250.0))
    assert refusal(small, BorneOut(1.6, 0.9, 2.1, 250.0))
