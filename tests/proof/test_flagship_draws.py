"""The plants of the flagship study and their recordings, drawn from a seed; how models are measured on them."""

from __future__ import annotations

import numpy as np
import pytest
from flagship_short import SHORT_TRAINING, recorded

from twinbench.machines.compressor import CHANNELS, HEALTH
from twinbench.physics.compile import compiled
from twinbench.physics.mechanisms import CATALOGUE
from twinbench.physics.nominal import NOMINAL, REDUCED
from twinbench.physics.steady import DESIGN_POINT, steady_state, valve_for
from twinbench.proof.flagship.judge import shares
from twinbench.proof.flagship.measure import Errors, at_design_point, errors
from twinbench.proof.flagship.plant import ADDED, CALIBRATED, CELLS, EFFECTS, SEPARABLE, UNKNOWN, Item, draw
from twinbench.proof.flagship.record import HELD_OUT, TRAINING, record


@pytest.mark.parametrize("cell", CELLS)
def test_the_same_seed_draws_the_same_plant_and_another_seed_or_number_another(cell: str) -> None:
    assert draw(Item(cell, 4), 3) == draw(Item(cell, 4), 3)
    theta = draw(Item(cell, 4), 3).simulator.theta()
    for other in (draw(Item(cell, 4), 2), draw(Item(cell, 5), 3)):
        assert not np.array_equal(other.simulator.theta(), theta)


def test_a_plant_has_every_effect_that_the_nominal_model_lacks() -> None:
    plant = draw(Item("plain", 1), 3)
    assert {e.parameter for e in plant.effects} == set(REDUCED)
    for e in plant.effects:
        assert plant.simulator.theta()[plant.simulator.index(e.parameter)] == e.true
        assert e.absent == pytest.approx(REDUCED[e.parameter])
        assert e.true != pytest.approx(e.absent)
    assert plant.without == ()


def test_the_plant_differs_from_the_nominal_model_in_nothing_else_that_the_catalogue_holds() -> None:
    catalogue = {v.name for m in CATALOGUE for v in m.parameters}
    for cell, besides in (("plain", ()), ("loose", UNKNOWN)):
        plant = draw(Item(cell, 1), 3)
        other = plant.simulator.theta() != NOMINAL.theta()
        moved = {v.name for v, differs in zip(NOMINAL.parameters, other, strict=True) if differs}
        assert moved & catalogue == {e.parameter for e in plant.effects}
        assert moved - catalogue == {*CALIBRATED, *besides}


def test_only_what_the_engine_calibrates_sets_the_nominal_models_own_plant_apart() -> None:
    plant = draw(Item("nominal", 1), 3)
    moved = {
        v.name for v, w in zip(plant.simulator.parameters, NOMINAL.parameters, strict=True) if v.nominal != w.nominal
    }
    assert moved == set(NOMINAL.calibrate)
    assert plant.effects == ()


def test_a_poorer_catalogue_goes_with_the_same_plant_and_lacks_one_or_two_of_its_effects() -> None:
    for number in range(8):
        plain, poorer = draw(Item("plain", number), 3), draw(Item("left_out", number), 3)
        assert poorer.simulator == plain.simulator
        assert 1 <= len(poorer.without) <= 2
        assert set(poorer.without) <= set(SEPARABLE) <= {m.name for m in EFFECTS}


def test_an_enriched_plant_has_two_effects_more() -> None:
    plain, richer = draw(Item("plain", 2), 3), draw(Item("enriched", 2), 3)
    added = [e for e in richer.effects if e not in plain.effects]
    assert len(added) == 2
    assert {e.name for e in added} <= set(ADDED)


def test_recordings_are_the_same_for_the_same_seed_and_hold_what_sensors_wrote() -> None:
    train, _, held_out = recorded()
    plant = draw(Item("left_out", 0), 3).simulator
    again = record(plant, SHORT_TRAINING, 3, 0)
    np.testing.assert_array_equal(again.measured, train.measured)
    assert not np.array_equal(record(plant, SHORT_TRAINING, 4, 0).measured, train.measured, equal_nan=True)
    assert held_out.names == ("held_1",)
    assert train.measured.shape == (2, 2400, len(CHANNELS))
    gap = np.nanmedian(np.abs(train.measured[..., 4:] / train.truth.outputs - 1.0), axis=(0, 1))
    assert ((1e-4 < gap) & (gap < 0.02)).all()
    assert np.isnan(train.measured).any()


