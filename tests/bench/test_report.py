"""The report of a made-up run: complete, self-contained, honest about what is missing, the same each time."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import matplotlib.image
import numpy as np
import pandas as pd
import pytest
from helpers.sample_run import LEVELS, write_run

from twinbench.bench.report.figures.latency import pareto
from twinbench.bench.report.main_table import comparison
from twinbench.bench.report.table_formats import to_text
from twinbench.bench.report.tables import cost_table
from twinbench.bench.report.write import write_report
from twinbench.bench.results import load_results
from twinbench.bench.statistics.scores import DEFINITIONS
from twinbench.bench.statistics.summary import summarise
from twinbench.common.errors import BadInput

TABLES = (
    "comparison", "health", "skill", "calibrated", "forecast", "parameters", "following", "coverage", "consistency",
    "ranks", "paired", "regimes", "regimes_calibrated", "single", "latency", "cost",
)  # fmt: skip
FIGURES = (
    "fig3_states", "fig3c_parity", "fig4_parameters", "fig5a_errors", "fig5b_ranks_forecast", "fig5b_ranks_parameters",
    "fig5c_parameter_errors", "coverage", "coverage_regimes", "latency", "fig7c_accuracy_time",
)  # fmt: skip
FAILED = (("pinn_ukf", 0, "fit", "RuntimeError: the loss is <NaN> & gone"),)


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight estimators, ten sequences, all went well."""
    out = write_run(tmp_path_factory.mktemp("full"), seconds=300)
    write_report(out)
    return out


@pytest.fixture(scope="module")
def failed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One of three did not finish, and no latency was measured."""
    levels = {name: LEVELS[name] for name in ("oracle", "nominal_ekf", "pinn_ukf", "deeponet_kalman")}
    out = write_run(tmp_path_factory.mktemp("failed"), levels, 5, failed=FAILED, latency=False, seconds=300)
    write_report(out)
    return out


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One estimator, one sequence."""
    out = write_run(tmp_path_factory.mktemp("alone"), {"gru_kf": 1.0}, 1, seconds=300)
    write_report(out)
    return out


def test_the_cost_table_adds_up_seeds_and_leaves_ablations_out() -> None:
    rows = [("gru_kf", s, "fit", 10.0 + s) for s in range(3)] + [("gru_kf:part", 0, "fit", 99.0)]
    rows.append(("oracle", 0, "fit", np.nan))
    table = cost_table(pd.DataFrame(rows, columns=["estimator", "seed", "stage", "cpu_s"]))
    assert [[cell.text for cell in row] for row in table.rows] == [
        ["Oracle (reference)", "–", "–"],
        ["GRU + KF", "11.0", "33.0"],
    ]
    assert table.notes[-1] == "Together: 0.00917 h of training."


def html(out: Path) -> str:
    return (out / "report.html").read_text(encoding="utf-8")


def test_every_table_in_every_format(full: Path) -> None:
    expected = {f"{name}.{suffix}" for name in TABLES for suffix in ("csv", "md", "tex")}
    assert {p.name for p in (full / "tables").iterdir()} == expected
    for name in TABLES[:7]:
        assert (full / "tables" / f"{name}.csv").read_text().count("\n") == 1 + len(LEVELS)
        for suffix in ("md", "tex"):
            text = (full / "tables" / f"{name}.{suffix}").read_text()
            assert all(said in text for said in ("DeepONet-Kalman", "GRU + KF")), name
    for path in (full / "tables").glob("*.tex"):
        assert not re.search(r"(?<!\\)[%_&#](?![ \n]|$)", path.read_text().split("\n", 1)[1].replace(" & ", "")), path


def test_every_figure_in_both_formats(full: Path) -> None:
    assert {p.name for p in (full / "figures").iterdir()} == {f"{n}.{s}" for n in FIGURES for s in ("png", "svg")}
    for name in FIGURES:
        pixels = matplotlib.image.imread(full / "figures" / f"{name}.png")
        assert pixels[..., :3].std() > 0.01, f"{name} is blank"
        assert f'id="{name}"' in html(full)


@pytest.mark.parametrize("run", ["full", "failed", "alone"])
def test_the_report_needs_nothing_but_itself(run: str, request: pytest.FixtureRequest) -> None:
    page = html(request.getfixturevalue(run))
    assert not re.search(r"<(script|link|img|iframe|object|embed)\b", page)
    assert not re.search(r"@import|\bsrc=", page)
    for target in re.findall(r"""(?:href|url)\s*[=(]\s*["']?([^"')>]+)""", page):
        assert target.startswith(("#", "data:image/")), target
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r"""(?:href="|url\()#([^")]+)""", page)) <= set(ids)


def test_the_report_says_what_its_numbers_are(full: Path) -> None:
    page = html(full)
    for metric in ("p_nrmse_pct", "parameter_error_pct", "coverage95_pct", "delay_s"):
        assert DEFINITIONS[metric].replace("'", "&#39;") in page, metric
    assert "× is the multiple of the reference" in page
    assert "Resolution floor of 10 sequences and 6 estimators" in page
    assert "None: every cell of this run finished." in page
    for said in ("twinbench run --profile quick", "0123abc", "some &lt;processor&gt;"):
        assert said in page


