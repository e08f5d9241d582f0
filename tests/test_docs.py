"""What the documentation shows is run: the example estimator, and every command line."""

from __future__ import annotations

import json
import re
import shlex
import tomllib

import numpy as np
import pandas as pd
import pytest
from helpers.prose import PAGES, READ, ROOT, sentences
from scipy.stats import fisher_exact

from twinbench.bench.cli.main import build_parser
from twinbench.bench.contract import run_battery
from twinbench.bench.contract.subject import small_benchmark
from twinbench.bench.registry import discover, find
from twinbench.bench.report.table_formats import number
from twinbench.bench.roster import TRIVIAL
from twinbench.machines.compressor import OUTPUTS
from twinbench.physics.compressor import PLANT
from twinbench.physics.integrate import simulate
from twinbench.physics.nominal import NOMINAL
from twinbench.physics.steady import steady_state
from twinbench.proof.concealed.findings import read_cases, with_marks
from twinbench.proof.flagship.gates import WHOLE, read_draws
from twinbench.proof.flagship.judge import ABSTAINS

LONGEST_WORDS = 35
"""A sentence of a page has at most as many: longer ones cannot be read aloud."""


def example() -> str:
    """The first Python block of the page on adding a baseline."""
    block = re.search(r"```python\n(.*?)```", (ROOT / "docs/add_your_baseline.md").read_text(), re.DOTALL)
    assert block is not None
    return block[1]


def commands() -> list[str]:
    """Every twinbench command line: lines of shell blocks, and code within sentences."""
    found = []
    for page in PAGES:
        blocks = re.findall(r"```(?:sh|bash|console)\n(.*?)```", page.read_text(), re.DOTALL)
        lines = [line.removeprefix("$ ").strip() for block in blocks for line in block.splitlines()]
        prose = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
        lines += re.findall(r"`(twinbench [^`]+)`", prose)
        found += [line for line in lines if line.startswith("twinbench ")]
    return sorted(set(found))


def test_one_number_for_one_thing():
    """Times and sizes have one source, whichever page or table says them."""
    suite = pd.read_csv(ROOT / "results/latency/latency.csv").query("mode == 'back_to_back'")
    run = pd.read_csv(ROOT / "results/paper/latency.csv")
    key = ["estimator", "implementation", "window"]
    both = run.merge(suite, on=key, suffixes=("", "_suite"))
    assert len(both) == len(run)
    for column in ("p50_us", "p95_us", "p99_us", "max_us"):
        assert (both[column] == both[f"{column}_suite"]).all()
    ours = both.query("estimator == 'deeponet_kalman' and implementation == 'in place'")
    claims = pd.read_csv(ROOT / "results/paper/tables/claims.csv").set_index("says")["ours"]
    ranks = pd.read_csv(ROOT / "results/paper/tables/ranks.csv").set_index("estimator").loc["deeponet_kalman"]
    p50_us, memory_kB = ours[["p50_us", "memory_kB"]].iloc[0] if len(ours) else (np.nan, np.nan)
    assert claims["Fig. 7a, median update"] == pytest.approx(p50_us / 1e3, nan_ok=True)
    assert claims["weights, tensors and buffers"] == pytest.approx(memory_kB / 1e3, nan_ok=True)
    assert (ranks["latency_p50_us"], ranks["memory_kB"]) == pytest.approx((p50_us, memory_kB), nan_ok=True)
    says = f"takes {p50_us:.0f} µs on one core and {memory_kB:.0f} kB with everything"
    page = words("README.md")
    assert says in page if len(ours) else "DeepONet-Kalman and of the oracle have not been timed since" in page


def test_the_nominal_model_delivers_as_much_too_much_as_the_page_says():
    truth = small_benchmark().train.truth
    assert truth is not None
    flows = []
    for machine in (PLANT, NOMINAL):
        x0 = np.stack([steady_state(machine, row) for row in truth.inputs[:, 0]])
        _, y = simulate(machine, truth.inputs, x0)
        flows.append(y[..., OUTPUTS.index("m_flow_kg_s")].mean())
    assert f"some {100 * (flows[1] / flows[0] - 1):.0f} % too much" in words("docs/plant.md")


