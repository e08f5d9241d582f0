"""How long evaluation takes: every trained estimator is listed, with all of its recordings."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.tiny_run import run_arguments, run_here, twinbench, write_estimator, write_profile

from twinbench.bench.benchmarks.evaluation import measure
from twinbench.bench.estimate.apply import Training, trained_cells
from twinbench.bench.profile import load_profile


def test_every_trained_estimator_is_timed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_here(monkeypatch)
    profile = write_profile(tmp_path)
    quick = write_estimator(tmp_path, "quick")
    slow = write_estimator(tmp_path, "slow", step="sum(range(20_000))")
    assert twinbench(*run_arguments(profile, tmp_path / "out", [quick, slow])) == 0
    store, cells = trained_cells(Training(str(profile), tmp_path / "out"), [quick, slow])
    table = measure(store, cells, load_profile(str(profile)).evaluation).set_index("estimator")
    assert (table[["recordings", "samples"]] == [4, 2400]).all(axis=None)
    assert table["wall_s"]["slow"] > table["wall_s"]["quick"] > 0.0
