"""Ablations: an estimator without a part, run beside the whole and compared with it sequence by sequence."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from helpers.tiny_run import parts, run_here, twinbench, write_profile

from twinbench.bench.cells import make_cell
from twinbench.bench.profile import load_profile
from twinbench.bench.registry import find
from twinbench.bench.report.paired import ablation_table, parts_are_worth, rivals_table, without_steps
from twinbench.bench.roster import TRUE_START
from twinbench.bench.statistics.bootstrap import differences, sequence_scores
from twinbench.bench.statistics.scores import DEFINITIONS
from twinbench.common.errors import BadInput
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.estimator import ablated


def test_an_ablation_is_the_estimator_with_other_settings():
    kind = find("deeponet_kalman:no_observability")
    assert kind.name == "deeponet_kalman:no_observability"
    assert not kind().config["least_information"]
    changed = {name for name, value in kind.settings.items() if value != DeepONetKalman.settings[name]}
    assert changed == {"least_information"}


def test_an_ablation_that_is_none_is_refused_in_one_line():
    with pytest.raises(BadInput, match="has no ablation 'no_luck'; it has: no_covariance_adaptation"):
        find("deeponet_kalman:no_luck")


def test_what_fit_does_not_read_is_not_trained_anew(tmp_path):
    """And a profile's settings hold in an ablation, but for those that the ablation is about."""
    more = "[settings.deeponet_kalman]\niterations = 40\nfeasibility = 0.3\nslow_error = 2.0\n"
    profile = load_profile(str(write_profile(tmp_path, more=more)))
    whole, online, offline = (
        make_cell(name, 0, profile)
        for name in ("deeponet_kalman", "deeponet_kalman:no_observability", "deeponet_kalman:no_feasibility")
    )
    assert online.fit == whole.fit
    assert len({whole.estimates, online.estimates, offline.estimates}) == 3
    assert offline.fit != whole.fit
    assert dict(offline.settings) == {"iterations": 40, "feasibility": 0.0, "slow_error": 2.0}


def scores(**values: list[float]) -> pd.DataFrame:
    rows = [
        (name, 0, f"s{i}", metric, value)
        for name, of_sequences in values.items()
        for metric in DEFINITIONS
        for i, value in enumerate(of_sequences)
    ]
    return pd.DataFrame(rows, columns=["estimator", "seed", "sequence", "metric", "value"])


def test_the_table_holds_paired_differences_from_the_whole():
    rng = np.random.default_rng(0)
    whole = rng.uniform(1.0, 5.0, 10)
    table = scores(**{"a": list(whole), "a:no_b": list(whole + 1.0 + 0.1 * rng.normal(size=10)), "c": [1.0] * 10})
    shown = ablation_table(table, {})
    assert list(shown.frame["estimator"]) == ["a:no_b"]
    expected = differences(sequence_scores(table, "p_nrmse_pct"), "a").set_index("estimator").loc["a:no_b"]
    assert shown.frame["p_nrmse_pct"][0] == expected["difference"]
    assert shown.frame["p_nrmse_pct_low"][0] == expected["low"] > 0.8
    assert shown.rows[0][0].text == "a, no b"
    assert shown.rows[0][1].best


def test_rivals_are_set_against_the_proposed_method_and_ablations_are_none():
    worse = {"pinn_ukf": [2.0, 3.0, 4.5], "deeponet_kalman": [1.0, 2.0, 3.0], "deeponet_kalman:no_trust": [9.0] * 3}
    shown = rivals_table(scores(**worse), {})
    assert list(shown.frame["estimator"]) == ["pinn_ukf"]
    assert shown.frame["T_nrmse_pct"][0] == pytest.approx(3.5 / 3)
    assert shown.rows[0][0].text == "PINN + UKF"


def test_whether_the_lead_hangs_on_the_test_for_steps_is_said():
    rng = np.random.default_rng(1)
    rows = [
        (name, 0, f"test-{i:02d}", "health_life_pct", level + 0.3 * rng.normal())
        for name, level in (
            ("deeponet_kalman", 3.0),
            ("deeponet_kalman:no_modes", 5.0),
            ("pinn_ukf", 5.1),
            ("gru_kf", 8.0),
        )
        for i in range(12)
    ]
    scores = pd.DataFrame(rows, columns=["estimator", "seed", "sequence", "metric", "value"])
    (said,) = without_steps(scores, {})
    assert "ranked in this run DeepONet-Kalman alone weighs" in said
    assert "PINN + UKF, the best of those that do not, errs 5." in said
    assert said.endswith("so they are not told apart.")
    too = pd.concat([scores, scores[scores["estimator"] == "gru_kf"].assign(estimator="nominal_imm")])
    assert "ranked in this run Nominal IMM and DeepONet-Kalman alone weigh what" in without_steps(too, {})[0]
    far = scores.assign(value=scores["value"] + 2.0 * (scores["estimator"] == "pinn_ukf"))
    assert without_steps(far, {})[0].endswith("so they are told apart.")
    assert without_steps(scores[scores["estimator"] != "deeponet_kalman:no_modes"], {}) == []