def test_the_python_versions_are_those_that_the_package_takes():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    low, high = re.fullmatch(r">=3\.(\d+),<3\.(\d+)", project["requires-python"]).groups()
    *most, last = (f"3.{minor}" for minor in range(int(low), int(high)))
    says = f"{', '.join(most)} or {last}"
    assert f"Python {says}" in words("README.md")
    assert f"Python {says}" in (ROOT / "Makefile").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "folder", ["proof", "proof_256172", "opponents", "flagship", "fuzz", "real_recordings", "grey_box", "sensitivity"]
)
def test_the_list_of_results_names_the_command_that_made_them(folder):
    (row,) = [r for r in (ROOT / "results/README.md").read_text().splitlines() if r.startswith(f"| `{folder}/`")]
    assert json.loads((ROOT / "results" / folder / "manifest.json").read_text())["command"] in row


def test_what_the_pages_say_of_the_proof_is_in_its_rows():
    rows = with_marks(read_cases(ROOT / "results/proof/cases.csv"))
    page, readme = (" ".join((ROOT / p).read_text(encoding="utf-8").split()) for p in ("docs/proof.md", "README.md"))
    seen = rows["detectable"]

    def by_class(*cells):
        mine = rows[rows["cell"].isin(cells) & seen]
        return f"{mine['outcome'].isin(['name', 'class']).sum()} of {len(mine)}"

    names, sets = int(rows["wrong_name"].sum()), int(((rows["outcome"] == "wrong") & ~rows["wrong_name"]).sum())
    sound = rows[rows["cell"].isin(["clean", "parameters", "poor_excitation"])]
    false = int((sound["outcome"] == "false").sum())
    holds, was = ("holds" if names == 1 else "hold"), ("were" if false > 1 else "was")
    others = f"and {_spelt(sets).lower()} of the others a set"
    assert f"{_spelt(names)} of {len(rows)} verdicts {holds} a wrong name, {others}" in page
    assert f"Of the {len(rows)} verdicts {names} {holds} a wrong name" in readme
    assert f"shows {len(rows)} such cases" in readme
    for text in (page, readme):
        assert f"{_spelt(false)} of {len(sound)} sound machines {was} given a name" in text
        assert f"{by_class('mechanism', 'onset')} detectable single effects" in text
        assert f"{by_class('sensor')} faults" in text
        assert f"both effects in {by_class('two_effects')} pairs" in text
    groups = {
        "single effects": ("mechanism", "onset"),
        "faults of sensors and inputs": ("sensor",),
        "both of two effects": ("two_effects",),
    }
    told = {}
    for says, cells in groups.items():
        mine = rows[rows["cell"].isin(cells) & seen]
        by_ripple = mine["outcome"].isin(["name", "class"]).groupby(mine["background_pct"])
        told[says] = [f"{group.sum()} of {len(group)}" for _, group in by_ripple]
        assert f"| {says} | {' | '.join(told[says])} |" in page
    own = int((rows.loc[rows["cell"].isin(["mechanism", "onset"]) & seen, "outcome"] == "name").sum())
    assert f"by name or class, {own} of them by their own name" in page
    assert (
        f"Without a disturbance that no candidate models, it told {told['single effects'][0]} single effects" in readme
    )


def test_what_the_pages_say_of_wrong_names_is_in_the_gates():
    gates = pd.read_csv(ROOT / "results/proof/gates.csv", index_col="gate")
    measured, low, high = 100.0 * gates.loc["confidently wrong, of all verdicts", ["measured", "low", "high"]]
    assert f"a wrong name: {measured:.1f} % (95 % interval {low:.1f} to {high:.1f} %)" in words("README.md")
    most = [
        "sound machine: false name",
        "sound machine: false name or set",
        "confidently wrong, of all verdicts",
        "effects that are certainly not there, named",
        "sensor or input fault called physics",
    ]
    limits = gates.loc[most, "required"].str.removeprefix("<= ").astype(float)
    least = gates.loc["not in the catalogue: no wrong name"]
    assert gates.loc[most, "met"].all()
    assert least["met"]
    within = int((gates.loc[most, "high"] <= limits).sum()) + (least["low"] >= 0.95)
    assert within == 1
    assert "All but one of their intervals reach beyond the limit." in words("docs/proof.md")


