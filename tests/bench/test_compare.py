"""Recordings without truth: forecasts are held against what was read later, recording by recording."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pandas as pd
import pytest
from helpers.refusals import refused
from helpers.tiny_run import twinbench, write_profile

from twinbench.bench.compare.page import LEAST_RECORDINGS, says, table
from twinbench.bench.compare.scores import DEFINITIONS, HEADLINE, promised, score
from twinbench.bench.compare.watched import Watched, lead_ticks, origins, watch
from twinbench.data.batch import Batch
from twinbench.machines.machine import Machine
from twinbench.machines.two_tanks import TWO_TANKS
from twinbench.methods.estimator import Estimator, Info, Sample, State, gaussian_state, no_info

pytestmark = pytest.mark.usefixtures("in_this_process")


class Foretells(Estimator):
    """Foretells what it is told to; its innovations are those of a sensor."""

    name = "foretells"

    def __init__(self, machine: Machine, future: np.ndarray, innovation: np.ndarray) -> None:
        super().__init__(machine)
        self.future, self.told, self.tick = future, innovation, 0

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Nothing."""

    def init(self, batch: int) -> State:
        n = len(self.machine.quantities)
        return gaussian_state(np.ones((batch, n)), np.eye(n), machine=self.machine)

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        info = no_info(1, self.machine)._replace(
            innovation=self.told[:, self.tick],
            S=np.eye(2)[None],
            nis=np.array([2.0]),
            accepted=np.ones((1, 2), dtype=bool),
        )
        self.tick += 1
        return state, info

    def forecast(self, state: State, inputs: np.ndarray) -> np.ndarray:
        return self.future[:, self.tick : self.tick + inputs.shape[1]]


def recording(ticks: int, seed: int) -> Batch:
    """Levels that wander, read with gaps."""
    rng = np.random.default_rng(seed)
    levels = 20.0 + np.cumsum(rng.normal(size=(1, ticks, 2)), axis=1)
    measured = np.concatenate([np.full((1, ticks, 2), [5.0, 0.8]), levels], axis=-1)
    measured[0, 100:103, 2] = np.nan
    return Batch(("day1",), 0.2 * np.arange(ticks), measured, machine=TWO_TANKS)


def test_what_is_foretold_is_held_against_what_was_read_so_much_later() -> None:
    batch = recording(1500, 1)
    off = np.array([0.5, -2.0])
    future = np.nan_to_num(batch.measured[..., 2:]) - off
    seen = watch(Foretells(TWO_TANKS, future, np.zeros((1, 1500, 2))), batch)
    assert seen.error.shape == (1, len(origins(1500, lead_ticks(0.2), 0.2)), 3, 2)
    there = np.isfinite(seen.error)
    assert np.allclose(seen.error[there], np.broadcast_to(off, seen.error.shape)[there])
    assert not there.all(), "nothing was read in the gap"


def test_leads_are_seconds_and_ticks_where_a_tick_is_longer() -> None:
    assert lead_ticks(0.05) == (20, 200, 1200)
    assert lead_ticks(0.2) == (5, 50, 300)
    assert lead_ticks(4.0) == (1, 10, 60)
    at = origins(1000, (1, 10, 60), 4.0)
    assert at[-1] + 60 < 1000
    assert len(at) >= 50


def seen_of(error: np.ndarray, held: np.ndarray, off: np.ndarray) -> Watched:
    """One recording of two outputs, three leads."""
    ticks = off.shape[1]
    return Watched(error, held, np.full((1, ticks), 2.0), np.full((1, ticks), 2), off)


def test_scores_are_those_that_a_pencil_gives() -> None:
    rng = np.random.default_rng(2)
    held = rng.normal(size=(1, 4000, 3, 2)) * 4.0
    error = rng.normal(size=(1, 4000, 3, 2)) * [1.0, 2.0]
    seen = seen_of(error, held, rng.normal(size=(1, 5000, 2)))
    sd = promised(seen)
    found = score("day1", seen, sd).set_index("metric")["value"]
    assert set(found.index) == set(DEFINITIONS)
    for lead in (1, 10, 60):
        assert found[f"open{lead}_ratio"] == pytest.approx(np.sqrt(2.0) / 4.0, rel=0.05)
    # Two normal errors, each under its own sd: the log of the ratio of the sds.
    assert found["log_score"] == pytest.approx(np.log(4.0) - 0.5 * np.log(2.0), abs=0.03)
    assert found["inside_pct"] == pytest.approx(95.0, abs=0.5)
    assert found["nis_ratio"] == pytest.approx(1.0)
    assert abs(found["autocorrelation"]) < 0.05


def test_innovations_that_foretell_one_another_are_told_from_white_ones() -> None:
    rng = np.random.default_rng(3)
    walk = np.zeros((1, 4000, 2))
    for k in range(1, 4000):
        walk[0, k] = 0.8 * walk[0, k - 1] + rng.normal(size=2)
    error = rng.normal(size=(1, 10, 3, 2))
    seen = seen_of(error, error, walk)
    assert score("day1", seen, promised(seen)).set_index("metric")["value"]["autocorrelation"] == pytest.approx(
        0.8, abs=0.05
    )


