"""Tables and figures of harder conditions, from a table of scores."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from twinbench.bench.report.figures.robustness import after_faults, beyond_the_envelope, noise_and_dropout
from twinbench.bench.report.robustness_says import faults_say
from twinbench.bench.report.robustness_tables import robustness_tables
from twinbench.bench.robustness import COLUMNS, METRICS, TREATMENTS
from twinbench.data.disturb import CONDITIONS, DROPOUT_LEVELS, FAULTS, NOISE_LEVELS


@pytest.fixture(scope="module")
def scores() -> pd.DataFrame:
    """Every trial of two estimators and the treatments; errors grow with noise, and after a stuck flow meter."""
    rng = np.random.default_rng(0)
    rows = []
    for name in ("oracle", "deeponet_kalman", *(f"deeponet_kalman:{t}" for t in TREATMENTS)):
        tried = [("fault", "none", 1.0), *((c.group, c.name, c.corruption.noise) for c in CONDITIONS)]
        for group, condition, noise in tried:
            for metric in (*METRICS, "health_after_fault_pct"):
                hurt = 3.0 if condition == "stuck m_flow_kg_s" and metric == "health_after_fault_pct" else 1.0
                rows += [
                    (name, 0, group, condition, f"s{i}", metric, noise * hurt * (1 + 0.01 * rng.random()))
                    for i in range(3)
                ]
    return pd.DataFrame(rows, columns=COLUMNS)


def test_the_map_shows_every_level_of_noise_and_dropout(scores):
    axes = noise_and_dropout(scores).axes[0]
    assert axes.collections[0].get_array().shape == (len(NOISE_LEVELS), len(DROPOUT_LEVELS))
    assert len(axes.texts) == len(NOISE_LEVELS) * len(DROPOUT_LEVELS)
    assert (np.diff(np.asarray(axes.collections[0].get_array()), axis=0) > 0).all()


def test_four_treatments_of_the_envelope_are_told_apart(scores):
    left, right = beyond_the_envelope(scores).axes
    for axes in (left, right):
        drawn = [line for line in axes.lines if len(line.get_xdata()) > 2]
        assert len({(line.get_color(), line.get_marker(), line.get_linestyle()) for line in drawn}) == 4


def test_after_faults_each_kind_has_the_mean_over_its_sensors(scores):
    axes = after_faults(scores).axes[0]
    names, kinds = ([t.get_text() for t in labels] for labels in (axes.get_yticklabels(), axes.get_xticklabels()))
    assert names == ["Oracle (reference)", "DeepONet-Kalman"]
    values = np.asarray(axes.collections[0].get_array())
    stuck = kinds.index("stuck")
    assert values[:, stuck] == pytest.approx([(3.0 + 1.0 + 1.0) / 3.0] * 2, rel=0.05)
    assert kinds[0] == "none"
    assert np.delete(values, stuck, axis=1) == pytest.approx(1.0, rel=0.05)


def test_the_tables_hold_errors_and_their_multiples(scores):
    harder, faults, pressure, health, kinds = robustness_tables(scores)
    assert list(faults.frame.columns) == ["condition", "oracle", "deeponet_kalman"]
    row = faults.frame["condition"].tolist().index("stuck m_flow_kg_s")
    assert faults.frame["oracle"][row] == pytest.approx(3.0, rel=0.05)
    assert faults.rows[row][0].text == "stuck: mass flow"
    assert [r[0].text for r in harder.rows[:2]] == ["none", "wear at pace 0.5"]
    assert faults.rows[row][1].times.startswith("×3")
    assert len(harder.rows) == 1 + sum(c.group in ("pace", "envelope") for c in CONDITIONS)
    for grid in (pressure, health):
        assert len(grid.rows) == 1 + len(NOISE_LEVELS) * len(DROPOUT_LEVELS)
    assert kinds.frame["estimator"].tolist() == ["oracle", "deeponet_kalman"]
    assert kinds.frame["stuck"].tolist() == pytest.approx(2 * [(3.0 + 1.0 + 1.0) / 3.0], rel=0.05)
    assert [c.text for c in next(zip(*kinds.rows, strict=True))] == ["Oracle (reference)", "DeepONet-Kalman"]
    column = [c.head for c in kinds.columns].index("stuck")
    assert all(row[column].times.startswith("×1.7") for row in kinds.rows)
    assert len(kinds.columns) == 2 + len({f.name.removesuffix(f" {f.channels[0]}") for f in FAULTS})
    assert robustness_tables(scores[:0]) == []


def test_who_was_not_tried_under_a_group_is_not_in_its_tables(scores):
    oracle = scores["estimator"] == "oracle"
    harder, faults, pressure, _, _ = robustness_tables(scores[~oracle | (scores["group"] == "fault")])
    assert list(faults.frame.columns) == ["condition", "oracle", "deeponet_kalman"]
    for table in (harder, pressure):
        assert list(table.frame.columns) == ["condition", "deeponet_kalman"]


def test_a_multiple_has_the_interval_of_its_recordings(scores):
    faults = robustness_tables(scores)[1]
    row = faults.frame["condition"].tolist().index("stuck m_flow_kg_s")
    low, high = (float(end) for end in faults.rows[row][1].times.partition("[")[2].rstrip("]").split("–"))
    assert 2.9 < low <= high < 3.1


def test_sentences_say_which_faults_cost_and_whether_a_row_that_costs_nothing_is_as_good(scores):
    prior = scores[scores["estimator"] == "oracle"].assign(estimator="always_prior")
    prior = prior.assign(value=1.3 + 0.01 * np.arange(len(prior)) % 0.05)
    grown, against = faults_say(pd.concat([scores, prior]))
    larger, _, level = grown.partition(". It is not shown to be larger after ")
    assert larger.startswith("From a minute after the longest fault on, the health error of DeepONet-Kalman is larger ")
    assert "stuck 1.7 times (" in larger
    assert "spikes" in level
    assert against.startswith("By the paired 95 % interval it errs less than Always at the prior after ")
    assert "After stuck it errs more: 0.3" in against
    assert faults_say(scores[:0]) == []
