"""The runner: the same tables however often it is killed, wherever it runs, and whoever fails."""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from helpers.tiny_run import comparable, parts, run_arguments, twinbench, write_estimator, write_profile

from twinbench.bench.cells import make_cell
from twinbench.bench.cost import foretold
from twinbench.bench.profile import load_profile
from twinbench.bench.registry import find
from twinbench.bench.runner import plan, who
from twinbench.bench.statistics.scores import METRICS
from twinbench.common.store import Store
from twinbench.common.versions import code_version

pytestmark = pytest.mark.usefixtures("in_this_process")

KILLER = """
import glob, os, random, shutil, signal, sys, time
# Before the forks: the kills shall fall into the work, not into imports.
import twinbench.bench.report.write, twinbench.bench.runner, torch
from twinbench.bench.cli.main import main

twinbench.bench.report.write.draw = lambda *_: iter(())  # nor into drawing, which takes longest

out, arguments = sys.argv[1], sys.argv[2:]

def start():
    child = os.fork()
    if child == 0:
        os._exit(main(arguments))
    return child

main(arguments)  # compiles, so that what is timed is a run and no more
shutil.rmtree(out)
begun = time.monotonic()
assert os.waitpid(start(), 0)[1] == 0
lasts = time.monotonic() - begun
shutil.rmtree(out)
rng = random.Random(20240)
depths = []
for moment in sorted(rng.uniform(0, lasts) for _ in range(10)):
    while True:
        child = start()
        time.sleep(moment)
        os.kill(child, signal.SIGKILL)
        if os.WIFSIGNALED(os.waitpid(child, 0)[1]):
            break
        shutil.rmtree(out)
        moment *= 0.9  # it was quicker than its killer
    depths.append(len(glob.glob(out + "/store/*/*/.done")))
print(*depths)
"""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """A profile, and two estimators that do not fail."""
    folder = tmp_path_factory.mktemp("inputs")
    return write_profile(folder), [write_estimator(folder, "steady"), write_estimator(folder, "wrong", scale=1.05)]


