"""Scores, runs and reports of machines that are not the compressor, and several of them side by side."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.refusals import refused
from helpers.sample_run import LEVELS, write_run
from helpers.tiny_run import parts, twinbench, write_profile
from matplotlib.text import Text
from scipy.stats import rankdata

from twinbench.bench.estimates import Estimates
from twinbench.bench.profile import load_profile
from twinbench.bench.report.across import read_runs, write_across
from twinbench.bench.report.evidence import gather
from twinbench.bench.report.figures import draw_any
from twinbench.bench.report.robustness_tables import robustness_tables
from twinbench.bench.report.tables import regime_table
from twinbench.bench.robustness import COLUMNS
from twinbench.bench.roster import UNRANKED, WITHOUT_EQUATIONS
from twinbench.bench.statistics.across import is_ahead
from twinbench.bench.statistics.regimes import regimes_of
from twinbench.bench.statistics.scores import metrics_of, score
from twinbench.bench.statistics.subject import PAPERS, Subject, subject_of
from twinbench.bench.statistics.summary import summarise
from twinbench.data.batch import Batch, Truth
from twinbench.data.disturb import conditions
from twinbench.machines.motor import MOTOR
from twinbench.machines.two_tanks import TWO_TANKS

pytestmark = pytest.mark.usefixtures("in_this_process")

TICKS, EVERY = 12_000, 20
ROOT = Path(__file__).parents[2]
NAMES = ("always_prior", "last_value", "oracle")


def motor_truth() -> Batch:
    """Ten minutes of a motor that nobody simulated: a sine in each state, health that rests."""
    time_s = MOTOR.sample_period_s * np.arange(TICKS)
    wave = np.sin(2 * np.pi * time_s / 37.0)
    states = np.stack([40 + 5 * wave, 120 + 20 * wave, 335 + 2 * wave, 335 + wave, 315 + 0 * wave], axis=-1)[None]
    health = np.tile([0.9, 1.1, 1.5, 0.9, 1.0], (1, TICKS, 1))
    outputs = np.stack([states[..., 1], states[..., 0] + 1.0, states[..., 3]], axis=-1)
    inputs = np.tile([150.0, 30.0], (1, TICKS, 1))
    truth = Truth(states, health, outputs, inputs, machine=MOTOR)
    return Batch(("test-00",), time_s, np.full((1, TICKS, 5), np.nan), truth, MOTOR)


def estimates_of(truth: Batch, error: np.ndarray) -> Estimates:
    """Truth and an error, with intervals of one unit on either side."""
    assert truth.truth is not None
    mean = truth.truth.estimated[:, ::EVERY] + error
    origins, leads = np.arange(60.0, 500.0, 60.0), np.array([1.0, 10.0, 60.0])
    rows = np.rint((origins[:, None] + leads) / MOTOR.sample_period_s).astype(int)
    shape, n = mean.shape[:2], mean.shape[2]
    return Estimates(
        "wrong",
        0,
        truth.names,
        truth.time_s[::EVERY],
        mean.astype(np.float32),
        (mean - 1.0).astype(np.float32),
        (mean + 1.0).astype(np.float32),
        np.ones(shape, np.float32),
        np.full(shape, 3, np.int8),
        np.zeros(shape, np.int16),
        origins,
        leads,
        truth.truth.outputs[:, rows] + np.array([3.0, 0.0, 0.0]),
        truth.truth.estimated[:, np.rint(origins / MOTOR.sample_period_s).astype(int)],
        np.broadcast_to(np.eye(n), (1, len(origins), n, n)).copy(),
        np.full(n, np.nan),
    )


def test_a_motors_scores_are_what_a_hand_reckons() -> None:
    truth = motor_truth()
    assert truth.truth is not None
    error = np.zeros((1, TICKS // EVERY, 8))
    # Current and winding off by a constant, speed by a sign that alternates, flux by 0.03 of a life of 0.15.
    error[..., 0], error[..., 1], error[..., 2], error[..., 3] = 2.0, 6.0, 1.55, 0.03
    error[:, ::2, 1] *= -1.0
    table = score(estimates_of(truth, error), truth).set_index("metric")["value"]
    assert set(metrics_of(subject_of(MOTOR))) <= set(table.index)
    ranked = truth.truth.estimated[0, ::EVERY][truth.time_s[::EVERY] >= 120.0]
    current, speed, winding = ranked[:, 0], ranked[:, 1], ranked[:, 2]
    assert table["i_nrmse_pct"] == pytest.approx(100 * 2.0 / current.mean(), rel=1e-5)
    assert table["w_nrmse_pct"] == pytest.approx(100 * 6.0 / speed.mean(), rel=1e-5)
    assert table["T_nrmse_pct"] == pytest.approx(100 * 1.55 / (winding - 273.15).mean(), rel=1e-4)
    assert table["i_mape_pct"] == pytest.approx(100 * np.mean(2.0 / current), rel=1e-5)
    begin_s = 0.2 * truth.time_s[::EVERY][-1]  # a fifth of the recording is commissioning
    read = truth.truth.outputs[0, truth.time_s >= begin_s, 0].mean()
    assert table["w_open60_pct"] == pytest.approx(100 * 3.0 / read, rel=1e-5)
    assert table["flux_life_pct"] == pytest.approx(100 * 0.03 / 0.15, rel=1e-4)
    assert table["coverage_current_A_pct"] == 0.0
    assert table["coverage_flux_pct"] == 100.0


def test_a_motors_figures_and_regimes_are_of_its_own_quantities() -> None:
    truth = motor_truth()
    assert truth.truth is not None
    truth.truth.health[:, 6000:, 2] = 2.5  # drag grows
    error = np.full((1, TICKS // EVERY, 8), 0.5)
    estimates = estimates_of(truth, error)
    evidence = gather([estimates], truth, {})
    assert list(evidence.degradations) == ["drag"]
    known = regimes_of(MOTOR)
    assert set(evidence.coverage["regime"]) <= set(known)
    assert known["voltage_V_low"] == "lowest third of armature voltage"
    table = regime_table(evidence.coverage, known)
    assert ("voltage_V", "low") in {(column.group, column.head) for column in table.columns}
    scores = score(estimates, truth).assign(estimator="wrong", seed=0)
    summary = summarise(scores, {}, subject=subject_of(MOTOR))
    drawn = {d.name: d.figure for d in draw_any(summary, evidence, pd.DataFrame())}
    assert {name for name, figure in drawn.items() if figure is not None} == {
        "fig5a_errors", "fig4_parameters", "coverage", "coverage_regimes"
    }  # fmt: skip
    said = {text.get_text() for figure in drawn.values() if figure for text in figure.findobj(Text)}
    assert "shaft speed" in said
    assert any(text.startswith("multiplier of the viscous") for text in said)


def test_a_size_is_what_errors_are_a_share_of() -> None:
    truth = motor_truth()
    readings = (replace(MOTOR.readings[0], size=200.0), *MOTOR.readings[1:])
    machine = replace(MOTOR, readings=readings)
    error = np.zeros((1, TICKS // EVERY, 8))
    error[..., 1] = 6.0
    table = score(estimates_of(truth, error), replace(truth, machine=machine)).set_index("metric")["value"]
    assert table["w_nrmse_pct"] == pytest.approx(3.0, rel=1e-4)
    assert table["w_open10_pct"] == pytest.approx(1.5, rel=1e-4)


@pytest.mark.parametrize("machine", [TWO_TANKS, MOTOR], ids=lambda m: m.name)
def test_a_manifest_says_all_that_a_report_needs(machine) -> None:
    said = json.loads(json.dumps(subject_of(machine).to_json()))
    assert Subject.from_json(said) == subject_of(machine)


@pytest.mark.parametrize("name", ["two_tanks", "motor"])
def test_the_other_machines_profiles_are_of_them(name: str) -> None:
    profile = load_profile(name)
    assert (profile.machine, profile.seeds, profile.scenes) == (name, (0, 1, 2), False)
    assert (profile.data.n_train, profile.data.n_validation, profile.data.n_test) == (12, 10, 20)


@pytest.mark.parametrize("machine", [TWO_TANKS, MOTOR], ids=lambda m: m.name)
def test_harder_conditions_have_tables_of_the_machines_own_sensors(machine) -> None:
    subject = subject_of(machine)
    tried = [("fault", "none"), *((c.group, c.name) for c in conditions(machine))]
    metrics = (*subject.state_errors, "health_life_pct", "health_after_fault_pct")
    rows = [("oracle", 0, g, c, f"s{i}", m, 1.0 + 0.1 * i) for g, c in tried for m in metrics for i in range(3)]
    tables = {t.name: t for t in robustness_tables(pd.DataFrame(rows, columns=COLUMNS), subject)}
    assert list(tables) == [
        "harder",
        "faults",
        *(f"noise_{o.key}" for o in subject.outputs),
        "noise_health",
        "fault_kinds",
    ]
    assert len(tables["harder"].rows) == 1 + sum(c.group == "pace" for c in conditions(machine))
    labels = [row[0].text for row in tables["faults"].rows]
    assert f"stuck: {machine.label(machine.outputs[0])}" in labels
    assert len(labels) == 1 + sum(c.group == "fault" for c in conditions(machine))


def of_machine(out: Path, name: str, levels: dict[str, float] = LEVELS, sequences: int = 10) -> Path:
    """A made-up run, on a machine of another name."""
    out.mkdir()
    write_run(out, levels, sequences=sequences)
    manifest = json.loads((out / "manifest.json").read_text())
    manifest["subject"] = PAPERS.to_json() | {"machine": name}
    (out / "manifest.json").write_text(json.dumps(manifest))
    return out


@pytest.fixture(scope="module")
def two_runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """On two machines; the proposed method is the best on the first, and the worst on the second."""
    folder = tmp_path_factory.mktemp("runs")
    worst = LEVELS | {"deeponet_kalman": 6.0}
    return [of_machine(folder / "one", "one"), of_machine(folder / "other", "other", worst, sequences=12)]


def test_runs_on_machines_stand_side_by_side(two_runs: list[Path], tmp_path: Path) -> None:
    table = write_across(two_runs, tmp_path / "out").frame.set_index("estimator")
    runs = read_runs(two_runs)
    for name, run in runs.items():
        skill = run.summary.skill("gru_kf", "health_life_pct")
        assert tuple(table.loc["gru_kf", [f"skill_{name}{e}" for e in ("", "_low", "_high")]]) == skill[:3]
        times = [run.summary.value("gru_kf", m).times for m in PAPERS.state_errors]
        assert table.loc["gru_kf", f"state_times_{name}"] == np.median(times)
    ranked = [e for e in LEVELS if e not in UNRANKED]
    # Each machine's recordings are ranked by themselves. Those of one name have the same wear, so they count once.
    by_name: dict[str, list[np.ndarray]] = {}
    for run in runs.values():
        scores = run.summary.by_sequence["health_life_pct"]
        of_one = np.stack([scores.row(e) for e in ranked]).argsort(axis=0).argsort(axis=0) + 1.0
        for name, ranks in zip(scores.sequences, of_one.T, strict=True):
            by_name.setdefault(name, []).append(ranks)
    assert len(by_name) == 12
    together = np.mean([rankdata(np.mean(ranks, axis=0)) for ranks in by_name.values()], axis=0)
    assert table.loc[ranked, "mean_rank"].to_numpy() == pytest.approx(together)
    assert np.isnan(table.loc[["oracle", "always_prior"], "mean_rank"]).all()
    assert table.loc["deeponet_kalman", "machines_ahead"] == 1
    assert table.loc["lstm_rls", "machines_ahead"] == 0
    assert table.loc["deeponet_kalman", "machines_tested"] == 2
    assert table.loc["deeponet_kalman", "machines_states_tested"] == 2
    assert set(WITHOUT_EQUATIONS) & set(ranked) == {"gru_kf", "lstm_rls", "deeponet", "pinn_ukf", "deeponet_kalman"}


def test_the_page_over_machines_says_where_each_run_is_from(two_runs: list[Path], tmp_path: Path) -> None:
    assert twinbench("machines", *two_runs, "--out", tmp_path / "out") == 0
    page = (tmp_path / "out" / "machines.md").read_text()
    assert "Friedman's test over 12 names of recordings" in page
    for folder in two_runs:
        assert str(folder) in page
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert {name: run["commit"] for name, run in manifest["runs"].items()} == {"one": "0123abc", "other": "0123abc"}
    assert (tmp_path / "out" / "machines.csv").is_file()


def test_ahead_in_the_states_is_ahead_in_every_one(two_runs: list[Path], tmp_path: Path) -> None:
    far = of_machine(tmp_path / "far", "far", LEVELS | {"deeponet_kalman": 0.2}, sequences=14)
    summary = read_runs([far, two_runs[1]])["far"].summary
    assert is_ahead(summary, "deeponet_kalman", PAPERS.state_errors) is True
    assert is_ahead(summary, "lstm_rls", PAPERS.state_errors) is False
    assert is_ahead(summary, "oracle", PAPERS.state_errors) is None


def test_the_page_says_whom_it_is_not_ahead_of_and_whether_the_reference_is(
    two_runs: list[Path], tmp_path: Path
) -> None:
    far = of_machine(tmp_path / "far", "far", LEVELS | {"deeponet_kalman": 0.2}, sequences=14)
    notes = write_across([far, two_runs[1]], tmp_path / "out").notes
    said = [note for note in notes if note.startswith("other, filtered ")]
    assert len(said) == len(PAPERS.outputs)
    rivals = "GRU + KF, LSTM + RLS, DeepONet and PINN + UKF"
    assert all(f"DeepONet-Kalman is not shown to be ahead of {rivals}." in note for note in said)
    assert all(note.endswith("The reference, which knows the plant, is ahead of them.") for note in said)
    assert not any(note.startswith("far, filtered ") for note in notes)


def test_who_lacks_a_machine_has_no_rank(two_runs: list[Path], tmp_path: Path) -> None:
    few = of_machine(tmp_path / "few", "few", {e: v for e, v in LEVELS.items() if e != "gru_kf"})
    table = write_across([two_runs[0], few], tmp_path / "out")
    assert np.isnan(table.frame.set_index("estimator").loc["gru_kf", "mean_rank"])
    assert "GRU + KF is not ranked: no complete scores on few." in table.notes


def test_runs_that_cannot_be_set_side_by_side_are_refused(two_runs, tmp_path, capsys) -> None:
    out = tmp_path / "out"
    assert "two runs or more" in refused(tmp_path, capsys, "machines", two_runs[0], "--out", out)
    assert "both of 'one'" in refused(tmp_path, capsys, "machines", two_runs[0], two_runs[0], "--out", out)
    assert "holds no run" in refused(tmp_path, capsys, "machines", two_runs[0], tmp_path, "--out", out)
    assert not out.exists()


@pytest.mark.parametrize("spec", ["nosuch", "gone.py", "gone.py:MACHINE"])
def test_a_machine_that_is_none_is_refused_in_one_line(spec: str, tmp_path: Path, capsys) -> None:
    profile = write_profile(tmp_path)
    for command in (("run", "--out", tmp_path / "out", "--only", "last_value"), ("tune", "gru_kf")):
        assert spec.partition(":")[0] in refused(tmp_path, capsys, *command, "--profile", profile, "--machine", spec)
    assert not (tmp_path / "out").exists()


def test_two_tanks_from_recordings_to_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    profile, out = write_profile(tmp_path, updates=3), tmp_path / "out"
    arguments = ("run", "--machine", "two_tanks", "--profile", profile, "--out", out, "--only", *NAMES)
    assert twinbench(*arguments) == 0
    scores = pd.read_csv(out / "scores.csv")
    assert set(NAMES) < set(scores["estimator"])
    assert scores["sequence"].nunique() == 3  # none is of the paper's kind
    assert {f"{r.key}_nrmse_pct" for r in TWO_TANKS.readings} <= set(scores["metric"])
    manifest = json.loads((out / "manifest.json").read_text())
    assert Subject.from_json(manifest["subject"]) == subject_of(TWO_TANKS)
    assert not (out / "paper_says.md").exists()
    before, table = parts(out), (out / "tables" / "comparison.csv").read_bytes()
    assert twinbench(*arguments) == 0
    kept = {part: when for part, when in parts(out).items() if "/latency/" not in part}
    assert kept == {part: when for part, when in before.items() if part in kept}, "only times are taken again"
    assert len(kept) == 7
    capsys.readouterr()
    assert twinbench("report", out) == 0
    assert (out / "tables" / "comparison.csv").read_bytes() == table
    page = (out / "report.html").read_text()
    assert TWO_TANKS.says in page
    assert "compressor" not in page.partition("provenance")[0]
    regimes, curves = out / "tables" / "regimes.csv", out / "figures" / "fig4_parameters.png"
    stood = regimes.read_text().splitlines(), curves.exists() and curves.read_bytes()
    for key in manifest["made"]["oracle"]["estimates"]:
        shutil.rmtree(out / "store" / "estimate" / key)
    assert twinbench("report", out) == 0
    assert sorted(regimes.read_text().splitlines()) == sorted(stood[0]), "whose estimates are gone keeps its rows"
    assert (curves.exists() and curves.read_bytes()) == stood[1], "a figure of all is not drawn of some"


@pytest.fixture(scope="module")
def own_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a machine in a file, a tiny profile, a run of it and recordings."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "mine.py").write_text(
        (ROOT / "examples" / "own_machine.py").read_text(encoding="utf-8"), encoding="utf-8"
    )
    here = ("--machine", folder / "mine.py", "--profile", write_profile(folder, updates=3))
    assert twinbench("run", *here, "--out", folder / "out", "--only", "always_prior", "last_value") == 0
    assert twinbench("simulate", *here, "--no-truth", "--out", folder / "days") == 0
    return folder


def test_a_machine_in_a_file_goes_through_the_commands(own_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine, profile = ("--machine", own_run / "mine.py"), ("--profile", own_run / "tiny.toml")
    trained, day = (*machine, *profile, "--results", own_run / "out"), own_run / "days" / "test-00.csv"
    assert twinbench("estimate", "last_value", day, *trained, "--force", "--out", own_run / "estimates") == 3
    assert "heat loss to the room, W/K" in capsys.readouterr().out
    kept = own_run / "kept.npz"
    assert twinbench("record", "last_value", day, *trained, "--out", kept) == 0
    assert twinbench("replay", kept, *machine) == 0
    assert "equal to the bit" in capsys.readouterr().out


@pytest.mark.slow
def test_settings_are_chosen_and_updates_timed_on_a_machine_in_a_file(own_run: Path) -> None:
    here = ("--machine", own_run / "mine.py", "--profile", own_run / "tiny.toml")
    assert twinbench("run", *here, "--out", own_run / "out", "--only", "nominal_ekf") == 0
    assert twinbench("tune", "nominal_ekf", *here, "--trials", "2", "--jobs", "1", "--out", own_run / "tuned") == 0
    assert (own_run / "tuned" / "nominal_ekf.toml").is_file()
    timed = ("--results", own_run / "out", "--updates", "20", "--ticks", "4", "--out", own_run / "times")
    assert twinbench("latency", "--estimator", "nominal_ekf", *here, *timed) == 0
    assert "nominal_ekf" in set(pd.read_csv(own_run / "times" / "latency.csv")["estimator"])
