"""A run adds to the comparison in its folder: others' rows stay, its own are replaced, and it is refused elsewhere."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
from helpers.refusals import refused
from helpers.sample_run import write_run
from helpers.tiny_run import parts, run_arguments, twinbench, write_estimator, write_profile

from twinbench.bench.report.write import write_report
from twinbench.bench.roster import TRUE_START

pytestmark = pytest.mark.usefixtures("in_this_process")

TABLES = ("scores.csv", "cost.csv", "failures.csv", "latency.csv", "tables/regimes.csv", "tables/comparison.csv")


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """A finished run of two estimators, one of which fails, and a third estimator."""
    folder = tmp_path_factory.mktemp("two")
    profile = write_profile(folder, updates=10)
    steady, wrong = write_estimator(folder, "steady"), write_estimator(folder, "wrong", scale=1.05)
    fails = write_estimator(folder, "fails", fit="raise RuntimeError('no way')")
    assert twinbench(*run_arguments(profile, folder / "run", [steady, wrong, fails])) == 1
    third = write_estimator(folder, "third", scale=0.95)
    return SimpleNamespace(profile=profile, out=folder / "run", steady=steady, wrong=wrong, third=third)


@pytest.fixture
def run(two: SimpleNamespace, tmp_path: Path) -> Path:
    """A copy of it to add to."""
    return Path(shutil.copytree(two.out, tmp_path / "run"))


def rows(out: Path, file: str, *estimators: str) -> list[str]:
    """The lines of those estimators, as they are written."""
    lines = (out / file).read_text().splitlines()
    return sorted(line for line in lines if line.partition(",")[0] in estimators)


def test_a_further_estimator_stands_beside_those_that_are_there(two: SimpleNamespace, run: Path) -> None:
    assert twinbench(*run_arguments(two.profile, run, [two.third])) == 0
    for file in TABLES[:-1]:
        assert rows(run, file, "steady", "wrong", "fails") == rows(two.out, file, "steady", "wrong", "fails"), file
        assert bool(rows(run, file, "third")) is (file != "failures.csv"), file
    comparison = pd.read_csv(run / "tables" / "comparison.csv")
    assert comparison["estimator"].tolist() == [TRUE_START, "fails", "steady", "third", "wrong"]
    before, after = (json.loads((out / "manifest.json").read_text()) for out in (two.out, run))
    assert after["estimators"] == ["fails", "steady", "third", "wrong"]
    assert {name: after["made"][name] for name in before["made"]} == before["made"]
    assert after["made"]["third"]["commit"] == after["commit"]
    assert set(after["code"]) == set(after["made"]) == set(after["specs"])
    page = (run / "report.html").read_text()
    assert "third" in page
    assert "no way" in page


def test_an_estimator_that_runs_again_replaces_its_own_rows(two: SimpleNamespace, run: Path, tmp_path: Path) -> None:
    changed = write_estimator(tmp_path, "wrong", scale=1.2)
    assert twinbench(*run_arguments(two.profile, run, [changed])) == 0
    assert rows(run, "scores.csv", "steady") == rows(two.out, "scores.csv", "steady")
    new, old = (pd.read_csv(out / "scores.csv").query("estimator == 'wrong'") for out in (run, two.out))
    assert len(new) == len(old)
    assert not new["value"].equals(old["value"])
    assert len(rows(run, "latency.csv", "wrong")) == len(rows(two.out, "latency.csv", "wrong"))
    assert twinbench(*run_arguments(two.profile, run, [two.wrong])) == 0
    assert rows(run, "scores.csv", "wrong") == rows(two.out, "scores.csv", "wrong")
    mended = write_estimator(tmp_path, "fails")
    assert twinbench(*run_arguments(two.profile, run, [mended])) == 0
    assert not rows(run, "failures.csv", "fails")


@pytest.mark.parametrize("with_names", [True, False], ids=["manifest of today", "manifest of before"])
def test_it_adds_to_a_folder_that_holds_the_tables_alone(two: SimpleNamespace, run: Path, with_names: bool) -> None:
    shutil.rmtree(run / "store")
    if not with_names:
        manifest = json.loads((run / "manifest.json").read_text())
        del manifest["made"]
        (run / "manifest.json").write_text(json.dumps(manifest))
    assert twinbench(*run_arguments(two.profile, run, [two.third])) == 0
    for file in TABLES[:-1]:
        assert rows(run, file, "steady", "wrong", "fails") == rows(two.out, file, "steady", "wrong", "fails"), file
    assert rows(run, "tables/regimes.csv", "third")
    manifest = json.loads((run / "manifest.json").read_text())
    assert set(manifest["made"]) == {"fails", "steady", "third", "wrong"}
    earlier = json.loads((two.out / "manifest.json").read_text())
    assert manifest["made"]["steady"]["commit"] == earlier["commit"]
    assert manifest["made"]["steady"]["command"] == earlier["command"]
    assert manifest["made"]["third"]["commit"] == manifest["commit"]


@pytest.mark.parametrize(
    ("key", "says"),
    [
        ("minutes = 3.0", "there data.minutes is 2.5, here it is 3.0"),
        ("origin_every_s = 30.0", "there evaluation.origin_every_s is 20.0, here it is 30.0"),
        ("seeds = [4]", "there seeds is [0], here it is [4]"),
    ],
)
def test_rows_that_cannot_be_compared_are_refused(
    two: SimpleNamespace, run: Path, capsys: pytest.CaptureFixture[str], key: str, says: str
) -> None:
    profile = run.parent / "other.toml"
    lines = two.profile.read_text().splitlines()
    profile.write_text("\n".join(key if key.partition(" ")[0] == ln.partition(" ")[0] else ln for ln in lines))
    line = refused(run, capsys, *run_arguments(profile, run, [two.third]))
    assert says in line
    assert f"--out {run}_more" in line


def test_recordings_of_other_code_are_refused_with_the_library_that_differs(
    two: SimpleNamespace, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    manifest = json.loads((run / "manifest.json").read_text())
    manifest |= {"data_key": "0" * 24, "versions": {**manifest["versions"], "numpy": "1.0"}}
    (run / "manifest.json").write_text(json.dumps(manifest))
    line = refused(run, capsys, *run_arguments(two.profile, run, [two.third]))
    assert "simulated by other code or libraries: numpy 1.0 there and" in line


def test_all_estimators_begin_anew_where_the_recordings_are_others(
    two: SimpleNamespace, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinbench.bench.runner.discover", lambda: {two.third: None})
    assert twinbench("run", "--profile", two.profile, "--out", run) == 0
    assert set(pd.read_csv(run / "scores.csv")["estimator"]) == {TRUE_START, "fails", "steady", "third", "wrong"}
    longer = tmp_path / "tiny.toml"
    longer.write_text(two.profile.read_text().replace("minutes = 2.5", "minutes = 2.6"))
    assert twinbench("run", "--profile", longer, "--out", run) == 0
    assert set(pd.read_csv(run / "scores.csv")["estimator"]) == {TRUE_START, "third"}


def _trained(out: Path) -> dict[str, int]:
    return {name: when for name, when in parts(out).items() if "/latency/" not in name}


def test_to_start_over_with_some_leaves_the_others_trained(two: SimpleNamespace, run: Path) -> None:
    before = _trained(run)
    assert twinbench(*run_arguments(two.profile, run, [two.wrong]), "--no-resume") == 0
    after = _trained(run)
    assert after.keys() == before.keys()
    made_again = {name.split("/")[1] for name, when in after.items() if before[name] != when}
    assert {"fit", "estimate"} <= made_again
    assert sum(before[name] == after[name] for name in before if "/fit/" in name) == 1


def test_rows_under_harder_conditions_stay_until_their_estimator_changes(
    two: SimpleNamespace, run: Path, tmp_path: Path
) -> None:
    tried = pd.DataFrame(
        [(e, 0, "faults", "stuck", "test-00", "p_nrmse_pct", v) for e, v in (("steady", 1.25), ("wrong", 1.5))],
        columns=["estimator", "seed", "group", "condition", "sequence", "metric", "value"],
    )
    tried.to_csv(run / "robustness.csv", index=False)
    for spec, left in (
        (two.third, ["steady", "wrong"]),
        (two.wrong, ["steady", "wrong"]),
        (write_estimator(tmp_path, "wrong", scale=1.3), ["steady"]),
    ):
        assert twinbench(*run_arguments(two.profile, run, [spec])) == 0
        assert pd.read_csv(run / "robustness.csv")["estimator"].tolist() == left
        assert json.loads((run / "manifest.json").read_text())["robustness"] is True


def test_a_report_without_the_store_keeps_what_needed_it_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from twinbench.bench.report.figures import draw

    monkeypatch.setattr("twinbench.bench.report.write.draw", draw)
    out = write_run(tmp_path / "run", {"oracle": 1.0, "gru_kf": 2.0, "deeponet_kalman": 1.2}, 4, seconds=300)
    write_report(out)
    regimes = (out / "tables" / "regimes.csv").read_bytes()
    drawn = {p.name: p.read_bytes() for p in (out / "figures").iterdir() if p.suffix == ".png"}
    shutil.rmtree(out / "store")
    for vector in (out / "figures").glob("fig5c*.svg"):
        vector.unlink()
    write_report(out)
    assert (out / "tables" / "regimes.csv").read_bytes() == regimes
    after = {p.name: p.read_bytes() for p in (out / "figures").iterdir() if p.suffix == ".png"}
    assert after == drawn
    page = (out / "report.html").read_text()
    assert "Drawn by an earlier run, and nothing newer is in it: the store lacks the estimates of Oracle" in page
    assert "data:image/png;base64," in page, "where there is no vector drawing"
    (out / "figures" / "fig5c_parameter_errors.png").unlink()
    write_report(out)
    assert "Not drawn: the store lacks the estimates of Oracle" in (out / "report.html").read_text()


def test_figures_of_estimates_are_figures(tmp_path: Path) -> None:
    from twinbench.bench.report.evidence import gather
    from twinbench.bench.report.figures import FROM_ESTIMATES, WEAR, draw
    from twinbench.bench.results import load_results
    from twinbench.bench.statistics.summary import summarise

    results = load_results(write_run(tmp_path / "run", {"oracle": 1.0, "deeponet_kalman": 1.2}, 2, seconds=200))
    summary = summarise(results.scores, results.failures)
    truth = results.truth()
    assert truth is not None
    evidence = gather(results.estimates(), truth, results.failures)
    names = [d.name for d in draw(summary, evidence, results.latency, results.robustness)]
    assert set(FROM_ESTIMATES) <= set(names)
    assert set(WEAR) <= set(FROM_ESTIMATES)