@pytest.fixture(scope="module")
def undisturbed(inputs: tuple[Path, list[str]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Their run in one go."""
    out = tmp_path_factory.mktemp("undisturbed")
    assert twinbench(*run_arguments(inputs[0], out, inputs[1])) == 0
    return out


def test_ten_kills_leave_the_tables_of_an_undisturbed_run(
    inputs: tuple[Path, list[str]], undisturbed: Path, tmp_path: Path
) -> None:
    profile, estimators = inputs
    out = tmp_path / "out"
    arguments = run_arguments(profile, out, estimators)
    killer = subprocess.run(
        [sys.executable, "-c", KILLER, str(out), *arguments], capture_output=True, text=True, timeout=400
    )
    assert killer.returncode == 0, killer.stderr
    depths = killer.stdout.splitlines()[-1].split()
    assert len(depths) == 10
    assert len(set(depths)) > 1, "the kills all fell into the same stage"
    # To the end with worker processes.
    finish = subprocess.run(
        [sys.executable, "-m", "twinbench", *arguments],
        capture_output=True,
        text=True,
        timeout=200,
        env={**os.environ, "LOKY_MAX_CPU_COUNT": "2"},
    )
    assert finish.returncode == 0, finish.stderr
    assert comparable(out) == comparable(undisturbed)
    assert set(parts(out)) == set(parts(undisturbed))
    assert not list(out.rglob(".*.part"))


def test_what_fails_is_told_and_the_others_go_on(
    inputs: tuple[Path, list[str]], undisturbed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    profile, estimators = inputs
    raises = write_estimator(tmp_path, "raises", fit='raise RuntimeError("did not converge\\n at all")')
    nan = write_estimator(tmp_path, "blank", step="state = state._replace(mean=state.mean * np.nan)")
    assert twinbench(*run_arguments(profile, tmp_path / "out", [*estimators, raises, nan])) == 1
    failures = pd.read_csv(tmp_path / "out" / "failures.csv")
    reason = "FloatingPointError: blank: the estimate or its interval is not finite at 0.00 s"
    assert failures.to_numpy().tolist() == [
        ["blank", 0, "estimate", reason],
        ["raises", 0, "fit", "RuntimeError: did not converge"],
    ]
    scores = pd.read_csv(tmp_path / "out" / "scores.csv")
    lost = scores["estimator"].isin(["raises", "blank"])
    assert scores.loc[lost, "value"].isna().all()
    assert lost.sum() == 2 * len(METRICS) * scores["sequence"].nunique()
    pd.testing.assert_frame_equal(
        scores[~lost].reset_index(drop=True), pd.read_csv(undisturbed / "scores.csv"), check_exact=True
    )
    for name in ("tables/comparison.md", "tables/comparison.csv", "tables/comparison.tex", "report.html"):
        assert "did not converge" in (tmp_path / "out" / name).read_text(), name
    assert "failed: raises, seed 0, fit: RuntimeError: did not converge" in capsys.readouterr().out


def test_a_changed_setting_runs_again_only_what_depends_on_it(inputs: tuple[Path, list[str]], tmp_path: Path) -> None:
    profile, estimators = inputs
    out = tmp_path / "out"
    assert twinbench(*run_arguments(profile, out, estimators)) == 0
    first = parts(out)
    assert sorted(name.split("/")[1] for name in first) == ["data", "estimate", "estimate", "fit", "fit"]
    changed = write_profile(tmp_path, more="[settings.wrong]\nscale = 1.1\n")
    assert twinbench(*run_arguments(changed, out, estimators)) == 0
    second = parts(out)
    assert first.items() <= second.items()
    assert sorted(name.split("/")[1] for name in set(second) - set(first)) == ["estimate", "fit"]
    assert twinbench(*run_arguments(profile, out, estimators), "--no-resume") == 0
    third = parts(out)
    assert third.keys() == second.keys()
    assert not third.items() & first.items(), "what it runs, it makes again"
    assert third.items() - first.items() > second.items() - first.items(), "and nothing else"


def test_seeds_share_what_draws_nothing(inputs: tuple[Path, list[str]], tmp_path: Path) -> None:
    spec = Path(write_estimator(tmp_path, "still", fit="if seed: raise RuntimeError('not for me')"))
    spec.write_text(spec.read_text().replace("    window = 7\n", "    window, draws = 7, False\n"))
    profile, out = tmp_path / "two.toml", tmp_path / "out"
    profile.write_text(inputs[0].read_text().replace("seeds = [0]", "seeds = [0, 1]"))
    assert twinbench(*run_arguments(profile, out, [str(spec)])) == 0
    assert sorted(name.split("/")[1] for name in parts(out)) == ["data", "estimate", "fit"]
    scores = pd.read_csv(out / "scores.csv").query("estimator == 'still'")
    one, other = (rows.drop(columns="seed") for _, rows in scores.groupby("seed"))
    pd.testing.assert_frame_equal(one.reset_index(drop=True), other.reset_index(drop=True), check_exact=True)
    assert len(pd.read_csv(out / "cost.csv")) == 2
    spec.write_text(spec.read_text().replace("if seed", "if True"))
    assert twinbench(*run_arguments(profile, out, [str(spec)])) == 1
    assert pd.read_csv(out / "failures.csv")["seed"].tolist() == [0, 1]


def test_keys_depend_on_what_the_part_depends_on(inputs: tuple[Path, list[str]]) -> None:
    profile, (spec, _) = load_profile(str(inputs[0])), inputs[1]
    cell = make_cell(spec, 0, profile)

    def changed(seed: int = 0, **changes: object) -> tuple[bool, bool, bool]:
        other = make_cell(spec, seed, dataclasses.replace(profile, **changes))
        return other.data != cell.data, other.fit != cell.fit, other.estimates != cell.estimates

    assert changed() == (False, False, False)
    assert changed(name="other", latency=dataclasses.replace(profile.latency, updates=7)) == (False, False, False)
    assert changed(evaluation=dataclasses.replace(profile.evaluation, stride=5)) == (False, False, True)
    assert changed(settings={"wrong": {"scale": 1.2}}) == (False, False, False)
    assert changed(settings={"steady": {"scale": 1.2}}) == (False, True, True)
    assert changed(seed=1) == (False, True, True)
    assert changed(corruption=dataclasses.replace(profile.corruption, noise=2.0)) == (True, True, True)
    assert changed(data=dataclasses.replace(profile.data, seed=1)) == (True, True, True)


def test_latency_times_every_implementation_and_says_who_cannot(tmp_path: Path) -> None:
    profile = write_profile(tmp_path, updates=25)
    profile.write_text(profile.read_text().replace("n_calibration = 1", "n_calibration = 2"))
    good = write_estimator(tmp_path, "steady")
    crowd = write_estimator(tmp_path, "crowd", step='assert len(state.mean) > 1, "needs company"')
    assert twinbench(*run_arguments(profile, tmp_path / "out", [good, crowd])) == 1
    latency = pd.read_csv(tmp_path / "out" / "latency.csv")
    assert latency[["estimator", "mode", "implementation", "window"]].to_numpy().tolist() == [
        ["steady", "back_to_back", "quick", 7],
        ["steady", "back_to_back", "slow", 7],
    ]
    quick, slow = latency["p50_us"]
    assert slow > 2 * quick
    assert (latency[["p50_us", "p95_us", "p99_us", "max_us"]].diff(axis=1).iloc[:, 1:] >= 0).all(axis=None)
    assert latency["memory_kB"].min() == latency["memory_kB"].max() > 0.0
    failures = pd.read_csv(tmp_path / "out" / "failures.csv")
    assert failures["stage"].tolist() == ["latency", "latency"]
    assert failures["reason"].tolist() == [f"{i}: AssertionError: needs company" for i in ("quick", "slow")]
    scores = pd.read_csv(tmp_path / "out" / "scores.csv")
    assert scores.loc[scores["metric"] == "p_nrmse_pct", "value"].notna().all(), "its estimates stand"


def test_the_code_of_a_plug_in_is_that_of_its_file_not_of_its_name(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    here, there = write_estimator(tmp_path, "steady"), write_estimator(tmp_path / "other", "steady", scale=1.05)
    versions = [code_version(find(path).__module__) for path in (here, there, here)]
    assert versions[0] == versions[2] != versions[1]


def test_what_each_part_cost_is_kept_with_it_and_told_by_every_later_run(
    inputs: tuple[Path, list[str]], undisturbed: Path, tmp_path: Path
) -> None:
    out = shutil.copytree(undisturbed, tmp_path / "out")

    def cost() -> pd.DataFrame:
        return pd.read_csv(out / "cost.csv")

    first = cost()
    parts_ = [(e, s) for s in ("fit", "estimate") for e in ("steady", "wrong")]
    assert sorted(map(tuple, first[["estimator", "stage"]].to_numpy())) == sorted(parts_)
    assert (first["cpu_s"] >= 0.0).all()
    assert first["cpu_s"].sum() > 0.0
    assert twinbench(*run_arguments(inputs[0], out, inputs[1])) == 0
    pd.testing.assert_frame_equal(cost(), first)
    for file in (out / "store").rglob("cpu_s"):
        file.unlink()
    assert twinbench(*run_arguments(inputs[0], out, inputs[1])) == 0
    assert cost()["cpu_s"].isna().all()


def test_a_run_says_whom_it_runs_ablations_alone_too() -> None:
    whole, first, second = "deeponet_kalman", "deeponet_kalman:window_16", "deeponet_kalman:no_gate"

    def said(*names: str) -> str:
        return who(plan(load_profile("first_seed"), names))

    assert said(whole, "last_value", first, second) == "Last value held and DeepONet-Kalman, and 2 ablations"
    assert said(whole, first) == "DeepONet-Kalman, and 1 ablation"
    assert said(first, second) == f"{second} and {first}"
    assert said(whole) == "DeepONet-Kalman"


def test_a_run_says_before_it_starts_what_is_left_and_what_it_will_cost(
    inputs: tuple[Path, list[str]],
    undisturbed: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def told(out: Path, text: str) -> str:
        path = tmp_path / "tiny.toml"
        path.write_text(text)
        profile = load_profile(str(path))
        return foretold(plan(profile, tuple(inputs[1])), profile, Store(out / "store"), out)

    monkeypatch.chdir(tmp_path)
    out, text = shutil.copytree(undisturbed, tmp_path / "out"), inputs[0].read_text()
    assert told(out, text) == "to do: nothing is left to train or evaluate"
    unknown = (
        "to do: 2 trainings and 2 evaluations; their cost is not known: no cost.csv of them in new or results/paper"
    )
    assert told(Path("new"), text) == unknown
    rows = ["steady,0,fit,360", "steady,0,estimate,120", "wrong,0,fit,"]
    (out / "cost.csv").write_text("\n".join(["estimator,seed,stage,cpu_s", *rows]) + "\n")
    # Trained on twice the recordings, it is evaluated on as many as before.
    more = text.replace("n_train = 2", "n_train = 4")
    said = f"to do: 2 trainings and 2 evaluations, about 14 core-minutes by {out}/cost.csv; the cost of 2 is not known"
    assert told(out, more) == said
    assert told(out, text.replace("minutes = 2.5", "minutes = 4.5")).count("about 16 core-minutes") == 1
    (out / "manifest.json").write_text("{")
    assert "is not known" in told(out, more)
    assert twinbench(*run_arguments(inputs[0], Path("new"), inputs[1][:1])) == 0
    assert "to do: 1 training and 1 evaluation; their cost is not known" in capsys.readouterr().err