def made_up(levels: dict[str, float], recordings: int) -> pd.DataFrame:
    """Scores of estimators whose errors differ by a factor, recording by recording."""
    rng = np.random.default_rng(4)
    hard = rng.uniform(0.5, 1.5, recordings)
    rows = [
        (e, 0, f"day{k}", m, level * hard[k] * rng.uniform(0.98, 1.02))
        for e, level in levels.items()
        for k in range(recordings)
        for m in DEFINITIONS
    ]
    return pd.DataFrame(rows, columns=["estimator", "seed", "sequence", "metric", "value"])


def test_the_best_is_named_and_told_apart_only_where_the_test_does() -> None:
    scores = made_up({"gru_kf": 0.3, "nominal_ekf": 0.6, "nominal_ukf": 0.601, "last_value": 1.0}, 12)
    said = " ".join(says(scores))
    assert said.startswith("GRU + KF has the least error a minute ahead")
    assert "tells it from Nominal EKF and Nominal UKF" in said
    close = " ".join(says(made_up({"nominal_ekf": 0.6, "nominal_ukf": 0.6}, 12)))
    assert "It is not told apart from" in close
    few = " ".join(says(made_up({"gru_kf": 0.3, "nominal_ekf": 0.6}, LEAST_RECORDINGS - 1)))
    assert f"{LEAST_RECORDINGS - 1} recordings are too few to tell estimators apart." in few


def test_a_table_has_the_best_first_and_an_interval_where_there_are_several_recordings() -> None:
    found = table(made_up({"nominal_ekf": 0.6, "gru_kf": 0.3}, 7), "two_tanks")
    assert [row[0].text for row in found.rows] == ["GRU + KF", "Nominal EKF"]
    assert found.rows[0][1].interval
    assert found.rows[0][-1].text == "–"
    behind = found.frame[(found.frame["metric"] == "behind") & (found.frame["estimator"] == "nominal_ekf")].iloc[0]
    unpaired = found.frame[(found.frame["metric"] == HEADLINE) & (found.frame["estimator"] == "nominal_ekf")].iloc[0]
    assert 0.0 < behind["low"] < behind["mean"] < behind["high"]
    assert behind["high"] - behind["low"] < unpaired["high"] - unpaired["low"]  # days differ, and both saw the same
    alone = table(made_up({"gru_kf": 0.3}, 1), "two_tanks").rows[0]
    assert not alone[1].interval
    assert alone[-1].text == "–"


def test_trained_estimators_are_held_against_recordings_of_ones_own(tmp_path, capsys) -> None:
    profile = write_profile(tmp_path)
    out, results = tmp_path / "compared", tmp_path / "run"
    names = ("last_value", "always_prior")
    base = ("--profile", profile, "--machine", "two_tanks")
    assert twinbench("run", *base, "--only", *names, "--out", results) == 0
    assert twinbench("simulate", *base, "--out", tmp_path / "recordings") == 0
    days = sorted((tmp_path / "recordings").rglob("test-0*.csv"))[:2]
    assert len(days) == 2
    capsys.readouterr()
    asked = ("compare", *days, *base, "--results", results, "--out", out)
    assert twinbench(*asked, "--json") == 0
    printed = capsys.readouterr()
    assert f"core-minute at most by {results / 'cost.csv'}" in printed.err
    told = json.loads(printed.out)
    assert {row["estimator"] for row in told["comparison"]} == set(names)
    scores = pd.read_csv(out / "scores.csv")
    held = scores[(scores["estimator"] == "last_value") & (scores["metric"] == "open10_ratio")]["value"]
    assert len(held) == 2
    assert np.allclose(held, 1.0, atol=0.25), "holding the last reading errs as much as itself"
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["recordings_sha256"] == {day.name: hashlib.sha256(day.read_bytes()).hexdigest() for day in days}
    assert manifest["seed"] == 0
    assert (out / "tables/recordings.md").read_text().startswith("## Forecasts of 2 recordings of two_tanks")


@pytest.mark.parametrize(
    ("text", "says_so"),
    [
        ("time_s,pump_V,valve,level1_cm\n0,5,0.8,20\n0.2,5,0.8,20\n", "level2_cm"),
        ("time_s,pump_V,valve,level1_cm,level2_cm\n0,5,0.8,20,20\n0.2,5,0.8,20,20\n", "are needed to foretell"),
    ],
)
def test_recordings_that_cannot_be_used_are_refused_in_one_line(tmp_path, capsys, text, says_so) -> None:
    profile = write_profile(tmp_path)
    base = ("--profile", profile, "--machine", "two_tanks")
    assert twinbench("run", *base, "--only", "last_value", "--out", tmp_path / "run") == 0
    (tmp_path / "day.csv").write_text(text)
    asked = ("compare", tmp_path / "day.csv", *base, "--results", tmp_path / "run", "--out", tmp_path / "compared")
    assert says_so in refused(tmp_path, capsys, *asked)