def test_what_the_proof_page_says_of_intervals_and_times_is_in_its_rows():
    rows = with_marks(read_cases(ROOT / "results/proof/cases.csv"))
    page = words("docs/proof.md")
    beside = rows[~rows["cell"].isin(["clean", "parameters", "poor_excitation", "sensor"])]
    moved = beside.loc[beside["verdict"] == "parameter change", "parameters_covered"].mean()
    assert f"intervals hold {moved:.2f} of them" in page
    assert f"every effect is named it is {beside.loc[beside['by_class'], 'parameters_covered'].mean():.2f}" in page
    half = rows.groupby("machine")["seconds"].median().round()
    assert half["compressor"] == half["heat_exchanger"] == half.max()
    assert f"take {half.max():.0f} s and more, and the longest case took {rows['seconds'].max():.0f} s" in page


def test_what_the_proof_page_says_of_both_runs_together_is_in_their_rows():
    page = " ".join((ROOT / "docs/proof.md").read_text(encoding="utf-8").split())
    runs = [with_marks(read_cases(ROOT / "results" / run / "cases.csv")) for run in ("proof_256172", "proof")]

    def told(rows, *cells):
        mine = rows[rows["cell"].isin(cells) & rows["detectable"]]
        return f"{mine['by_class'].sum()} of {len(mine)}"

    def counts(rows):
        return told(rows, "mechanism", "onset"), told(rows, "sensor"), told(rows, "two_effects")

    single, faults, pairs = counts(runs[0])
    assert f"told {single} single effects, {faults} faults and both effects in {pairs} pairs" in page
    assert f"with {_spelt(runs[0]['wrong_name'].sum()).lower()} wrong names" in page
    both = pd.concat(runs)
    single, faults, pairs = counts(both)
    assert f"Together that is {single}, {faults} and {pairs}" in page
    assert f"{both['wrong_name'].sum()} wrong names in {len(both)} verdicts" in page
    seen = [rows[rows["detectable"]] for rows in runs]
    pairs = [rows.loc[rows["cell"] == "two_effects", "by_class"] for rows in seen]
    lacking = [rows.loc[rows["cell"].isin(["left_out", "foreign"]), "pointed"] for rows in seen]
    p = [fisher_exact([[int(told.sum()), int((~told).sum())] for told in group]).pvalue for group in (pairs, lacking)]
    assert f"Fisher's exact test, p = {p[0]:.2f} and {p[1]:.2f}" in page


def test_what_the_page_says_of_the_grey_box_is_in_its_rows():
    rows = pd.read_csv(ROOT / "results/grey_box/grey_box.csv", index_col="form")
    page = words("docs/real_recordings.md")
    both, power, all_of_it, dry = (
        rows.loc[name, "held_out_from_200_s_V"]
        for name in (
            "both overflow, a part falls into the lower",
            "both overflow, and the lower drains by another power",
            "both overflow, and both drains have a linear part",
            "both drains have a linear part",
        )
    )
    assert f"If both tanks overflow, the error from 200 s on is {both:.3f} V" in page
    assert f"another power than the square root, it is {power:.3f} V" in page
    assert f"of either sign in both drains it is {all_of_it:.3f} V" in page
    assert f"Without overflow the linear parts do not help ({dry:.3f} V)" in page
    errors = pd.read_csv(ROOT / "results/real_recordings/errors.csv").query(
        "case == 'cascaded_tanks' and from_s == 200"
    )
    assert rows.loc["as the textbook", "held_out_from_200_s_V"] == pytest.approx(errors["rmse_before"].item(), abs=2e-3)


def test_what_the_method_page_says_of_constants_is_in_their_rows():
    rows = pd.read_csv(ROOT / "results/sensitivity/sensitivity.csv")
    usual, changed = rows[rows["factor"] == 1.0], rows[rows["factor"] != 1.0]
    page = words("docs/mismatch_method.md")
    assert f"each of the {changed['constant'].nunique()} constants" in page
    assert f"On {usual['cases'].item()} development cases" in page
    assert f"alters more than {changed['differ'].max()} verdicts" in page
    assert f"Without a change {usual['right'].item()} verdicts are right. No change loses one of them" in page
    assert changed["lost"].max() == usual["wrong"].item() == 0
    assert list(changed.loc[changed["gained"] > 0, "gained"]) == [1, 1]
    assert list(changed.loc[changed["gained"] > 0, "wrong"]) == [1, 0]
    assert changed["wrong"].sum() == 1