def test_a_failed_cell_is_in_report_and_tables(failed: Path) -> None:
    page = html(failed)
    assert page.count("the loss is &lt;NaN&gt; &amp; gone") >= 2, "among the failures and in the notes"
    assert "None: every cell" not in page
    comparison = (failed / "tables" / "comparison.md").read_text()
    assert "| PINN + UKF | failed | failed |" in comparison
    assert "Failed: pinn_ukf: seed 0, fit: RuntimeError: the loss is <NaN> & gone." in comparison
    assert "No latency was measured in this run." in (failed / "tables" / "latency.md").read_text()
    assert "Not drawn: no latency was measured in this run." in page
    assert not (failed / "figures" / "latency.png").exists()


def test_a_cell_that_only_could_not_be_timed_keeps_its_rank(tmp_path: Path) -> None:
    out = write_run(tmp_path, {"oracle": 1.0, "gru_kf": 2.0, "deeponet": 3.0}, 3, seconds=300)
    with open(out / "failures.csv", "a") as file:
        file.write("deeponet,0,latency,ValueError: one machine is too few\n")
    results = load_results(out)
    assert results.failures == {}
    assert results.failed_cells["stage"].tolist() == ["latency"]


def test_one_estimator_on_one_sequence_compares_nothing_and_says_so(alone: Path) -> None:
    page = html(alone)
    assert "Nothing to compare: fewer than two estimators finished on two sequences" in page
    assert "Not drawn:" in page
    assert not (alone / "figures" / "fig5b_ranks_parameters.png").exists()
    assert (alone / "tables" / "comparison.csv").read_text().count("\n") == 2


def test_a_run_of_the_prior_alone_has_its_report(tmp_path: Path) -> None:
    write_report(write_run(tmp_path, {"always_prior": 1.0}, 2, seconds=300))
    assert "Always at the prior" in html(tmp_path)
    assert "Nothing to compare" in html(tmp_path)


def test_drawn_again_it_is_the_same_to_the_byte_and_stale_figures_go(failed: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(failed, out)
    (out / "figures" / "latency.png").write_bytes(b"of an earlier run")
    write_report(out)
    files = [p.relative_to(failed) for p in failed.rglob("*") if p.is_file()]
    assert [p.relative_to(out) for p in out.rglob("*") if p.is_file() and p.relative_to(out) not in files] == []
    for path in files:
        assert (out / path).read_bytes() == (failed / path).read_bytes(), path


def test_the_terminal_table_fits_its_terminal(full: Path) -> None:
    results = load_results(full)
    table = comparison(summarise(results.scores, results.failures), "quick", results.latency, results.cost)
    assert to_text(table).startswith("Profile quick")
    for width in (60, 80, 200):
        lines = to_text(table, width).splitlines()
        assert max(map(len, lines)) <= width
        assert any("DeepONet-Kalman" in line for line in lines)


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("manifest.json", "{", "not JSON"),
        ("scores.csv", "", "not a table"),
        ("scores.csv", "a,b\n1,2\n", "no column 'estimator'"),
        ("failures.csv", None, "No such file or directory"),
    ],
)
def test_a_damaged_run_is_one_line(failed: Path, tmp_path: Path, name: str, content: str | None, says: str) -> None:
    out = tmp_path / "out"
    shutil.copytree(failed, out)
    (out / name).unlink()
    if content is not None:
        (out / name).write_text(content)
    with pytest.raises(BadInput, match=says) as caught:
        write_report(out)
    assert str(out / name) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_browser_shows_it(full: Path, tmp_path: Path) -> None:
    names = ("chromium", "chromium-browser", "google-chrome")
    browser = next((path for path in map(shutil.which, names) if path), None)
    if browser is None:
        pytest.skip(f"no browser: none of {', '.join(names)}")
    shot = tmp_path / "shot.png"
    subprocess.run(
        [
            browser,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            "--window-size=1200,2400",
            f"--user-data-dir={tmp_path / 'profile'}",
            f"--screenshot={shot}",
            (full / "report.html").as_uri(),
        ],
        check=True,
        capture_output=True,
        timeout=120,
    )
    pixels = matplotlib.image.imread(shot)[..., :3]
    assert pixels.shape == (2400, 1200, 3)
    # Text and figures all the way down: ink in every band of 400 pixels, and more than one colour.
    for band in np.split(pixels, 6):
        assert 0.003 < (band < 0.6).any(axis=-1).mean() < 0.5
    assert (np.ptp(pixels, axis=-1) > 0.3).mean() > 1e-4


def test_the_front_holds_whom_nobody_beats_in_both() -> None:
    points = {"a": (1.0, 5.0), "b": (2.0, 6.0), "c": (3.0, 2.0), "d": (4.0, 2.0), "e": (9.0, 1.0)}
    assert pareto(points) == ["a", "c", "e"]
