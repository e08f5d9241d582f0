"""What time gives: rows of the study of delays and slopes, where what is right is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from helpers.compressor_recordings import small_batch, trained_twin

from twinbench.bench.benchmarks import slopes
from twinbench.bench.benchmarks.delay import judge_delays
from twinbench.bench.benchmarks.delay_tables import delay_table, forecast_table, slope_table
from twinbench.bench.evaluate import run as evaluate
from twinbench.bench.profile import Evaluation
from twinbench.bench.statistics.aligned import truth_at
from twinbench.bench.statistics.subject import PAPERS
from twinbench.data.batch import Batch

EVALUATION = Evaluation(stride=20, origin_every_s=15.0, leads_s=(20.0,))
HEALTH = [f"{h.name}_life_pct" for h in PAPERS.health]


@pytest.fixture(scope="module")
def batch() -> Batch:
    """Three recordings in which every health parameter moves along a straight line."""
    return small_batch(7, samples=1000)


@pytest.fixture(scope="module")
def seen(batch):
    return evaluate(trained_twin(), batch.without_truth(), EVALUATION, 0)


def test_from_the_true_state_along_the_true_slope_the_plant_foretells_what_comes(batch, seen, monkeypatch):
    monkeypatch.setattr(slopes, "STEEPEST", 10.0)  # a life in 50 s is no step here
    wanted = truth_at(batch, seen.names, seen.forecast_time_s + 20.0).outputs
    sloped, frozen = (slopes.from_truth(seen, batch, how).forecast[:, :, -1] - wanted for how in (True, False))
    assert np.abs(sloped / wanted).max() < 1e-6
    assert np.abs(frozen / wanted).max() > 1e-4


def test_a_lag_behind_ramps_is_corrected(batch, seen):
    n, late_s = len(batch.machine.estimated), 5.0
    lagging = truth_at(batch, seen.names, np.maximum(seen.time_s - late_s, 0.0)).health
    mean = np.concatenate([seen.mean[..., :n], lagging], axis=-1).astype(np.float32)
    right = truth_at(batch, seen.names, seen.time_s).health
    late = replace(seen, mean=mean)
    ranked = seen.time_s >= 20.0
    off = [
        np.abs(e.mean[..., n:] - right)[:, ranked] / batch.machine.span for e in (late, slopes.corrected(late, batch))
    ]
    assert off[1].mean() < 0.05 * off[0].mean()


def test_without_a_share_of_its_slope_a_forecast_is_the_filters(batch, seen, monkeypatch):
    monkeypatch.setattr(slopes, "EVALUATION", EVALUATION)
    with_slope = slopes.along_own_slope(trained_twin(), batch, 0)
    np.testing.assert_array_equal(with_slope.mean, seen.mean)
    assert (with_slope.forecast != seen.forecast).any()
    monkeypatch.setattr(slopes, "SHARE", 0.0)
    np.testing.assert_allclose(slopes.along_own_slope(trained_twin(), batch, 0).forecast, seen.forecast, rtol=1e-12)


def rows(names: dict[str, float], metrics: list[str]) -> pd.DataFrame:
    """Scores of eight recordings, the same noise in all rows."""
    noise = np.random.default_rng(0).uniform(0.9, 1.1, 8)
    return pd.DataFrame(
        [
            (f"test-{i}", m, level * x, row)
            for row, level in names.items()
            for m in metrics
            for i, x in enumerate(noise)
        ],
        columns=["sequence", "metric", "value", "row"],
    )


def test_tables_show_multiples_of_the_first_row():
    coverage = [f"calibrated_coverage_{h.name}_pct" for h in PAPERS.health]
    names = {"deeponet_kalman": 10.0, "60 s later": 9.0, "oracle": 10.0, "oracle_smoother": 8.0}
    table = delay_table(rows(names, ["health_life_pct", *HEALTH, *coverage]))
    assert [row[0].text for row in table.rows] == [
        "DeepONet-Kalman", "60 s later", "Oracle (reference)", "Oracle with hindsight",
    ]  # fmt: skip
    assert [row[1].times for row in table.rows] == ["", "×0.90 [0.90–0.90]", "", "×0.80 [0.80–0.80]"]
    assert len(table.columns) == len(table.rows[0])
    foretold = {"health as it is": 1.0, "health along its own slope": 1.2}
    forecasts = forecast_table(rows(foretold, list(PAPERS.forecast_errors)))
    assert [row[1].times for row in forecasts.rows] == ["", "×1.20 [1.20–1.20]"]
    corrected = {"health as it is": 1.0, "corrected": 1.0}
    assert slope_table(rows(corrected, ["health_life_pct", *HEALTH])).rows[1][1].times == "×1.00 [1.00–1.00]"


def test_every_delay_has_a_row_and_who_has_none_has_one(monkeypatch):
    from twinbench.bench.benchmarks import delay

    monkeypatch.setattr(delay, "load_fit", lambda store, cell: trained_twin())
    monkeypatch.setattr(delay, "DELAYS_S", (2.0,))
    monkeypatch.setattr(delay, "EVALUATION", EVALUATION)
    halves = small_batch(7, samples=1000), small_batch(8, samples=1000)
    cell = type("Cell", (), {"estimator": "deeponet_kalman", "seed": 0})
    found = judge_delays(None, cell, halves)  # type: ignore[arg-type]
    assert list(found["row"].unique()) == ["deeponet_kalman", "2 s later"]
    assert found.groupby(["row", "metric"]).size().eq(6).all()
    monkeypatch.setattr(type(trained_twin()), "delayed", False)
    assert list(judge_delays(None, cell, halves)["row"].unique()) == ["deeponet_kalman"]  # type: ignore[arg-type]
