"""Coverage on fresh recordings: one half is judged by the factors of the other; an exact posterior's, by regime."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from helpers.tiny_run import run_arguments, run_here, twinbench, write_profile

from twinbench.bench.benchmarks import exact_posterior
from twinbench.bench.benchmarks.coverage import SEED, judge
from twinbench.bench.benchmarks.coverage_tables import errors_table, exact_table, right_pairs
from twinbench.bench.benchmarks.fresh import fresh_halves, parser
from twinbench.bench.estimate.apply import Training, trained_cells
from twinbench.bench.statistics.coverage import coverage_table
from twinbench.bench.statistics.subject import PAPERS
from twinbench.bench.statistics.summary import LIFE


def test_every_fresh_recording_is_judged_once(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_here(monkeypatch)
    profile = write_profile(tmp_path)
    assert twinbench(*run_arguments(profile, tmp_path / "out", ["always_prior"])) == 0
    store, (cell,) = trained_cells(Training(str(profile), tmp_path / "out"), ["always_prior"])
    asked = parser("", "coverage", recordings=4).parse_args(["--profile", str(profile)])
    halves = fresh_halves(asked, SEED)
    assert [len(half.names) for half in halves] == [2, 2]
    rows, scores = judge(store, cell, halves)
    everything = rows[rows["regime"] == "all"]
    assert sorted(everything["sequence"].unique()) == sorted(halves[0].names + halves[1].names)
    assert sorted(scores["sequence"].unique()) == sorted(halves[0].names + halves[1].names)
    assert set(scores["row"]) == {"always_prior"}
    assert everything.groupby("quantity").size().eq(4).all()
    assert everything["calibrated_pct"].notna().all()
    assert not np.array_equal(everything["inside_pct"], everything["calibrated_pct"])
    table = coverage_table(rows)
    counted = right_pairs(table).frame
    right = table[(table["quantity"] != "mean") & table["calibrated_pct"].between(93.0, 97.0)]
    assert counted["sum"].sum() == len(right)
    assert counted.set_index("kind")["count"]["all samples"] == 10


def test_an_exact_posterior_holds_less_after_a_jump_that_nobody_foresees(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exact_posterior, "MACHINES", 300)
    held = exact_posterior.coverage(0.3, np.random.default_rng(1))
    assert held["all"] == pytest.approx(95.0, abs=1.5)
    assert held["after_health"] < 90.0
    assert held["steady_before"] > held["all"]


def test_the_exact_table_has_a_row_for_each_noise() -> None:
    found = pd.DataFrame(
        [(sd, regime, 95.04) for sd in (0.1, 0.3) for regime in exact_posterior.REGIMES_SHOWN],
        columns=["reading_sd_lives", "regime", "coverage_pct"],
    )
    assert [row[0].text for row in exact_table(found).rows] == ["0.1", "0.3"]
    assert exact_table(found).rows[0][2].text == "95.0"


def test_without_jumps_an_exact_posterior_holds_what_it_promises_at_every_tick(monkeypatch) -> None:
    monkeypatch.setattr(exact_posterior, "MACHINES", 2000)
    monkeypatch.setattr(exact_posterior, "CHANGING", 0.0)
    monkeypatch.setattr(exact_posterior, "SECONDS", 320)
    held = exact_posterior.coverage(0.3, np.random.default_rng(2))
    assert held["steady_before"] == held["all"] == pytest.approx(95.0, abs=1.5)


def test_errors_stand_beside_the_references_and_a_rival_is_told_apart_only_where_it_is() -> None:
    rng, metrics = np.random.default_rng(3), (*PAPERS.state_errors, LIFE)
    hard = rng.uniform(1.0, 2.0, 60)
    rows = {
        "oracle": [hard] * 4,
        "deeponet_kalman": [1.05 * hard, 1.3 * hard, 1.15 * hard * rng.uniform(0.5, 1.5, 60), hard],
        "pinn_ukf": [1.2 * hard, 1.3 * hard * rng.uniform(0.9, 1.1, 60), hard, 2.0 * hard],
    }
    table = [
        (name, metric, f"s{i}", value)
        for name, columns in rows.items()
        for metric, values in zip(metrics, columns, strict=True)
        for i, value in enumerate(values)
    ]
    made = errors_table(pd.DataFrame(table, columns=["row", "metric", "sequence", "value"]), PAPERS)
    p, T, m = (output.says for output in PAPERS.outputs)
    asked, limit, rival = made.notes
    assert asked.startswith("60 fresh recordings")
    assert limit.startswith(
        f"DeepONet-Kalman errs this many times as much as the reference (95 % interval): {p} 1.05 ("
    )
    assert f"It errs at most 1.15 times as much as the reference in {p} and health." in limit
    assert f"It errs more than 1.15 times as much in {T}." in limit
    assert f"open in {m}." in limit
    assert f"{p} 1.14 (1.14 to 1.14; p < 0.0001)" in rival
    assert "health 2.00 (2.00 to 2.00; p < 0.0001)" in rival
    frame = made.frame.set_index(["row", "metric"])
    assert frame.loc[("pinn_ukf", LIFE), "times_ratio"] == pytest.approx(2.0)
