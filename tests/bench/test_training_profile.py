"""Where training spends its time: the function that takes it is listed first."""

from __future__ import annotations

from pathlib import Path

from helpers.tiny_run import write_estimator

from twinbench.bench.benchmarks.training_profile import MOST_FUNCTIONS, profile
from twinbench.data.benchmark import DesignConfig, simulate_benchmark

SLOW = """
        def dawdle():
            for i in range(3_000_000):
                pass
        dawdle()
"""


def test_what_takes_longest_comes_first(tmp_path: Path) -> None:
    design = DesignConfig(
        n_train=1, n_validation=1, n_calibration=1, n_test=1, n_single=0, minutes=1.0, warmup_minutes=0.5
    )
    table = profile(write_estimator(tmp_path, "slow", fit=SLOW.strip()), simulate_benchmark(design), 10)
    assert table.iloc[0]["function"] == "slow.dawdle"
    assert table.iloc[0]["calls"] == 1
    assert table["own_s"].is_monotonic_decreasing
    assert 0.5 < table["share"].sum() <= 1.001
    assert len(table) <= MOST_FUNCTIONS
