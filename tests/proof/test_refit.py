"""The ideal observer's fits: what is one thing comes to nothing, what the background does is taken off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import toeplitz
from short_machines import SHORT, measured

from twinbench.mismatch.variants import Variant, switched
from twinbench.proof.concealed.changes import change_of
from twinbench.proof.concealed.columns import Picture
from twinbench.proof.concealed.machine import Noise
from twinbench.proof.concealed.observer import TOLD_SQ, observe
from twinbench.proof.concealed.on_twin import OnTwin
from twinbench.proof.concealed.refit import NOTHING, noise_of_means, refitted
from twinbench.proof.concealed.severity import Yardstick

LEAK, BIAS, OFFSET, DELAY = "leak@h1_cm", "input_bias@pump_V", "offset@h1_cm", "sensor_delay@level2_cm"


def what(yardstick: Yardstick, name: str, size: float, run: OnTwin) -> dict[int, np.ndarray]:
    effect = yardstick.machine.effect(name)
    made = change_of(yardstick, effect, run.onset_s).of(size)
    return {i: made[i] - yardstick.base[i] for i in run.tracks}


@pytest.fixture(scope="module")
def tanks() -> OnTwin:
    return OnTwin(measured(SHORT["two_tanks"]), -np.inf)


def test_an_effect_comes_to_nothing_by_its_own_form_and_far_from_nothing_without(tanks: OnTwin) -> None:
    found = refitted(tanks, what(tanks.yardstick, LEAK, 0.03, tanks), [], 0.0, [NOTHING, LEAK, DELAY])
    assert found[LEAK] < 1e-3
    assert found[LEAK] + 10.0 < found[DELAY] < found[NOTHING]


def test_a_periodic_force_next_door_is_tried_with_the_period_that_is_there(tanks: OnTwin) -> None:
    change = what(tanks.yardstick, "periodic@h1_cm", 0.05, tanks)
    found = refitted(tanks, change, [], 0.0, [NOTHING, "periodic@h1_cm", "periodic@h2_cm"])
    assert found["periodic@h1_cm"] < 0.2 * found[NOTHING]
    assert found["periodic@h1_cm"] < found["periodic@h2_cm"] < found[NOTHING]


@pytest.mark.parametrize("quarter", range(4))
def test_a_periodic_force_is_found_whatever_its_phase_and_however_short_its_period(tanks: OnTwin, quarter: int) -> None:
    """Two phases would leave half of all forces unfound, and the catalogue's range does not hold every period."""
    name = "periodic@h2_cm"
    at = next(i for i, c in enumerate(tanks.twin.candidates) if c.name == name)
    size, (_, period, _) = 0.02, tanks.twin.candidates[at].mechanism.parameters
    assert period.low > 25.0, "the first period is out of range"
    for told_s in (25.0, 60.0):
        theta = switched(tanks.twin, tanks.twin.theta, Variant(at, (told_s, -2.5 + 0.5 * np.pi * quarter)), size)
        change = {i: tanks.readings(t, theta) - t.y for i, t in tanks.tracks.items()}
        found = refitted(tanks, change, [], 0.0, [NOTHING, name])
        assert found[name] < 0.02 * found[NOTHING]


def test_what_two_names_call_one_thing_comes_to_nothing_by_either(tanks: OnTwin) -> None:
    found = refitted(tanks, what(tanks.yardstick, "dead_zone@pump_V", 0.3, tanks), [], 0.0, [NOTHING, BIAS, OFFSET])
    assert max(found[BIAS], found[OFFSET]) < 1.0 < found[NOTHING]


def test_what_the_background_or_another_effect_may_be_is_taken_off(tanks: OnTwin) -> None:
    change = what(tanks.yardstick, LEAK, 0.03, tanks)
    alone = refitted(tanks, change, [], 0.0, [NOTHING])[NOTHING]
    rippled = refitted(tanks, change, [], 1.0, [NOTHING])[NOTHING]
    beside = refitted(tanks, change, [{i: 0.5 * c for i, c in change.items()}], 0.0, [NOTHING])[NOTHING]
    assert rippled < 0.9 * alone
    assert beside < 0.01 * alone


@settings(max_examples=20, deadline=None)
@given(white=st.floats(0.1, 2.0), coloured=st.floats(0.0, 2.0), tau=st.floats(0.3, 30.0), block=st.integers(1, 12))
def test_noise_of_means_is_that_of_the_samples_covariance(
    white: float, coloured: float, tau: float, block: int
) -> None:
    machine = SHORT["two_tanks"]
    changed = machine.noise | dict.fromkeys(machine.outputs, Noise(white, coloured, tau))
    made = type(machine)(**{**machine.__dict__, "noise": changed})
    lags = np.arange(block) * machine.period_s
    covariance = coloured**2 * toeplitz(np.exp(-lags / tau))
    lsb2 = np.array([machine.lsb[name] ** 2 / 12.0 for name in machine.outputs])
    found = noise_of_means(made, block)
    assert found.coloured == pytest.approx(covariance.mean(), rel=1e-9, abs=1e-12)
    assert found.white == pytest.approx((white**2 + lsb2) / block)


def test_the_observer_takes_distances_from_fits_where_it_has_them() -> None:
    columns = np.stack([[100.0, 0.0, 0.0], [80.0, 60.0, 0.0], [60.0, 0.0, 80.0], [0.0, 10.0, 0.0]])
    gram = columns @ columns.T
    none = np.zeros(4, dtype=bool)
    picture = Picture(("a", "b", "c", "stuck@d"), gram, np.diag(gram), np.ones(4), none, none)
    asked: list[list[str]] = []

    def refit(names: Sequence[str]) -> dict[str, float]:
        asked.append(list(names))
        return {name: {NOTHING: 2500.0, "a": form, "b": 1.0, "c": 900.0}[name] for name in names}

    first = observe(picture, "a", (), np.random.default_rng(0))
    assert (first.same, first.from_none, first.from_rival) == (("a",), 10_000.0, pytest.approx(3600.0))
    form = 0.0
    found = observe(picture, "a", (), np.random.default_rng(0), refit)
    assert asked == [[NOTHING, "a", "b", "c"]], "what has no small size is not asked"
    assert (found.same, found.from_none) == (("a", "b"), 2500.0)
    assert (found.rival, found.from_rival) == ("c", 900.0)
    assert (found.form, found.stand_in) == (0.0, 900.0)
    assert found.classed > 0.9 > TOLD_SQ / 2500.0


@pytest.mark.parametrize(("form", "same"), [(1200.0, ("a", "b")), (299.5, ("a", "b")), (298.5, ("a",)), (0.0, ("a",))])
def test_what_comes_as_near_as_the_catalogues_form_of_the_name_is_as_right(form: float, same: tuple[str, ...]) -> None:
    columns = np.stack([[100.0, 0.0, 0.0], [80.0, 60.0, 0.0], [60.0, 0.0, 80.0]])
    gram = columns @ columns.T
    none = np.zeros(3, dtype=bool)
    picture = Picture(("a", "b", "c"), gram, np.diag(gram), np.ones(3), none, none)
    distances = {NOTHING: 2500.0, "a": form, "b": 300.0, "c": 900.0}
    found = observe(picture, "a", (), np.random.default_rng(0), lambda names: {name: distances[name] for name in names})
    assert (found.form, found.stand_in) == (form, 900.0 if "b" in same else 300.0)
    assert found.same == same, "only the nearest, and only if it comes as near, up to one squared sd"
