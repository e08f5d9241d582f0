"""The mended nominal EKF: what the engine is shown, and what becomes of its answer."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twinbench.baselines import nominal_ekf_mended
from twinbench.baselines.nominal_ekf_mended import NominalEKFMended, mend
from twinbench.common.errors import BadInput
from twinbench.data.batch import Batch
from twinbench.data.benchmark import DesignConfig, simulate_benchmark
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.two_tanks import TWO_TANKS
from twinbench.physics.compile import compiled
from twinbench.physics.known_health import with_known_health
from twinbench.physics.nominal import NOMINAL

HEALTH, INPUTS, OUTPUTS = COMPRESSOR.health_names, COMPRESSOR.inputs, COMPRESSOR.outputs


@pytest.fixture(scope="module")
def train() -> Batch:
    return simulate_benchmark(
        DesignConfig(n_train=5, n_validation=1, n_calibration=1, n_test=1, n_single=0, minutes=3.0, warmup_minutes=1.0)
    ).train


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """An engine that keeps what it is shown, and finds valve loss and a sensor's fault."""
    kept: dict[str, Any] = {}

    def diagnose(simulator: Any, recordings: Any, **asked: Any) -> Any:
        kept.update(simulator=simulator, recordings=recordings, **asked)
        return SimpleNamespace(values={"V_d_m3": 6.1e-3, "K_s": 0.05, "iso": 0.0, "bias_T_dis_K": 2.0})

    monkeypatch.setattr(nominal_ekf_mended, "diagnose", diagnose)
    return kept


def test_the_engine_is_shown_sensors_and_health_of_other_recordings_than_it_is_tried_on(
    train: Batch, shown: dict[str, Any]
) -> None:
    assert train.truth is not None
    mend(train, recordings=2, hold_out=1, minutes=1.5)
    assert [v.name for v in shown["simulator"].inputs] == [*INPUTS, *HEALTH]
    given = {r.name: r for r in (*shown["recordings"], *shown["hold_out"])}
    assert len(given) == 3
    for name, recording in given.items():
        b = train.names.index(name)
        sensors, health = recording.values[:, [0, 1, 2, 3, 9, 10, 11]], recording.values[:, 4:9]
        assert recording.channels == (*INPUTS, *HEALTH, *OUTPUTS)
        np.testing.assert_array_equal(sensors, train.measured[b, :1800])
        np.testing.assert_array_equal(health, train.truth.health[b, :1800])
    speed = dict(zip(train.names, np.nanmean(train.measured[..., INPUTS.index("N_rpm")], axis=1), strict=True))
    assert [r.name for r in shown["hold_out"]] == [max(speed, key=lambda n: speed[n])]


def test_what_it_finds_in_the_machine_is_in_the_filters_model_and_a_sensors_fault_is_not(
    train: Batch, shown: dict[str, Any]
) -> None:
    estimator = NominalEKFMended(recordings=2, hold_out=1, recording_minutes=1.0)
    estimator.fit(train, train, 0)
    machine = estimator.simulator()
    values = dict(zip((v.name for v in machine.parameters), machine.theta(), strict=True))
    assert values["K_s"] == 0.05
    assert values["iso"] == 0.0
    assert values["K_d"] == NOMINAL.theta()[NOMINAL.index("K_d")]
    # Then recalibrated, as the nominal model is.
    assert values["V_d_m3"] == pytest.approx(6.1e-3 * estimator.arrays["recalibrated"][0])


def test_the_engine_sees_no_truth_but_the_health_that_recalibration_uses(train: Batch, shown: dict[str, Any]) -> None:
    assert train.truth is not None
    mend(train, 2, 1, 1.0)
    seen = [r.values for r in (*shown["recordings"], *shown["hold_out"])]
    unknown = replace(train.truth, states=np.full_like(train.truth.states, np.nan))
    mend(replace(train, truth=unknown), 2, 1, 1.0)
    for before, after in zip(seen, (*shown["recordings"], *shown["hold_out"]), strict=True):
        np.testing.assert_array_equal(after.values, before)


def test_no_fault_of_a_sensor_of_the_health_is_offered(train: Batch, shown: dict[str, Any]) -> None:
    mend(train, 2, 1, 1.0)
    assert set(shown["leave_out"]) == {f"*@{name}" for name in HEALTH}


def test_known_health_acts_as_the_same_health_among_the_parameters() -> None:
    rng = np.random.default_rng(0)
    known = with_known_health(NOMINAL)
    health = {"capacity": 0.9, "efficiency": 0.95, "leakage": 0.03, "heat_transfer": 0.7, "T_bias_K": 2.0}
    worn = NOMINAL.with_values(**health)
    u = np.array([0.95, 298.0, 1400.0, 0.6])
    seen = np.concatenate((u, list(health.values())))
    y0 = np.array([3.1, 430.0, 0.12])
    x0 = worn.initial(u, y0, worn.theta())
    np.testing.assert_array_equal(known.initial(seen, y0, known.theta()), x0)
    for _ in range(5):
        x = x0 * rng.uniform(0.95, 1.05, len(x0))
        for name in ("rhs", "output"):
            ours = getattr(compiled(known), name)(x, seen, known.theta())
            np.testing.assert_allclose(ours, getattr(compiled(worn), name)(x, u, worn.theta()), rtol=1e-13)


def test_a_machine_without_a_catalogue_is_refused_in_one_line() -> None:
    config = DesignConfig(
        n_train=2, n_validation=1, n_calibration=1, n_test=1, n_single=0, minutes=2.0, warmup_minutes=0.5
    )
    split = simulate_benchmark(config, machine=TWO_TANKS)
    with pytest.raises(BadInput, match="no catalogue to mend the model of 'two_tanks' from"):
        NominalEKFMended(TWO_TANKS).fit(split.train, split.validation, 0)
