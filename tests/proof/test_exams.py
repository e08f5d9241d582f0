"""Exams that others set: the likelihood against closed forms, answers that can be wrong, and bad input in one line."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from twinbench.common.errors import BadInput
from twinbench.physics.compile import compiled
from twinbench.proof.exams import causal_chambers, petab_select
from twinbench.proof.exams.__main__ import ROOT, main
from twinbench.proof.exams.exam import Answer, Asked, Paper, exams, to_markdown, to_table
from twinbench.proof.exams.likelihood import Likelihood
from twinbench.proof.exams.petab_select import CASES
from twinbench.proof.exams.sbml import conserved, simulator_of

RESULTS = ROOT / "results" / "exams"
TRUE = {"k1": 0.2, "k2": 0.1, "k3": 0.0}


def quiet(share: float) -> None:
    """Nobody is told."""


def test_every_exam_is_found_and_listed(capsys):
    assert set(exams()) == {"causal_chambers", "petab_select"}
    assert main([]) == 0
    said = capsys.readouterr().out
    assert all(f"{name}: " in said for name in exams())


def test_a_networks_likelihood_is_that_of_its_closed_form():
    """Without the third reaction x1 settles exponentially, and x2 gets what has flowed in less what x1 holds."""
    problem = Likelihood(CASES / "0007" / "petab" / "petab_problem.yaml")
    table = pd.read_csv(CASES / "0007" / "petab" / "measurements.tsv", sep="\t")
    time_s, read = table["time"].to_numpy(), table["measurement"].to_numpy()

    def nllh(k1: float, k2: float) -> float:
        x2 = k1 * time_s - k1 / k2 * (1.0 - np.exp(-k2 * time_s))
        return 0.5 * len(read) * np.log(2.0 * np.pi) + 0.5 * float(np.sum((read - x2) ** 2))

    assert problem.fit([], TRUE, {}, 0, 0).nllh == pytest.approx(nllh(0.2, 0.1), abs=1e-8)
    fitted = problem.fit(["k1"], {"k2": 0.1, "k3": 0.0}, {"k1": 0.5}, 0, 0)
    least = nllh(fitted.values["k1"], 0.1)
    assert fitted.nllh == pytest.approx(least, abs=1e-8)
    assert least < min(nllh(fitted.values["k1"] + step, 0.1) for step in (-1e-4, 1e-4))


def test_a_network_at_rest_is_where_a_long_run_ends():
    names = ("x_0ac", "x_k08", "x_4ac")
    simulator = simulator_of(CASES / "0009" / "petab" / "model.xml", {name: name for name in names})
    problem = Likelihood(CASES / "0009" / "petab" / "petab_problem.yaml")
    theta = np.random.default_rng(3).uniform(0.2, 3.0, len(simulator.parameters))
    rhs, none = compiled(simulator).rhs, np.empty(0)
    start = simulator.initial(none, none, theta)
    (row,) = conserved(simulator)
    assert np.ptp(row) < 1e-9, "the sum of all species is all that the network keeps"
    long = solve_ivp(lambda t, x: rhs(x, none, theta), (0.0, 200.0), start, "LSODA", rtol=1e-10, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(problem.steady(theta), long, atol=1e-8)


def test_a_problem_is_answered_and_a_wrong_answer_is_marked(monkeypatch):
    (answer,) = petab_select.sit(Asked(only=("0006",)), quiet).answers
    assert answer.right
    assert answer.ours.startswith("M1_0-000, AIC -6.17540")
    other = {**petab_select.expected("0001"), "model_hash": "M1_7-000"}
    monkeypatch.setattr(petab_select, "expected", lambda number: other)
    assert not petab_select.sit(Asked(only=("0001",)), quiet).answers[0].right


def test_the_quadratic_drag_of_a_fan_is_named():
    paper = causal_chambers.sit(Asked(only=("fan with linear drag",)), quiet)
    assert [answer.right for answer in paper.answers] == [True]
    assert paper.answers[0].ours == "quadratic_friction@omega_in_rad_s"


def test_a_hatch_that_the_catalogue_lacks_leaves_a_pressure_unexplained():
    paper = causal_chambers.sit(Asked(only=("impedance, our catalogue alone",)), quiet)
    assert [answer.right for answer in paper.answers] == [True]
    assert paper.answers[0].note == "verdict: unexplained; right is unexplained"


def test_what_is_simulated_reads_as_the_authors_files_do(tmp_path):
    rung = causal_chambers.RUNGS["pressure law"]
    causal_chambers.write_experiment(tmp_path / "steps.csv", rung.upper, (0, 1))
    table = pd.read_csv(tmp_path / "steps.csv")
    assert {"timestamp", "load_in", "hatch", "rpm_out", "pressure_downwind", "pressure_ambient"} <= set(table)
    recording = causal_chambers.read_experiment(tmp_path / "steps.csv", rung.lower)
    assert recording.channels == ("load_in", "load_out", "hatch", "rpm_in", "rpm_out", "rise_Pa")
    rise = recording.values[:, -1]
    np.testing.assert_allclose(rise, table["pressure_downwind"] - table["pressure_ambient"])
    speed, other = table["rpm_in"] / 3000.0, table["rpm_out"] / 3000.0
    np.testing.assert_allclose(rise, 0.25 * 74.82 * (speed**2 - other**2), atol=2.0)
    table.drop(columns="pressure_ambient").to_csv(tmp_path / "steps.csv", index=False)
    with pytest.raises(BadInput, match="lacks the column pressure_ambient"):
        causal_chambers.read_experiment(tmp_path / "steps.csv", rung.lower)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["geometry"], "no exam 'geometry'; there are: causal_chambers, petab_select"),
        (["petab_select", "--only", "0010"], "exam petab_select has no question '0010'; it has: 0001, 0002"),
        (["causal_chambers", "--data", "nowhere"], "nowhere/steps.csv: cannot be read"),
    ],
)
def test_what_cannot_be_sat_is_told_in_one_line(tmp_path, capsys, arguments, says):
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert said[-1].startswith("twinbench.proof.exams: ")
    assert says in said[-1]
    assert not list(tmp_path.rglob("*.csv"))


def test_a_file_that_is_no_network_is_told_in_one_line(tmp_path):
    (tmp_path / "model.xml").write_text("<sbml>")
    with pytest.raises(BadInput, match="libSBML cannot read it"):
        simulator_of(tmp_path / "model.xml", {})
    with pytest.raises(BadInput, match="no such file"):
        simulator_of(tmp_path / "none.xml", {})


def test_the_table_counts_what_is_right():
    table = to_table("one", Paper([Answer("a", "x", "x", True), Answer("b", "x", "y", False)], {}))
    assert to_markdown(table).endswith("| one | b | x | y | no |  |\n\nRight: 1 of 2.\n")


@pytest.mark.parametrize(
    ("name", "least"),
    [("causal_chambers", tuple(causal_chambers.RUNGS)), ("petab_select", petab_select.PROBLEMS)],
)
def test_committed_answers_are_whole_and_shown(name, least):
    table = pd.read_csv(RESULTS / name / "answers.csv", keep_default_na=False, dtype={"question": str})
    assert set(least) <= set(table["question"]) <= set(exams()[name].questions)
    assert (RESULTS / name / "answers.md").read_text(encoding="utf-8") == to_markdown(table)
    command = json.loads((RESULTS / name / "manifest.json").read_text())["command"]
    assert command.startswith(f"python -m twinbench.proof.exams {name} --seed 0")


def test_every_problem_of_petab_select_is_answered_as_expected():
    table = pd.read_csv(RESULTS / "petab_select" / "answers.csv", dtype={"question": str}).set_index("question")
    assert table["right"].all()
    for number in petab_select.PROBLEMS:
        assert petab_select.expected(number)["model_hash"] in table.loc[number, "ours"]
