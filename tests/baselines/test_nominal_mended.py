"""The mended nominal EKF: what the engine is shown, and what becomes of its answer."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twinbench.baselines import nominal_ekf_mended
from twinbench.baselines.nominal_ekf_mended import NominalEKFMended, mend
from twinbench.data.batch import CHANNELS, INPUTS, Batch
from twinbench.data.benchmark import DesignConfig, simulate_benchmark
from twinbench.physics.nominal import NOMINAL


@pytest.fixture(scope="module")
def train() -> Batch:
    return simulate_benchmark(DesignConfig(n_train=5, n_validation=1, n_test=1, minutes=3.0, warmup_minutes=1.0)).train


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """An engine that keeps what it is shown, and finds valve loss and a sensor's fault."""
    kept: dict[str, Any] = {}

    def diagnose(simulator: Any, recordings: Any, hold_out: Any) -> Any:
        kept.update(simulator=simulator, recordings=recordings, hold_out=hold_out)
        return SimpleNamespace(values={"V_d_m3": 6.1e-3, "K_s": 0.05, "iso": 0.0, "bias_T_dis_K": 2.0})

    monkeypatch.setattr(nominal_ekf_mended, "diagnose", diagnose)
    return kept


def test_the_engine_is_shown_sensor_columns_of_other_recordings_than_it_is_tried_on(
    train: Batch, shown: dict[str, Any]
) -> None:
    mend(train, recordings=2, hold_out=1, minutes=1.5)
    assert shown["simulator"] is NOMINAL
    given = {r.name: r for r in (*shown["recordings"], *shown["hold_out"])}
    assert len(given) == 3
    for name, recording in given.items():
        assert recording.channels == CHANNELS
        np.testing.assert_array_equal(recording.values, train.measured[train.names.index(name), :1800])
    speed = dict(zip(train.names, np.nanmean(train.measured[..., INPUTS.index("N_rpm")], axis=1), strict=True))
    assert [r.name for r in shown["hold_out"]] == [max(speed, key=lambda n: speed[n])]


def test_what_it_finds_in_the_machine_is_in_the_filters_model_and_a_sensors_fault_is_not(
    train: Batch, shown: dict[str, Any]
) -> None:
    estimator = NominalEKFMended(recordings=2, hold_out=1, recording_minutes=1.0)
    estimator.fit(train, train, 0)
    machine = estimator.machine()
    values = dict(zip((v.name for v in machine.parameters), machine.theta(), strict=True))
    assert values["K_s"] == 0.05
    assert values["iso"] == 0.0
    assert values["K_d"] == NOMINAL.theta()[NOMINAL.index("K_d")]
    # Then recalibrated, as the nominal model is.
    assert values["V_d_m3"] == pytest.approx(6.1e-3 * estimator.arrays["recalibrated"][0])


def test_the_engine_cannot_see_the_truth(train: Batch, shown: dict[str, Any]) -> None:
    found = mend(train, 2, 1, 1.0)
    np.testing.assert_array_equal(mend(train.without_truth(), 2, 1, 1.0), found)
