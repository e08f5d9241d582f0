"""Who is marked in a column, and what a headline and an answer may say."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.stats import wilcoxon
from statsmodels.stats.multitest import multipletests

from twinbench.bench.report.words import answer, headline
from twinbench.bench.roster import PRIOR, REFERENCE, label
from twinbench.bench.statistics.bootstrap import sequence_scores
from twinbench.bench.statistics.marks import marked
from twinbench.bench.statistics.ranks import wilcoxon_p
from twinbench.bench.statistics.summary import FORECAST, LIFE, summarise

S = 12
FORECASTS = ("p_open60_pct", "T_open60_pct", "m_open60_pct")


def scores(errors: dict[str, np.ndarray], forecasts: dict[str, np.ndarray] | None = None) -> pd.DataFrame:
    found = []
    for estimator, values in errors.items():
        for s, value in enumerate(values):
            ahead = (forecasts or errors)[estimator][s]
            found.append((estimator, 0, f"s{s:02d}", LIFE, value))
            found += [(estimator, 0, f"s{s:02d}", metric, ahead) for metric in FORECASTS]
    return pd.DataFrame(found, columns=["estimator", "seed", "sequence", "metric", "value"])


def wobble(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, 0.05, S)


CLEAR = {"gru_kf": 1.0 + wobble(0), "deeponet": 2.0 + wobble(1), "lstm_rls": 3.0 + wobble(2)}
TIED = {"gru_kf": 1.0 + wobble(0), "deeponet": 1.001 + wobble(1), "lstm_rls": 3.0 + wobble(2)}
LEVEL = {name: 1.0 + wobble(i) for i, name in enumerate(CLEAR)}


def group(errors, metric=LIFE):
    return set(marked(sequence_scores(scores(errors), metric)))


def test_only_who_is_told_from_all_others_is_marked_alone():
    assert group(CLEAR) == {"gru_kf"}
    assert group(TIED) == {"gru_kf", "deeponet"}
    assert group(LEVEL) == set()


def test_reference_rows_are_never_marked():
    best = {REFERENCE: 0.1 + wobble(5), PRIOR: 0.2 + wobble(6)}
    assert group({**CLEAR, **best}) == {"gru_kf"}


def test_a_mark_holds_for_all_pairs_together():
    """Holm's correction is over all pairs, as statsmodels makes it."""
    rng = np.random.default_rng(3)
    for _ in range(6):
        errors = {name: rng.normal(1.0 + 0.15 * i, 0.3, S) for i, name in enumerate("abcd")}
        names = list(errors)
        pairs = [(x, y) for i, x in enumerate(names) for y in names[i + 1 :]]
        apart = multipletests([wilcoxon(errors[y] - errors[x]).pvalue for x, y in pairs], 0.05, "holm")[0]
        best = min(names, key=lambda n: errors[n].mean())
        alike = {
            n
            for n in names
            if n == best or not dict(zip(map(frozenset, pairs), apart, strict=True))[frozenset((best, n))]
        }
        assert group(errors) == (alike if len(alike) < 4 else set())


def test_tied_differences_are_tested_as_scipy_tests_them():
    rng = np.random.default_rng(0)
    for n in (3, 5, 7, 8):
        difference = rng.integers(-3, 5, size=n).astype(float)
        assert wilcoxon_p(difference) == pytest.approx(wilcoxon(difference).pvalue, abs=1e-12)


@pytest.mark.parametrize(
    ("errors", "forecasts", "says"),
    [
        (CLEAR, CLEAR, "GRU + KF keeps the twin truest"),
        (TIED, TIED, "GRU + KF cannot be told apart from one other in health, nor from one other in the forecast"),
        (LEVEL, CLEAR, "GRU + KF cannot be told apart from two others in health; it foretells the next minute best"),
        (
            CLEAR,
            {**CLEAR, "deeponet": 0.5 + wobble(1)},
            "GRU + KF knows the machine's health best; DeepONet foretells the next minute best",
        ),
    ],
)
def test_the_headline_says_no_more_than_the_tests(errors, forecasts, says):
    assert says in headline(summarise(scores(errors, forecasts), {}))


def test_who_is_alike_is_named_with_its_p():
    first = answer(summarise(scores(TIED), {}))[0]
    assert "It does not differ significantly from DeepONet (p = " in first
    assert f"but does from {label('lstm_rls')} (Wilcoxon's test, Holm's correction for all pairs)" in first
    assert FORECAST not in first
