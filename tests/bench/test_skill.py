"""Skill over what costs nothing, in closed form; the two strata; and who is told apart before a sentence says so."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from statsmodels.stats.multitest import multipletests

from twinbench.bench.roster import PRIOR, REFERENCE, TRIVIAL, TRUE_START, UNRANKED
from twinbench.bench.statistics.apart import adjusted, family, told_apart
from twinbench.bench.statistics.bootstrap import sequence_scores
from twinbench.bench.statistics.ranks import holm, wilcoxon_p
from twinbench.bench.statistics.skill import best_trivial, skills
from twinbench.bench.statistics.strata import SINGLE, of_stratum
from twinbench.bench.statistics.summary import FORECAST, LIFE, summarise
from twinbench.data import benchmark

S = 20
FORECASTS = ("p_open60_pct", "T_open60_pct", "m_open60_pct")


def rows(errors: dict[str, np.ndarray], metric: str = LIFE, prefix: str = "test-") -> pd.DataFrame:
    found = [(e, 0, f"{prefix}{s:02d}", metric, float(v)) for e, values in errors.items() for s, v in enumerate(values)]
    return pd.DataFrame(found, columns=["estimator", "seed", "sequence", "metric", "value"])


def drawn(mean: float, seed: int) -> np.ndarray:
    return mean * (1.0 + 0.1 * np.random.default_rng(seed).normal(size=S))


BASE = drawn(30.0, 0)
ERRORS = {
    PRIOR: BASE, "training_mean": 0.8 * BASE, "last_value": 1.5 * BASE, REFERENCE: drawn(4.0, 1),
    TRUE_START: 0.5 * BASE, "gru_kf": 0.2 * BASE, "deeponet": drawn(12.0, 2), "lstm_rls": drawn(12.05, 3),
    "pinn_ukf": 1.6 * BASE,
}  # fmt: skip


def test_skill_is_what_is_saved_of_the_best_trivial_rows_error():
    table = sequence_scores(rows(ERRORS), LIFE)
    assert best_trivial(table) == "training_mean"
    found = skills(table)
    # In every recording a quarter of its error: whatever is resampled, skill is 3/4.
    assert found["gru_kf"] == pytest.approx((0.75, 0.75, 0.75, "training_mean"))
    assert found["pinn_ukf"][:3] == pytest.approx((-1.0, -1.0, -1.0))
    assert found[PRIOR].value == pytest.approx(1.0 - 1.0 / 0.8)
    assert "training_mean" not in found
    deeponet = found["deeponet"]
    assert deeponet.value == pytest.approx(1.0 - ERRORS["deeponet"].mean() / (0.8 * BASE.mean()))
    assert deeponet.low < deeponet.value < deeponet.high


def test_without_a_complete_trivial_row_there_is_no_skill():
    few = {name: values for name, values in ERRORS.items() if name not in TRIVIAL}
    assert skills(sequence_scores(rows(few), LIFE)) == {}
    holed = rows({**few, PRIOR: np.append(BASE[:-1], np.nan)})
    assert skills(sequence_scores(holed, LIFE)) == {}


def test_the_summary_ranks_one_stratum_and_keeps_the_other():
    single = rows({name: 2.0 * values for name, values in ERRORS.items()}, prefix=SINGLE)
    ahead = pd.concat([rows(ERRORS, metric) for metric in FORECASTS])
    summary = summarise(pd.concat([rows(ERRORS), single, ahead]), {})
    assert summary.value("gru_kf", LIFE).mean == pytest.approx(0.2 * BASE.mean())
    assert summary.skill("gru_kf", LIFE).value == pytest.approx(0.75)
    assert summary.skill("gru_kf", FORECAST).value == pytest.approx(0.75)
    assert set(summary.rankings[LIFE].estimators) == set(ERRORS) - set(UNRANKED)
    paper = summarise(pd.concat([rows(ERRORS), single, ahead]), {}, "single")
    assert paper.value("gru_kf", LIFE).mean == pytest.approx(0.4 * BASE.mean())
    assert FORECAST not in paper.rankings
    assert len(of_stratum(rows(ERRORS), "single")) == 0
    assert SINGLE == f"{benchmark.SINGLE}-"


def test_a_run_without_one_stratum_has_an_empty_summary_of_it():
    summary = summarise(rows(ERRORS), {}, "single")
    assert (summary.values, summary.rankings) == ({}, {})
    assert not summary.told_apart("gru_kf", "deeponet", LIFE)


def test_told_apart_is_holms_correction_over_the_ranked_pairs():
    summary = summarise(rows(ERRORS), {})
    ranked = [n for n in ERRORS if n not in UNRANKED]
    pairs = [(a, b) for i, a in enumerate(ranked) for b in ranked[i + 1 :]]
    apart = multipletests([wilcoxon_p(ERRORS[b] - ERRORS[a]) for a, b in pairs], 0.05, "holm")[0]
    assert {pair: summary.told_apart(*pair, LIFE) for pair in pairs} == dict(zip(pairs, map(bool, apart), strict=True))
    assert summary.better("gru_kf", "deeponet", LIFE)
    assert not summary.better("deeponet", "gru_kf", LIFE)
    assert not summary.better("deeponet", "lstm_rls", LIFE)
    assert not summary.told_apart("gru_kf", "nobody", LIFE)


def test_many_recordings_are_tested_as_few_are():
    """Of more than fifty recordings all pairs are tested at once."""
    rng = np.random.default_rng(4)
    errors = {name: np.abs(rng.normal(1.0 + 0.1 * i, 0.5, 60)) for i, name in enumerate("abcde")}
    errors["e"][:4] = errors["a"][:4]  # equal there
    table = sequence_scores(rows(errors), LIFE)
    pairs = [(a, b) for a in errors for b in errors if a < b]
    each = np.array([wilcoxon_p(errors[b] - errors[a]) for a, b in pairs])
    found = adjusted(table, pairs)
    np.testing.assert_allclose([found[frozenset(pair)] for pair in pairs], holm(each), rtol=1e-12)


def test_a_reference_row_is_tested_against_every_ranked_one():
    table = sequence_scores(rows(ERRORS), LIFE)
    ranked = [n for n in table.estimators if n not in UNRANKED]
    assert family(table, "gru_kf", REFERENCE) == [(REFERENCE, name) for name in ranked]
    assert set(map(frozenset, family(table, PRIOR, REFERENCE))) <= {
        frozenset((a, b)) for a in UNRANKED for b in UNRANKED if a != b
    }
    assert told_apart(table, "gru_kf", REFERENCE)


def test_where_mean_and_ranks_disagree_nobody_is_better():
    """Nineteen recordings a little better, one very much worse."""
    other = np.append(BASE[:-1] - 1.0 - 0.01 * np.arange(S - 1), BASE[-1] + 500.0)
    table = sequence_scores(rows({"gru_kf": BASE, "deeponet": other}), LIFE)
    assert wilcoxon_p(other - BASE) < 0.05
    assert not told_apart(table, "gru_kf", "deeponet")