def test_the_held_out_regime_is_another_and_health_drifts_at_full_pace_there() -> None:
    plant = draw(Item("plain", 0), 3).simulator
    train, held_out = record(plant, TRAINING, 3, 0), record(plant, HELD_OUT, 3, 0)
    assert (len(train), len(held_out)) == (6, 3)
    N, ratio = (lambda b: b.truth.inputs[..., 2]), (lambda b: b.truth.outputs[..., 0] / b.truth.inputs[..., 0])
    for quantity in (N, ratio):
        assert quantity(held_out).mean() > quantity(train).mean()
        assert quantity(held_out).max() > quantity(train).max()
    assert held_out.truth.inputs[..., 1].min() > train.truth.inputs[..., 1].max() - 2.0
    moves = np.ptp(train.truth.health, axis=1) > 0.0
    assert moves.tolist() == [[p in wear for p in HEALTH] for wear in TRAINING.wear]
    assert (np.ptp(held_out.truth.health, axis=1) > 0.0).all()
    # The benchmark's rates, and half of them where there is less time.
    slow, full = (1200 * np.abs(np.diff(b.truth.health[..., 0], axis=1)).max(axis=1) for b in (train, held_out))
    assert 0.0015 <= slow.max() <= 0.005
    assert 0.003 <= full.min() <= full.max() <= 0.010


# Measuring.


def test_the_nominal_model_can_be_made_exact_at_the_design_point() -> None:
    plant = draw(Item("plain", 0), 3).simulator
    N_rpm, ratio = DESIGN_POINT
    u = np.array([0.95, 298.0, N_rpm, float(valve_for(np.array(N_rpm), np.array(ratio)))])
    readings = [compiled(m).output(steady_state(m, u), u, m.theta()) for m in (plant, at_design_point(plant), NOMINAL)]
    np.testing.assert_allclose(readings[1], readings[0], rtol=1e-4)
    assert abs(readings[2] / readings[0] - 1.0).max() > 0.005


def test_the_plant_itself_filters_better_than_the_nominal_model() -> None:
    train, _, held_out = recorded()
    plant = draw(Item("plain", 0), 3).simulator
    oracle, nominal = (errors(m, train, held_out) for m in (plant, NOMINAL))
    assert oracle.parameter < 0.7 * nominal.parameter
    assert oracle.p < 0.9 * nominal.p
    assert oracle.m < 0.9 * nominal.m


def test_a_filter_that_diverges_has_no_error_to_show() -> None:
    train, _, held_out = recorded()
    diverged = errors(NOMINAL.with_values(C_w_J_K=1e-9), train, held_out)
    assert np.isnan(diverged.parameter)
    oracle, nominal = Errors(4.0, 0.5, 0.5, 0.5), Errors(12.0, 1.0, 1.0, 1.0)
    assert np.isnan(shares(oracle, [nominal], diverged)["parameter_share"])
    assert shares(oracle, [diverged, nominal], oracle)["parameter_share"] == 1.0


def test_a_share_is_measured_from_the_best_nominal_model_of_each_measure() -> None:
    oracle, mended = Errors(4.0, 0.5, 0.5, 0.5), Errors(6.0, 0.6, 0.5, 0.5)
    found = shares(oracle, [Errors(12.0, 1.0, 1.0, 0.9), Errors(14.0, 0.8, 0.8, 0.9)], mended)
    assert found["nominal_parameter"] == 12.0
    assert found["nominal_p"] == 0.8
    assert found["parameter_share"] == pytest.approx(6.0 / 8.0)
    assert found["open60_share"] == pytest.approx((2.5 - 1.6) / (2.5 - 1.5))