def test_what_the_proof_page_says_of_the_opponents_is_in_their_rows():
    rows = with_marks(read_cases(ROOT / "results/opponents/cases.csv"))
    page = " ".join((ROOT / "docs/proof.md").read_text(encoding="utf-8").split())
    asked = json.loads((ROOT / "results/opponents/manifest.json").read_text())
    assert asked["opponent_cases"] == asked["cases"]
    assert f"asked on {asked['cases']} cases of the run before" in page
    by_engine = {name: own.set_index("case") for name, own in rows.groupby("engine")}
    assert {len(own) for own in by_engine.values()} == {asked["cases"]}
    proof = with_marks(read_cases(ROOT / "results/proof_256172/cases.csv")).set_index("case")
    ours = by_engine["twinbench"]
    assert (proof.loc[ours.index, ["named", "set", "outcome"]] == ours[["named", "set", "outcome"]]).all(axis=None)
    for name in (
        "twinbench",
        "threshold_engine",
        "no_learnt_decision",
        "no_discrepancy",
        "no_relinearisation",
        "bic_picker",
    ):
        own = by_engine[name]
        single, faults, pairs = (
            f"{own.loc[mine, 'by_class'].sum()} of {mine.sum()}"
            for cells in (["mechanism", "onset"], ["sensor"], ["two_effects"])
            for mine in [own["detectable"] & own["cell"].isin(cells)]
        )
        says = f"tells {single} single effects, {faults} faults and both effects in {pairs} pairs"
        assert re.search(rf"{says}[^-]*?{_spelt(own['wrong_name'].sum())} verdicts hold a wrong name", page)
    lacking = by_engine["no_learnt_decision"]["cell"].isin(["left_out", "foreign"])
    named = {name: int((own["named"] != "")[lacking].sum()) for name, own in by_engine.items()}
    assert f"Of the {lacking.sum()} effects that the catalogue lacks, {named['no_learnt_decision']} get" in page
    assert f"With the decision it is {_spelt(named['twinbench']).lower()}." in page
    assert (
        f"gives {named['threshold_engine']} of the {lacking.sum()} effects that the catalogue lacks another's" in page
    )
    lacking &= by_engine["no_learnt_decision"]["detectable"]
    at = {name: f"{own.loc[lacking, 'pointed'].sum()} of {lacking.sum()}" for name, own in by_engine.items()}
    assert f"locates {at['no_discrepancy']} detectable effects that the catalogue lacks" in page
    assert f"the whole engine locates {at['twinbench']}" in page
    assert f"another's name. Of the detectable ones it locates {at['threshold_engine']}." in page
    sound = by_engine["bic_picker"]["cell"].isin(["clean", "parameters", "poor_excitation"])
    assert (by_engine["bic_picker"].loc[sound, "named"] != "").all()
    sparse = [own for name, own in by_engine.items() if "sindy" in name]
    wrong = [int(own["wrong_name"].sum()) for own in sparse]
    false = [int((own.loc[sound, "named"] != "").sum()) for own in sparse]
    assert f"a wrong name in {min(wrong)} to {max(wrong)} verdicts" in page
    assert f"on {min(false)} to {max(false)} of the sound machines" in page
    apart = pd.read_csv(ROOT / "results/opponents/paired.csv", index_col="engine")
    for name in ("no_learnt_decision", "no_discrepancy"):
        assert (apart.loc[name, ["told_p", "wrong_p"]] < 0.05).all()
    assert apart.loc["threshold_engine", "wrong_p"] < 0.05 < apart.loc["threshold_engine", "told_p"]
    assert apart.loc["no_relinearisation", "told_p"] < 0.05 < apart.loc["no_relinearisation", "wrong_p"]


