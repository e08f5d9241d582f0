"""Counterfactual training gives the operator true sensitivities; plain training does not."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers.compressor_recordings import small_batch, trained_twin

from twinbench.common.errors import BadInput
from twinbench.data.batch import Batch
from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.deeponet_kalman.augmentation import (
    DROPOUT,
    GAPS,
    MOST_GAPS,
    augmented,
    lagging,
    silent_channels,
)
from twinbench.methods.deeponet_kalman.method import DeepONetKalman, check_audit
from twinbench.methods.deeponet_kalman.operator_training import Recipe, Scales, audit, feasibility, fit_operator
from twinbench.methods.deeponet_kalman.windows import WindowSource
from twinbench.methods.frontend import FrontEnd
from twinbench.methods.operator import Operator
from twinbench.methods.training import adamw, load_weights, seeded, weights_of
from twinbench.methods.transitions import Sampling, draw_transitions, plant_sensitivities
from twinbench.physics.compressor import PLANT
from twinbench.physics.integrate import Varying, advance


@pytest.fixture(scope="module")
def train():
    return small_batch(1)


@pytest.fixture(scope="module")
def validation():
    return small_batch(2)


def trained(train: Batch, validation: Batch, perturbed: bool):
    rng, _ = seeded(0)
    source = WindowSource.fit(train, FrontEnd.fit(train))
    transitions = draw_transitions(train, 20_000, rng, Sampling(perturbed=perturbed))
    scales = Scales.fit(COMPRESSOR, transitions)
    operator = Operator()
    fit_operator(operator, source, transitions, scales, rng, Recipe(250, 256, 1e-2))
    held_out = WindowSource(validation, FrontEnd.fit(train), source.query_mean, source.query_scale)
    return operator, audit(operator, held_out, validation, scales, rng, count=1000)


@pytest.fixture(scope="module")
def counterfactual(train, validation):
    return trained(train, validation, perturbed=True)


def test_counterfactuals_give_true_sensitivities(counterfactual):
    _, checked = counterfactual
    assert (checked.G_cosine > 0.9).all()
    check_audit(COMPRESSOR, checked.G_cosine, checked.G_size)


def test_windows_of_transients_are_drawn_more_often_than_there_are(train):
    assert train.truth is not None
    N = train.truth.inputs[..., 2]
    found = []
    for stratified in (False, True):
        drawn = draw_transitions(train, 4000, np.random.default_rng(0), Sampling(stratified=stratified))
        assert drawn.sample.min() >= 64
        assert drawn.sample.max() < N.shape[1] - 1
        found.append(np.mean(N[drawn.sequence, drawn.sample] != N[drawn.sequence, drawn.sample - 64]))
    assert found[0] == pytest.approx(64 / 200, abs=0.03)
    assert found[1] == pytest.approx(0.5, abs=0.03)  # no step here is a small one


def test_what_the_operator_errs_by_at_first_is_told_from_what_it_errs_by_for_good(
    train, validation, counterfactual, monkeypatch
):
    residual = np.zeros((len(validation), 20, 200, 5))
    residual[:, :2] = 0.1
    residual[:, 12:, :, 4] = 0.01
    training = "twinbench.methods.deeponet_kalman.operator_training"
    monkeypatch.setattr(f"{training}._along_the_recordings", lambda *_: residual.reshape(-1, 200, 5))
    source = WindowSource.fit(train, FrontEnd.fit(train))
    scales = Scales.fit(COMPRESSOR, draw_transitions(train, 1000, np.random.default_rng(0)))
    checked = audit(counterfactual[0], source, validation, scales, np.random.default_rng(0), count=400)
    np.testing.assert_allclose(checked.first_sd, 0.1)
    np.testing.assert_allclose(checked.slow_sd, [0.0, 0.0, 0.0, 0.0, 0.01 * np.sqrt(0.8)])


def test_the_recordings_alone_teach_the_operator_to_ignore_health(train, validation):
    """The identifiability trap, as a negative control."""
    _, checked = trained(train, validation, perturbed=False)
    with pytest.raises(BadInput, match="fails its audit: its sensitivity to capacity"):
        check_audit(COMPRESSOR, checked.G_cosine, checked.G_size)


def test_a_model_that_fails_its_audit_is_not_loaded(tmp_path):
    twin = DeepONetKalman(COMPRESSOR, **trained_twin().config)
    twin.arrays = {
        **trained_twin().arrays,
        "audit.G_cosine": np.ones(4),
        "audit.G_size": np.array([1.0, 1.0, 3.0, 1.0]),
    }
    twin.save(tmp_path / "model.npz")
    with pytest.raises(BadInput, match=r"its sensitivity to leakage has cosine 1 .* and 3 of its size") as told:
        DeepONetKalman.load(tmp_path / "model.npz", audited=True)
    assert "\n" not in str(told.value)


def test_transitions_are_what_the_plant_does(train):
    rng = np.random.default_rng(0)
    drawn = draw_transitions(train, 300, rng, Sampling(dt_s=(0.05, 0.1), each=3))
    assert (drawn.sample.reshape(-1, 3) == drawn.sample.reshape(-1, 3)[:, :1]).all()
    assert set(drawn.dt_s) == {0.05, 0.1}
    hidden = train.truth.states[drawn.sequence, drawn.sample, 5:]
    row = int(np.flatnonzero(drawn.dt_s == 0.1)[0])
    x = np.concatenate([drawn.x[row], hidden[row]])[None]
    u = train.truth.inputs[drawn.sequence[row], drawn.sample[row]][None]
    after = advance(PLANT, x, u, 0.1, 4, Varying(COMPRESSOR.health_names, drawn.theta[row][None]))
    assert drawn.x_next[row] == pytest.approx(after[0, :5])


def test_unperturbed_transitions_are_the_recording(train):
    drawn = draw_transitions(train, 50, np.random.default_rng(0), Sampling(perturbed=False))
    truth = train.truth.states[drawn.sequence, drawn.sample + 1, :5]
    assert drawn.x_next == pytest.approx(truth, rel=1e-6, abs=1e-9)


def test_plant_sensitivities_have_the_signs_of_the_machine(train):
    drawn = draw_transitions(train, 200, np.random.default_rng(1))
    F, G = plant_sensitivities(train, drawn)
    assert (G[:, 4, 0] > 0).all()  # more capacity, more flow
    assert (G[:, 4, 2] < 0).all()  # more leakage, less flow
    assert (G[:, 2, 1] < 0).mean() > 0.99  # more efficient, cooler gas
    assert (F[:, 0, 0] < 1).all()
    assert np.isfinite(F).all()


def test_feasibility_is_zero_inside_and_grows_outside():
    x = torch.tensor([[0.93, 3.1, 430.0, 355.0, 1.0]])
    low, high = (torch.from_numpy(bound[:5].astype(np.float32)) for bound in COMPRESSOR.state_bounds)
    scale = torch.from_numpy(COMPRESSOR.scales[:5].astype(np.float32))
    assert feasibility(x, low, high, scale) == 0
    for column in range(5):
        for outside in (low - scale, high + scale):
            bad, worse = x.clone(), x.clone()
            bad[0, column] = outside[column]
            worse[0, column] = 2.0 * outside[column] - x[0, column]
            assert feasibility(worse, low, high, scale) > feasibility(bad, low, high, scale) > 0


def test_same_seed_same_weights(train, validation):
    results = []
    for _ in range(2):
        rng, _ = seeded(5)
        source = WindowSource.fit(train, FrontEnd.fit(train))
        transitions = draw_transitions(train, 600, rng)
        operator = Operator()
        fit_operator(operator, source, transitions, Scales.fit(COMPRESSOR, transitions), rng, Recipe(5, 32, 1e-3))
        results.append(weights_of(operator))
    assert all(np.array_equal(results[0][name], results[1][name]) for name in results[0])
    again = Operator()
    load_weights(again, results[0])
    assert all(np.array_equal(a, results[0][n]) for n, a in weights_of(again).items())


def test_training_stops_at_a_loss_that_is_not_finite():
    model = torch.nn.Linear(1, 1)
    with pytest.raises(FloatingPointError, match="training loss is nan"):
        adamw(model, lambda i: model(torch.tensor([[float("nan")]])).sum(), 5)


def setting(train, count=3000, each=1):
    """A window source and transitions of the small recordings."""
    rng, _ = seeded(0)
    source = WindowSource.fit(train, FrontEnd.fit(train))
    transitions = draw_transitions(train, count, rng, Sampling(each=each))
    return source, transitions, Scales.fit(COMPRESSOR, transitions), rng


def test_heads_that_do_not_see_health_have_no_sensitivity_to_it(train):
    source, transitions, scales, rng = setting(train, 600)
    operator = Operator()
    fit_operator(operator, source, transitions, scales, rng, Recipe(5, 32, 1e-2, conditioned=False))
    assert not operator.heads.from_condition.weight[:, 5:].any()


def test_refining_the_heads_lowers_the_loss_and_leaves_the_rest(train):
    found = []
    for refinement in (0, 30):
        source, transitions, scales, rng = setting(train, 3000, each=3)
        operator = Operator()
        recipe = Recipe(30, 64, 1e-2, refinement=refinement)
        found.append((fit_operator(operator, source, transitions, scales, rng, recipe), weights_of(operator)))
    (losses, before), (both, after) = found
    assert both[: len(losses)] == losses
    refined = both[len(losses) :]
    assert refined[-1] < 0.7 * refined[0] < losses[0]
    changed = {name for name in before if not np.array_equal(before[name], after[name])}
    assert changed
    assert all(name.startswith("net.heads.") for name in changed)


def test_augmentation_is_what_sensors_do(train):
    source, *_ = setting(train, 60)
    rng = np.random.default_rng(3)
    sequence, sample = rng.integers(3, size=400), rng.integers(200, 2000, size=400)
    channels, (temperature,), (flow,) = COMPRESSOR.channels, lagging(COMPRESSOR), silent_channels(COMPRESSOR)
    plain = source.at(sequence, sample)
    noisy = augmented(plain, source, rng)
    mean, scale = source.front_end.mean, source.front_end.scale
    change = (noisy.values - plain.values).numpy()
    p_suc, p_dis = (channels.index(c) for c in COMPRESSOR.drift.channels)
    # The drift of the two pressures is one and the same share of the reading.
    share = [
        (change[:, 1:, c] * scale[c]).mean(axis=1) / (plain.values[:, 1:, c].numpy() * scale[c] + mean[c]).mean(axis=1)
        for c in (p_suc, p_dis)
    ]
    assert np.corrcoef(share)[0, 1] > 0.9
    silent = (plain.masks - noisy.masks).numpy()
    gappy = np.delete(silent, flow, axis=2).any(axis=(1, 2))
    assert gappy.mean() == pytest.approx(GAPS, abs=0.06)
    assert silent[gappy].mean() == pytest.approx(0.5 * MOST_GAPS, abs=0.05)
    held = np.diff(noisy.values.numpy()[gappy], axis=1)[np.delete(silent, flow, axis=2)[gappy].any(axis=2)]
    assert (np.delete(held, flow, axis=1) == 0.0).any(axis=1).all(), "what is missing reads as the last before it"
    assert silent[~gappy][..., flow].any(axis=1).mean() == pytest.approx(DROPOUT, abs=0.06)
    assert np.abs(change[..., temperature]).max() < 0.5
    assert torch.equal(noisy.slow, plain.slow)
    again = source.at(sequence, sample)
    assert torch.equal(again.values, plain.values)