def test_a_failed_ablation_says_so():
    table = scores(**{"a": [1.0, 2.0], "a:no_b": [np.nan, np.nan]})
    assert ablation_table(table, {"a:no_b": "seed 0, fit: broke"}).rows[0][1].text == "failed"


ABLATED = """
import numpy as np
from twinbench.methods.estimator import Estimator, gaussian_state, no_info, register

@register
class Constant(Estimator):
    name, says = "constant", "the mean in training"
    settings = {"shift": 0.0, "scale": 1.0}
    online = frozenset({"shift"})
    ablations = {"no_scale": {"scale": 2.0}, "shifted": {"shift": 1.0}}

    def fit(self, train, validation, seed):
        truth = train.truth.estimated.reshape(-1, 10)
        self.arrays = {"mean": self.config["scale"] * truth.mean(axis=0), "cov": np.cov(truth[::50].T)}

    def init(self, batch):
        return gaussian_state(np.tile(self.arrays["mean"] + self.config["shift"], (batch, 1)), self.arrays["cov"])

    def step(self, state, sample):
        return gaussian_state(state.mean, self.arrays["cov"]), no_info(len(state.mean))
"""


def test_a_run_with_ablations_trains_what_differs_and_reports_it_apart(tmp_path, monkeypatch):
    run_here(monkeypatch)
    (tmp_path / "constant.py").write_text(ABLATED)
    out = tmp_path / "out"
    profile = write_profile(tmp_path, updates=3)
    assert twinbench("run", "--profile", profile, "--out", out, "--only", tmp_path / "constant.py", "--ablations") == 0
    stored = parts(out)
    assert sum(name.startswith("store/fit/") for name in stored) == 2
    assert sum(name.startswith("store/estimate/") for name in stored) == 3
    comparison = pd.read_csv(out / "tables/comparison.csv")
    assert list(comparison["estimator"]) == [TRUE_START, "constant"]
    table = pd.read_csv(out / "tables/ablations.csv")
    assert list(table["estimator"]) == ["constant:no_scale", "constant:shifted"]
    assert (table["parameter_error_pct"].abs() > 0.1).all()
    assert set(pd.read_csv(out / "latency.csv")["estimator"]) == {"constant"}
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["ablations"] == ["constant:no_scale", "constant:shifted"]
    assert manifest["estimators"] == ["constant"]


def test_an_ablation_of_an_ablation_is_none():
    assert ablated(DeepONetKalman, "no_gate").ablations == {}


def test_what_a_part_is_worth_is_said_by_its_interval_alone():
    whole = np.random.default_rng(2).uniform(8.0, 12.0, 20)
    jitter = np.tile([-1.0, 1.0], 10)
    told = {"no_gate": whole + 2.0, "update_10_hz": whole - 0.5, "window_16": whole}
    told["no_trust"] = whole + 0.01 + 0.1 * jitter
    rows = [
        (name, 0, f"test-{i:02d}", metric, value)
        for metric in ("health_life_pct", "coverage95_pct")
        for name, values in {"deeponet_kalman": whole, **{f"deeponet_kalman:{n}": v for n, v in told.items()}}.items()
        for i, value in enumerate(values)
    ]
    scores = pd.DataFrame(rows, columns=["estimator", "seed", "sequence", "metric", "value"])
    health, coverage = parts_are_worth(scores, {})
    assert health.endswith(
        "own 95 % interval: it errs more with no gate 2.00 (2.00 to 2.00); it errs less with update 10 hz "
        "−0.500 (−0.500 to −0.500); no difference is found with no trust and window 16."
    )
    assert "fewer with update 10 hz" in coverage
    assert parts_are_worth(scores[scores["estimator"] == "deeponet_kalman"], {}) == []
    assert parts_are_worth(scores[scores["estimator"] != "deeponet_kalman"], {}) == []
