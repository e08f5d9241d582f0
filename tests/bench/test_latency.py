"""The clock and its watch, and `twinbench latency` on a DeepONet-Kalman trained for a moment."""

from __future__ import annotations

import contextlib
import functools
import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.tiny_run import run_arguments, run_here, twinbench, write_profile
from rich.console import Console

from twinbench.bench.latency import forms, memory, stages, timing
from twinbench.bench.latency.timing import Name, Timed, Watch, back_to_back, one_core, paced, percentiles
from twinbench.common.progress import Progress
from twinbench.methods.deeponet_kalman.method import DeepONetKalman

SETTINGS = "[settings.deeponet_kalman]\n" + "".join(
    f"{k} = {json.dumps(v)}\n" for k, v in DeepONetKalman.contract_settings.items()
)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """What ``twinbench latency`` leaves; no window length but the twin's own, as each has to be compiled.

    A process of its own is weighed in place and out of it: all forms but the one in place load the same.
    """
    folder, weigh = tmp_path_factory.mktemp("latency"), functools.cache(memory.process_MB)
    profile = write_profile(folder, more=SETTINGS)
    with pytest.MonkeyPatch.context() as patch:
        run_here(patch)
        patch.setattr(forms, "WINDOWS", (64,))
        patch.setattr(stages, "TICKS", 500)
        patch.setattr(memory, "process_MB", lambda stored, form: weigh(stored, form if form == forms.IN_PLACE else ""))
        assert twinbench(*run_arguments(profile, folder / "run", ["deeponet_kalman"])) == 0
        arguments = ("--profile", profile, "--results", folder / "run", "--updates", 200, "--ticks", 4)
        assert twinbench("latency", *arguments, "--out", folder / "out") == 0
        yield folder / "out"


def test_every_form_is_timed_in_both_modes(measured: Path) -> None:
    table = pd.read_csv(measured / "latency.csv")
    for _, rows in table.groupby("mode"):
        listed = set(rows[["estimator", "implementation"]].itertuples(index=False, name=None))
        assert listed >= {("deeponet_kalman", form) for form in ("in place", "compiled", "plain torch")}
        assert listed >= {("operator", form) for form in ("compiled", "ONNX", "torch")}
    hot = table[table["mode"] == "back_to_back"].set_index(["estimator", "implementation"])["p50_us"]
    in_place = hot["deeponet_kalman", "in place"]
    assert 4 * in_place < hot["deeponet_kalman", "plain torch"]
    assert 4 * in_place < hot["filterpy_ukf", "NumPy model"]
    assert hot["operator", "compiled"] < hot["operator", "torch"]


def test_the_stages_are_parts_of_the_update(measured: Path) -> None:
    us = pd.read_csv(measured / "stages.csv").set_index("stage")["us"]
    assert tuple(us.index) == stages.STAGES
    assert (us.drop("synchronisation") > 0.0).all()
    assert us["synchronisation"] > -0.25 * us.sum()  # a difference of two times


def test_memory_is_told_and_small(measured: Path) -> None:
    held = pd.read_csv(measured / "memory.csv").set_index("implementation")
    assert held.loc["in place", ["weights_kB", "buffers_kB"]].sum() < 4000.0
    assert held.loc["in place", "besides_kB"] < 1.0
    assert held["process_MB"].gt(50.0).all()


def test_the_page_and_the_figures_are_there(measured: Path) -> None:
    assert {p.stem for p in (measured / "figures").iterdir()} == {"latency", "fig7a_stages", "fig7b_windows"}
    assert "DeepONet-Kalman, in place" in (measured / "latency.md").read_text()
    assert json.loads((measured / "manifest.json").read_text())["measured"]["loaded"] in (False, True)


def test_percentiles_are_those_of_numpy_and_jitter_is_the_mean_change() -> None:
    us = np.random.default_rng(0).exponential(30.0, 5000)
    found = percentiles(us)
    assert found["p99_us"] == pytest.approx(np.percentile(us, 99), abs=0.01)
    assert found["max_us"] == pytest.approx(us.max(), abs=0.01)
    assert percentiles(np.array([1.0, 3.0, 2.0]))["jitter_us"] == 1.5
    assert percentiles(np.array([7.0]))["jitter_us"] == 0.0


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system pins no processes")
def test_a_process_is_pinned_only_while_it_measures() -> None:
    before = os.sched_getaffinity(0)
    with contextlib.suppress(KeyboardInterrupt), one_core() as core:
        assert os.sched_getaffinity(0) == {core}
        raise KeyboardInterrupt
    assert os.sched_getaffinity(0) == before


def test_rounds_interleave_and_every_sample_is_kept() -> None:
    calls: list[str] = []
    several = [Timed(Name(n, "", 1), lambda _, n=n: calls.append(n), [0]) for n in "ab"]
    calls.clear()
    took = back_to_back(several, 25, Progress(Console(quiet=True)))
    assert [us.shape for us in took.values()] == [(25,), (25,)]
    assert "".join(calls).startswith("aaabbbaaabbb")


def test_the_pace_is_kept() -> None:
    at: list[float] = []
    one = Timed(Name("a", "", 1), lambda _: at.append(timing.time.perf_counter()), [0])
    at.clear()
    paced([one], 5, 0.05, Progress(Console(quiet=True)))
    assert np.diff(at).mean() == pytest.approx(0.05, rel=0.2)


@pytest.mark.parametrize(("others", "loaded"), [(0.5, True), (0.01, False)])
def test_a_loaded_machine_is_called_one(monkeypatch: pytest.MonkeyPatch, others: float, loaded: bool) -> None:
    clock = iter([100.0, 110.0])
    busy = iter([(50.0, 1.0), (50.0 + 10.0 * (1.0 + others), 1.0)])
    own = iter([20.0, 30.0])
    monkeypatch.setattr(timing.time, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(timing, "_machine_s", lambda: next(busy))
    monkeypatch.setattr(timing, "_own_s", lambda: next(own))
    told = Watch().told()
    assert told["loaded"] is loaded
    assert told["others_cores"] == pytest.approx(others, abs=1e-3)