def test_what_the_proof_page_says_of_eleven_effects_is_in_their_rows():
    rows = read_draws(ROOT / "results/flagship/draws.csv")
    page = words("docs/proof.md")
    whole = rows[rows["cell"].isin(WHOLE)]

    def several(column):
        return [name for text in whole[column] for name in text.split("+") if name]

    truths, right, missed = several("truth"), several("named_right"), several("missed")
    assert several("named_wrong") == []
    assert f"None of the {len(right)} names is wrong" in page
    assert f"The engine names {len(right)} of {len(truths)} effects" in page
    never = {name for name in truths if missed.count(name) == truths.count(name) == len(whole)}
    assert never == {"preheat_falls_with_flow", "efficiency_with_speed"}
    assert f"named on none of the {len(whole)} plants" in page
    closed = whole["parameter_share"].clip(upper=1.0).mean()
    assert f"On {len(whole)} plants that differ" in words("README.md")
    assert f"mending closes on average {closed:.2f} of the gap in health" in words("README.md")
    assert f"None of the {len(right)} names that it gave is wrong" in words("README.md")
    nominal, left_out = (rows[rows["cell"] == cell] for cell in ("nominal", "left_out"))
    assert (nominal["named_wrong"] == "").all()
    (slow,) = nominal.loc[nominal["verdict"] == "unexplained", "seconds"]
    of = f"One of these {_spelt(len(nominal)).lower()}"
    assert f"{of} is called unexplained, and that took {slow / 60:.0f} minutes" in page
    assert left_out["verdict"].isin(ABSTAINS).all()
    given = sum(len([n for n in text.split("+") if n]) for c in ("named_right", "named_wrong") for text in left_out[c])
    (wrong,) = (text for text in left_out["named_wrong"] if text)
    assert "+" not in wrong
    assert f"out of the catalogue {given} names are given, and one of them is wrong" in page
    assert f"out of the catalogue one of {given} is" in words("README.md")
    assert f"on {whole['verdict'].isin(ABSTAINS).sum()} of the {len(whole)} others too" in page


