"""The scenes of the paper's figures: its own numbers."""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.data.scenes import FADING_S, ONSET_S, RAMP_BEGINS_S, RAMP_S, load_ramps, wearing
from twinbench.machines.compressor import COMPRESSOR


@pytest.fixture(scope="module")
def worn():
    return wearing(7)


def test_five_ramps_move_the_load_once_on_healthy_machines():
    batch = load_ramps(7)
    assert batch.measured.shape == (5, 240 * 20, 7)
    assert np.ptp(batch.truth.health, axis=1).max() == 0.0
    ratio = batch.truth.outputs[..., COMPRESSOR.outputs.index("p_dis_bar")] / batch.truth.inputs[..., 0]
    for course, seconds in zip(ratio, RAMP_S, strict=True):
        before, after = course[batch.time_s < RAMP_BEGINS_S], course[batch.time_s > RAMP_BEGINS_S + seconds + 10.0]
        assert np.ptp(before) < 0.1
        assert np.ptp(after) < 0.2
        assert abs(after.mean() - before.mean()) > 1.0


def course(worn, scene: str, parameter: str) -> np.ndarray:
    return worn.truth.health[worn.names.index(scene), :, COMPRESSOR.health_names.index(parameter)]


@pytest.mark.parametrize(
    ("scene", "parameter", "first", "last"),
    [
        ("capacity", "capacity", 1.0, 0.88),
        ("leakage", "leakage", 0.015, 0.052),
        ("cooling", "heat_transfer", 1.0, 0.65),
        ("fouling", "capacity", 1.0, 0.93),
        ("bias", "T_bias_K", 0.0, 5.0),
    ],
)
def test_wear_goes_from_where_to_where_the_paper_says(worn, scene, parameter, first, last):
    values = course(worn, scene, parameter)
    assert values[[0, -1]] == pytest.approx([first, last])
    others = [
        p for p in COMPRESSOR.health_names if p != parameter and not (scene == "fouling" and p == "heat_transfer")
    ]
    assert all(np.ptp(course(worn, scene, p)) == 0.0 for p in others)


def test_capacity_fades_over_eighteen_minutes_and_faults_come_at_once(worn):
    fading = np.flatnonzero(np.diff(course(worn, "capacity", "capacity")) != 0.0)
    assert np.ptp(worn.time_s[fading]) == pytest.approx(FADING_S, abs=0.2)
    step = np.flatnonzero(np.diff(course(worn, "bias", "T_bias_K")) != 0.0)
    assert worn.time_s[step] == pytest.approx(ONSET_S, abs=0.1)
    assert np.ptp(worn.truth.health[worn.names.index("normal")], axis=0).max() == 0.0


def test_cooling_is_impaired_in_two_stages(worn):
    falling = np.diff(course(worn, "cooling", "heat_transfer")) < 0.0
    assert np.count_nonzero(np.diff(falling.astype(int)) == 1) == 2


def test_the_load_moves_while_machines_wear(worn):
    assert (np.ptp(worn.truth.outputs[..., 0], axis=1) > 1.0).all()


def test_a_scene_depends_on_its_seed_alone(worn):
    assert wearing(7).measured == pytest.approx(worn.measured, nan_ok=True, abs=0.0)
    assert not np.allclose(wearing(8).truth.inputs, worn.truth.inputs)