def _spelt(n: int) -> str:
    return dict(enumerate(["None", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine", "Ten"])).get(
        n, str(n)
    )


def test_what_the_proof_page_says_of_the_rule_is_in_its_file():
    rule = json.loads((ROOT / "mismatch/naming/decision.json").read_text())
    page = " ".join((ROOT / "docs/proof.md").read_text(encoding="utf-8").split())
    known = rule["left_out"]
    assert f"learnt from {known['cases']} cases" in page
    assert f"a probability of {rule['say_name']:.2f}" in page
    assert f"right in {known['right']} of {known['findings']} findings" in page
    right = known["named"] - known["named_wrong"]
    assert f"The rule names {right} of them, and {known['named_wrong']} others wrongly" in page


def test_what_the_proof_page_says_of_periodic_forces_is_in_the_rows_learnt_from():
    page = " ".join((ROOT / "docs/proof.md").read_text(encoding="utf-8").split())
    rows = [json.loads(path.read_text()) for path in (ROOT / "results/learning").glob("*-*.json")]
    found = [f for row in rows for f in row.get("findings", ()) if f["name"].startswith("periodic@")]
    wrong, right = ([bool(f["evidence"]["lingers"]) for f in found if f["right"] == known] for known in (False, True))
    assert not any(right)
    assert f"took {sum(wrong)} of {len(wrong)} wrong ones and none of {len(right)} right ones" in page


def test_the_proof_page_shows_the_earlier_runs_as_they_are_stored():
    page = (ROOT / "docs/proof.md").read_text(encoding="utf-8")
    columns = ["right_name", "right_or_in_set", "both_of_two", "false_name", "confidently_wrong", "abstains"]
    for folder in sorted((ROOT / "results/proof_earlier").iterdir()):
        for _, row in pd.read_csv(folder / "engines.csv").iterrows():
            cells = " | ".join(f"{row[c]:.2f}" for c in columns)
            assert f"| {folder.name} | {row['engine']} | {cells} |" in page


def test_every_picture_on_the_pages_is_there():
    for page in PAGES:
        for target in re.findall(r"!\[[^]]*\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).is_file(), f"{page.name}: {target}"


def test_every_file_that_a_page_names_is_there():
    named = {
        (page, name)
        for page in READ
        if page.name != "CHANGELOG.md"
        for name in re.findall(r"`([\w./-]+/[\w.-]+\.(?:py|toml|md))`", page.read_text(encoding="utf-8"))
    }
    assert len(named) > 20
    assert {(p.name, n) for p, n in named if not (ROOT / n).exists() and not (p.parent / n).exists()} == set()


def words(page):
    """A page's text, its lines joined."""
    return " ".join((ROOT / page).read_text(encoding="utf-8").split())


def test_an_update_is_as_quick_as_the_pages_say():
    about = json.loads((ROOT / "results/latency/manifest.json").read_text())["measured"]
    assert about["loaded"] is False
    table = pd.read_csv(ROOT / "results/latency/latency.csv")
    by = table.set_index(["mode", "estimator", "implementation", "window"]).sort_index()
    hot, cold = by.loc["back_to_back"], by.loc["paced_20_hz", "p50_us"]
    ours, ukf = ("deeponet_kalman", "in place", 64), ("filterpy_ukf", "NumPy model", 1)
    us, ukf_us, ekf_us = hot["p50_us"][[ours, ukf, ("filterpy_ekf", "numba model", 1)]]
    assert us <= ukf_us / 20
    assert us < ekf_us
    assert hot["p99_us"][ours] <= ukf_us / 4
    assert cold[ours] <= 0.3 * cold[ukf]
    for page in ("README.md", "docs/latency.md"):
        assert f"{us:.0f} µs" in words(page)
        assert f"1/{number(ukf_us / us, 2)} of" in words(page)
    assert f"1/{number(ekf_us / us, 2)} of what filterpy's EKF takes with a compiled model" in words("docs/latency.md")
    says = f"At 20 Hz it takes 1/{number(cold[ukf] / cold[ours], 2)} of that UKF, {cold[ours]:.0f} µs"
    assert says in words("docs/latency.md")
    ekf, ukf = (("numba_ekf", "all compiled", 1), ("numba_ukf", "all compiled", 1))
    quicker = "Both are quicker than DeepONet-Kalman" in words("docs/latency.md")
    assert quicker == (hot["p50_us"][[ekf, ukf]] < us).all()
    says = f"an EKF all compiled takes {hot['p50_us'][ekf]:.0f} µs, and a UKF all compiled"
    assert f"{says} {hot['p50_us'][ukf]:.0f} µs" in words("docs/latency.md")
    assert f"At 20 Hz they take {cold[ekf]:.0f} and {cold[ukf]:.0f} µs" in words("docs/latency.md")


def test_an_update_is_as_small_and_sound_as_the_pages_say():
    held = pd.read_csv(ROOT / "results/latency/memory.csv").set_index("implementation")
    kB = held.loc["in place", ["weights_kB", "buffers_kB"]].sum()
    assert kB < 4000.0
    assert f"{kB:.0f} kB" in words("README.md")
    soak = json.loads((ROOT / "results/benchmarks/soak.json").read_text())
    assert (soak["updates"], soak["unsound_updates"]) == (10_000_000, 0)
    assert soak["least_eigenvalue_of_correlation"] > 0.0
    assert abs(soak["drift_MB"]) < 0.5


def test_evaluation_costs_what_the_pages_say():
    table = pd.read_csv(ROOT / "results/benchmarks/evaluation.csv").set_index("estimator")
    assert set(table.index) <= set(discover()) - set(TRIVIAL), "what does nothing is not timed"
    assert (table["recordings"] == 10).all()
    assert (table["samples"] == 30_000).all()
    ours, slowest = table["wall_s"]["deeponet_kalman"], table["wall_s"].max()
    assert ours < 20.0
    assert slowest < 120.0
    says = f"took {ours:.0f} s on two cores, forecasts included. None of those timed took more than {slowest:.0f} s"
    assert says in words("docs/latency.md")


def test_training_takes_its_time_where_the_pages_say():
    table = pd.read_csv(ROOT / "results/benchmarks/training_profile.csv").set_index(["estimator", "function"])["share"]
    back = "<method 'run_backward' of 'torch._C._EngineBase' objects>"
    shares = {
        "it is {:.0f} % of the time": table["deeponet_kalman", "augmentation.augmented"],
        "back through the network alone takes {:.0f} %": table["deeponet_kalman", back],
        "back through it takes {:.0f} %": table["gru_kf", back] + table["gru_kf", "<built-in method torch.gru>"],
        "go through, {:.0f} % of it": table["gru_kf", "frontend._gate_sequence"],
    }
    for says, share in shares.items():
        assert says.format(100 * share) in words("docs/latency.md")


@pytest.fixture
def added(tmp_path):
    """The example's class, found by its path as the page says."""
    path = tmp_path / "regression.py"
    path.write_text(example())
    return find(str(path))


def test_adding_a_baseline_takes_fifteen_lines():
    assert sum(bool(line.strip()) for line in example().splitlines()) <= 15


def test_the_example_is_found_and_leaves_the_registry_alone(added):
    assert added.name == "regression"
    assert "@register\nclass Regression(Estimator)" in example()
    assert "regression" not in discover()


def test_the_example_keeps_the_contract(added):
    results = run_battery(added)
    assert [r for r in results if r.status == "fail"] == []
    assert {r.name for r in results if r.status == "pass"} >= {"step is pure", "the future does not reach the past"}


def test_the_example_file_is_the_example_on_the_page():
    assert (ROOT / "examples/regression.py").read_text() == example()


@pytest.mark.parametrize("line", commands())
def test_every_command_line_shown_is_one(line):
    arguments = build_parser().parse_args(shlex.split(line, comments=True)[1:])
    assert arguments.command == line.split()[1]


def test_the_pages_show_the_commands_that_matter():
    assert {line.split()[1] for line in commands()} >= {"run", "check", "list", "simulate", "estimate"}


def test_a_command_line_that_is_none_would_be_noticed(capsys):
    with pytest.raises(SystemExit):
        build_parser().parse_args(["run", "--no-such-option"])
    assert "--no-such-option" in capsys.readouterr().err


def test_the_readme_names_the_paper_first_and_how_the_command_is_found():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    first = " ".join(readme.split("\n\n")[1].split())
    assert "DeepONet-Kalman Modeling for Real-Time Parameter Updating in Compressor Digital Twins" in first
    assert all(author in first for author in ("Nathan Roux", "Clément Lambert", "Mathéo Masson"))
    assert readme.index(". .venv/bin/activate") < readme.index("\ntwinbench ")


def test_lines_that_work_as_they_stand_name_files_that_are_there_or_come_to_be():
    day_to_day = (ROOT / "README.md").read_text(encoding="utf-8").partition("## Day to day")[2]
    lines = re.findall(r"```sh\n(.*?)```", day_to_day, re.DOTALL)[0].splitlines()
    made = {"recordings/test-00.csv", "results/quick"}
    files = [word for line in lines for word in shlex.split(line, comments=True) if "/" in word]
    assert files
    for name in files:
        assert name in made or (ROOT / name).is_file(), name
    assert "simulate --out recordings" in lines[next(i for i, line in enumerate(lines) if "recordings/" in line) - 1]


def test_pythons_are_the_same_everywhere():
    files = ("README.md", "Makefile", "pyproject.toml")
    readme, makefile, project = ((ROOT / file).read_text(encoding="utf-8") for file in files)
    assert 'requires-python = ">=3.11,<3.14"' in project
    assert "Python 3.11, 3.12 or 3.13" in words("README.md")
    assert "(3, 11) <= sys.version_info < (3, 14)" in makefile
    assert "Python 3.11, 3.12 or 3.13" in makefile
    assert readme.count("Python 3.1") == 1


def test_setting_up_installs_what_export_needs():
    assert "-e '.[export]'" in (ROOT / "Makefile").read_text(encoding="utf-8")


def long_sentences(text: str) -> list[str]:
    """Each with its number of words; what has neither letter nor digit is no word."""
    counted = [(sum(any(c.isalnum() for c in word) for word in s.split()), s) for s in sentences(text)]
    return [f"{count} words: {sentence}" for count, sentence in counted if count > LONGEST_WORDS]


def test_sentences_are_told_apart():
    text = (
        "# A heading. Not one.\n\nIt costs 2.5 s, e.g. here. Then `a b c. d`\nends! See [the page](x.md).\n\n"
        "```sh\nx. y\n```\n"
        "- One item (in brackets.)\n- **Bold.** Next, Eqs. (1) and (2)\n\n| a. b | c |\n|---|---:|\n| d | e |\n\n"
        "<!-- results/x.md -->\nMade. By a command.\n<!-- end -->\nLast $x. y$ one"
    )
    assert sentences(text) == [
        "It costs 2.5 s, e.g. here.", "Then Code ends!", "See the page.", "One item (in brackets.)", "**Bold.**",
        "Next, Eqs. (1) and (2)", "a.", "b", "c", "d", "e", "Last Code one",
    ]  # fmt: skip
    assert long_sentences("w " * 35 + "– .") == []
    assert long_sentences("w " * 36 + "– .") == ["36 words: " + "w " * 36 + "– ."]


@pytest.mark.parametrize("page", READ, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_sentence_of_the_docs_is_longer_than_35_words(page):
    found = long_sentences(page.read_text(encoding="utf-8"))
    assert not found, "\n".join(f"{page.relative_to(ROOT)}: {sentence}" for sentence in found)
