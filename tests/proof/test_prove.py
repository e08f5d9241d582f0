"""The concealed-effect suite: drawn from a seed, sealed, blind, judged rightly."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from short_machines import SHORT, measured
from statsmodels.stats.proportion import proportion_confint

from twinbench.common.errors import BadInput
from twinbench.data.scenario import stream
from twinbench.mismatch.model import load_simulator, whole_catalogue
from twinbench.physics.integrate import simulate
from twinbench.proof.concealed import case
from twinbench.proof.concealed.engine import Engine
from twinbench.proof.concealed.engines import chosen
from twinbench.proof.concealed.findings import read_cases
from twinbench.proof.concealed.gates import gate_table, misses, wilson
from twinbench.proof.concealed.generate import CELLS, Case, Item, draw, write
from twinbench.proof.concealed.integrate import Parameters
from twinbench.proof.concealed.judge import COLUMNS, score
from twinbench.proof.concealed.machines import MACHINES, machines
from twinbench.proof.concealed.observer import SEEN_SQ, TOLD_SQ
from twinbench.proof.concealed.outcome import SOUND
from twinbench.proof.concealed.plan import FULL, SEVERITIES, cases
from twinbench.proof.concealed.seal import BrokenSeal, seal
from twinbench.proof.concealed.severity import Take, Yardstick, readings
from twinbench.proof.concealed.suite import Study, run

COULOMB = "coulomb_friction@omega_rad_s"
HERE = Path(__file__)


def quick(cell: str, *effects: str, severity: float = 1.0, machine: str = "motor", seed: int = 3) -> Case:
    return draw(Item("0007", cell, machine, effects, severity), seed, SHORT)


@pytest.fixture(scope="module")
def dry() -> Case:
    return quick("mechanism", COULOMB)


# Drawing.


@pytest.mark.parametrize(
    "cell",
    [pytest.param("clean", marks=pytest.mark.slow), "mechanism", pytest.param("foreign", marks=pytest.mark.slow)],
)
def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(cell: str, dry: Case, tmp_path: Path) -> None:
    effects = {"clean": (), "mechanism": (COULOMB,), "foreign": ("saturating_iron",)}[cell]
    first = dry if cell == "mechanism" else quick(cell, *effects)
    for folder, drawn in (("a", first), ("b", quick(cell, *effects)), ("c", quick(cell, *effects, seed=4))):
        write(drawn, tmp_path / folder)
    names = sorted(p.name for p in (tmp_path / "a").iterdir())
    assert names == ["case.json", "held_1.csv", "train_1.csv", "train_2.csv", "train_3.csv"]
    bytes_of = {f: [(tmp_path / f / n).read_bytes() for n in names[1:]] for f in "abc"}
    assert bytes_of["a"] == bytes_of["b"]
    assert all(a != c for a, c in zip(bytes_of["a"], bytes_of["c"], strict=True))


@pytest.mark.parametrize(
    "machine", [pytest.param(m, marks=[pytest.mark.slow] * (m != "motor")) for m in sorted(MACHINES)]
)
def test_recordings_hold_sensor_columns_alone_and_the_case_nothing_of_the_truth(machine: str, tmp_path: Path) -> None:
    m = MACHINES[machine]
    case = quick("mechanism", m.effects[0].name, machine=machine)
    write(case, tmp_path)
    for path in tmp_path.glob("*.csv"):
        table = pd.read_csv(path)
        assert tuple(table.columns) == ("time_s", *m.inputs, *m.outputs)
        assert np.isfinite(table.to_numpy()).all()
    text = (tmp_path / "case.json").read_text()
    assert set(json.loads(text)) == {"machine", "simulator", "values", "calibrate", "without", "train", "held_out"}
    assert m.effects[0].name not in text


def test_the_catalogue_of_a_left_out_case_lacks_all_that_nobody_could_tell_from_it() -> None:
    case = quick("left_out", "offset@omega_rad_s")
    (effect,) = case.truth["effects"]
    assert {"input_bias@load_Nm", "offset@omega_rad_s"} <= set(effect["class"])
    assert case.public["without"] == sorted({*effect["class"], *effect["close"]})


@pytest.mark.parametrize("machine", sorted(MACHINES))
def test_the_truth_without_effects_is_the_twin(machine: str) -> None:
    """Written separately, they must agree in all but what is concealed: a sound machine has no lag of its own."""
    m = MACHINES[machine]
    spec = m.simulator if ".py" not in m.simulator else str(HERE.parents[2] / m.simulator)
    twin = load_simulator(spec).with_values(**m.values)
    p = m.p(exponent=2.0)
    take = Take("train_1", 0.0, m.operate(stream(5, machine), m.seconds["train"][0], "train"))
    yardstick = Yardstick(m, [take], p)
    unit = np.array([1e-5, 1e-5, *[1.0] * 6]) if machine == "compressor" else 1.0
    x0 = yardstick.starts[0][: len(twin.states)] * unit
    y = simulate(twin, take.u[None], x0, dt_s=m.period_s, substeps=4)[1][0]
    recorded = readings(m, take, take.u, yardstick.starts[0], Parameters.steady(p), m.fine)
    rms = np.sqrt(np.mean(((y - recorded) / m.sigma()) ** 2, axis=0))
    assert (rms < 0.005).all()


@pytest.mark.parametrize("machine", sorted(MACHINES))
def test_effects_are_in_the_catalogue_and_their_ports_and_sizes_exist(machine: str) -> None:
    m = MACHINES[machine]
    spec = m.simulator if ".py" not in m.simulator else str(HERE.parents[2] / m.simulator)
    twin = load_simulator(spec)
    catalogue = {c.name: c for c in whole_catalogue(twin, (), m.period_s)}
    ports = {
        f"{kind}:{v.name}"
        for kind, group in (
            ("balance", twin.states),
            ("flux", twin.fluxes),
            ("output", twin.outputs),
            ("input", twin.inputs),
        )
        for v in group
    }
    from twinbench.proof.concealed.faults import faults

    for effect in (*m.effects, *m.foreign, *faults(m)):
        assert effect in m.foreign or effect.name in catalogue, effect.name
        assert set(effect.ports) <= ports, effect.name
        if effect.size:
            assert effect.size in {v.name for v in catalogue[effect.name].parameters}, effect.name
    assert set(m.calibrate) <= {v.name for v in twin.parameters}
    assert m.rippled in m.parameters
    assert set(m.played) <= set(m.inputs)
    assert set(m.played.values()) <= set(m.parameters)


def test_every_amplitude_moves_the_readings() -> None:
    for m in SHORT.values():
        takes = [Take(n, 0.0, m.operate(stream(6, m.name, n), 60.0, "train")) for n in ("train_1", "held_1")]
        yardstick = Yardstick(m, takes, m.p(exponent=2.0))
        for effect in (*m.effects, *m.foreign):
            there = m.p(exponent=2.0, **{effect.slot: effect.most})
            assert min(yardstick.measure(yardstick.with_parameters(there))) > 1e-6, effect.name


# Severity.


def test_an_effect_is_scaled_to_its_severity(dry: Case) -> None:
    (effect,) = dry.truth["effects"]
    assert min(effect["held_out"], effect["in_training"]) == pytest.approx(1.0, rel=0.05)
    smaller = quick("mechanism", COULOMB, severity=0.1).truth["effects"][0]
    assert smaller["amplitude"] == pytest.approx(0.1 * effect["amplitude"], rel=0.1)


def test_what_parameters_absorb_does_not_count() -> None:
    """More viscous friction is a parameter: nothing of it is left."""
    m = SHORT["motor"]
    yardstick = measured(m)
    more = yardstick.with_parameters(m.p(exponent=2.0, b_Nms=0.052))
    raw = [np.sqrt(np.mean(((a - b) / m.sigma()) ** 2)) for a, b in zip(more, yardstick.base, strict=True)]
    assert min(raw) > 0.05
    assert max(yardstick.measure(more)) < 0.1 * min(raw)


def test_an_effect_out_of_reach_carries_the_severity_that_it_has() -> None:
    weak = {
        "motor": replace(
            SHORT["motor"], effects=tuple(replace(e, typical=1e-3, most=1e-3) for e in SHORT["motor"].effects)
        )
    }
    truth = draw(Item("1", "mechanism", "motor", (COULOMB,), 1.0), 3, weak).truth
    assert 0.0 < truth["severity"] < 0.1
    assert truth["severity"] == pytest.approx(truth["effects"][0]["severity"], abs=1e-3)


def test_an_onset_lies_inside_the_second_recording_and_changes_nothing_before() -> None:
    case, sound = quick("onset", COULOMB), quick("onset", COULOMB, severity=1e-3)
    onset = case.truth["onset_s"]
    table = case.tables["train_2"]
    assert table["time_s"].iloc[0] < onset < table["time_s"].iloc[-1]
    assert case.tables["train_1"]["time_s"].iloc[-1] < table["time_s"].iloc[0]
    assert sound.truth["severity"] <= 1e-3


def test_a_machine_has_settled_under_the_fault_of_its_input() -> None:
    """Else its first second would give the fault away, and the recording would not hold what was scaled."""
    m = SHORT["motor"]
    yardstick = measured(m)
    shifted = [take.u + np.array([10.0, 0.0]) for take in yardstick.takes]
    made = yardstick.with_inputs(shifted)
    for take, u, y in zip(yardstick.takes, shifted, made, strict=True):
        assert y[0, 0] == m.settled(u, yardstick.p, take.start_s)[1]
    same = yardstick.with_inputs([take.u for take in yardstick.takes])
    assert all((a == b).all() for a, b in zip(same, yardstick.base, strict=True))


def test_what_saturates_does_so_where_the_engine_learns() -> None:
    """The held-out recordings reach further: a limit that only they meet could not be named."""
    truth = quick("sensor", "input_saturation@voltage_V", severity=0.5).truth
    (effect,) = truth["effects"]
    assert effect["in_training"] > 0.3
    assert truth["severity"] == pytest.approx(0.5, rel=0.05)


def test_background_severity_and_parameters_are_as_asked() -> None:
    clean = quick("clean").truth
    assert {k: clean["parameters"][k] for k in MACHINES["motor"].calibrate} == {
        k: MACHINES["motor"].parameters[k] for k in MACHINES["motor"].calibrate
    }
    drawn = [quick("parameters", seed=s, machine="two_tanks").truth for s in range(12)]
    assert {t["background_pct"] for t in drawn} == {0.0, 0.2, 1.0}
    off = np.array([t["parameters"]["hole1_cm2"] / 0.5 - 1.0 for t in drawn])
    assert np.abs(off).max() <= 0.15
    assert np.abs(off).max() > 0.05


# The plan.


def test_a_plan_holds_every_cell_and_machine_and_repeats_from_its_seed() -> None:
    planned, drawn = cases(300, 1), machines(1)
    assert len(planned) == 300
    assert sum(FULL.values()) == 1080
    assert {i.cell for i in planned} == set(CELLS)
    assert set(MACHINES) < {i.machine for i in planned} <= set(drawn)
    assert planned == cases(300, 1)
    assert planned != cases(300, 2, drawn)
    assert {i.cell for i in planned[:15]} == set(CELLS)
    counted = pd.Series([i.cell for i in cases(1080, 1, drawn)]).value_counts()
    assert counted.to_dict() == FULL
    assert all(len(i.effects) == (0 if i.cell in SOUND else 2 if i.cell == "two_effects" else 1) for i in planned)
    severities = np.array([i.severity for i in planned if i.effects])
    assert SEVERITIES[0] <= severities.min() < 0.12
    assert 2.5 < severities.max() <= SEVERITIES[1]
    assert np.median(severities) == pytest.approx(math.sqrt(0.3), rel=0.25)  # even in its logarithm
    assert len({i.case for i in planned}) == 300


# The seal.


def test_a_changed_truth_breaks_the_seal(dry: Case) -> None:
    sealed = seal(dry.truth)
    assert sealed.digest != seal(dry.truth).digest  # salted
    changed = json.loads(json.dumps(sealed.truth))
    changed["effects"][0]["amplitude"] *= 1.0 + 1e-9
    score(sealed, sealed.digest, {"findings": []})
    with pytest.raises(BrokenSeal, match="does not match its seal"):
        score(replace(sealed, truth=changed), sealed.digest, {"findings": []})


# The blind process.


@pytest.fixture
def spy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An engine that tries to look, and tells how it went."""
    (tmp_path / "engines").mkdir()
    (tmp_path / "engines" / "spy.py").write_text("""
import importlib, os, subprocess, pathlib
def look(simulator, recordings, hold_out=(), catalogue=None):
    out = pathlib.Path(os.environ["SPY_OUT"])
    suite = pathlib.Path(os.environ["SPY_SUITE"])
    tries = {
        "import": lambda: importlib.import_module("twinbench.proof.concealed.generate"),
        "source": lambda: (suite / "generate.py").read_text(),
        "truth": lambda: (out / "truth.json").read_text(),
        "link": lambda: os.symlink(out, out.parent / "spy-link"),
        "list": lambda: list(out.iterdir()),
        "memory": lambda: open(f"/proc/{os.getppid()}/mem", "rb"),
        "arguments": lambda: open(f"/proc/{os.getppid()}/cmdline", "rb"),
        "process": lambda: subprocess.run(["cat", str(out / "truth.json")]),
        "fork": lambda: os.fork(),
    }
    said = {}
    for name, attempt in tries.items():
        try:
            attempt(); said[name] = "got in"
        except (ImportError, PermissionError) as error:
            said[name] = "refused"
    return {"verdict": "spied", "findings": [], "said": said, "names": [m.name for m in catalogue],
            "calibrate": simulator.calibrate, "recordings": [r.name for r in (*recordings, *hold_out)]}
def fail(simulator, recordings, hold_out=(), catalogue=None):
    raise RuntimeError("no idea")
def end(simulator, recordings, hold_out=(), catalogue=None):
    os._exit(3)
def sleep(simulator, recordings, hold_out=(), catalogue=None):
    import time; time.sleep(60)
""")
    out = tmp_path / "out"
    out.mkdir()
    (out / "truth.json").write_text("{}")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "engines"))
    monkeypatch.setenv("SPY_OUT", str(out))
    monkeypatch.setenv("SPY_SUITE", str(HERE.parents[2] / "proof" / "concealed"))
    return out


def test_the_engines_process_can_neither_import_nor_read(spy: Path, tmp_path: Path, dry: Case) -> None:
    write(dry, tmp_path / "given")
    engine = Engine(spy, spy / "log")
    try:
        verdict = engine.ask(tmp_path / "given", "spy:look", 120.0)
        assert verdict["said"] == dict.fromkeys(verdict["said"], "refused")
        assert len(verdict["said"]) == 9
        assert COULOMB in verdict["names"]
        assert verdict["recordings"] == ["train_1", "train_2", "train_3", "held_1"]
        assert tuple(verdict["calibrate"]) == MACHINES["motor"].calibrate
        failed = engine.ask(tmp_path / "given", "spy:fail", 120.0)
        assert (failed["verdict"], failed["says"]) == ("failed", "RuntimeError: no idea")
        assert engine.ask(tmp_path / "given", "spy:sleep", 1.0)["says"] == "no answer within 1 s"
        assert engine.ask(tmp_path / "given", "spy:end", 120.0)["says"] == "its process ended"
    finally:
        engine.close()


def test_what_the_ideal_observer_sees_is_sealed_with_the_truth(dry: Case) -> None:
    (effect,) = dry.truth["effects"]
    assert COULOMB in effect["class"]
    assert dry.truth["D0_sq"] == effect["D0_sq"] > effect["Dk_sq"] == dry.truth["Dk_sq"]
    assert dry.truth["detectable"] == (effect["D0_sq"] >= SEEN_SQ and effect["Dk_sq"] >= TOLD_SQ)
    # Severity 1 on each of some samples: what is seen of it sums up.
    assert effect["D0_sq"] > 100.0
    for cell in SOUND:
        sound = quick(cell).truth
        assert (sound["effects"], sound["detectable"], sound["D0_sq"]) == ([], None, None)


def test_of_two_effects_each_stands_beside_the_other() -> None:
    alone, both = quick("mechanism", COULOMB), quick("two_effects", COULOMB, "hysteresis@omega_rad_s")
    seen = {e["name"]: e for e in both.truth["effects"]}
    assert seen[COULOMB]["D0_sq"] < 0.9 * alone.truth["D0_sq"]
    assert both.truth["D0_sq"] == min(e["D0_sq"] for e in seen.values())


# The judge.


def finding(name: str | None = COULOMB, *others: str, port: str = "balance:omega_rad_s", **more: object) -> dict:
    return {
        "kind": "missing physics",
        "mechanism": name,
        "indistinguishable_from": list(others),
        "port": port,
        "ports": [{"port": port, "probability": 0.9}],
        **more,
    }


def judged(case: Case, *findings: dict, **more: object) -> pd.Series:
    sealed = seal(case.truth)
    return pd.Series(score(sealed, sealed.digest, {"verdict": "v", "findings": list(findings), **more}))


def test_a_right_name_is_right(dry: Case) -> None:
    true = dry.truth["effects"][0]["amplitude"]
    fitted = {"coulomb_friction_omega_rad_s": {"value": 1.04 * true, "low": 0.9 * true, "high": 1.1 * true}}
    floor = dry.truth["held_out_floor"]
    fit = [
        {"channel": c, "held_out": True, "rmse_before": 2.0 * s, "rmse_after": math.sqrt(1.3) * s}
        for c, s in floor.items()
    ]
    check = {"decoys_named": 1, "decoys": 20}
    row = judged(dry, finding(parameters=fitted), fit=fit, seconds=4.0, self_check=check)
    assert tuple(row.index) == COLUMNS
    assert row["decoys_named"] == 0.05
    assert math.isnan(judged(dry)["decoys_named"])
    assert (row["named"], row["set"], row["truth"]) == (COULOMB, "", COULOMB)
    assert row["size_error_pct"] == pytest.approx(4.0)
    assert row["size_covered"] == 1.0
    assert row["gain"] == pytest.approx(0.9)
    assert (row["outcome"], row["seed"], row["kind"]) == ("name", 0, "tuned")
    assert row["class"].split("|") == dry.truth["effects"][0]["class"]


def test_where_equations_are_inexact_is_a_place_if_no_finding_is_one(dry: Case) -> None:
    here, elsewhere = [{"port": "balance:omega_rad_s"}], [{"port": "balance:current_A"}]
    assert judged(dry, inexact=here)["outcome"] == "located"
    assert judged(dry, inexact=elsewhere)["outcome"] == "abstained"
    assert judged(dry, finding(None, port="balance:current_A"), inexact=here)["outcome"] == "abstained", "it is said"


def test_a_row_holds_what_was_claimed_in_order(dry: Case) -> None:
    said = judged(
        dry,
        finding("x", "y", probability=0.6),
        finding(COULOMB, probability=0.98),
        finding(None, port="input:voltage_V"),
    )
    assert (said["named"], said["set"], said["probability"]) == (COULOMB, "x|y", "0.98+0.6")
    assert said["ports"] == "balance:omega_rad_s+balance:omega_rad_s+input:voltage_V"
    assert said["outcome"] == "wrong"  # by its set
    assert judged(dry, finding("x"))["probability"] == ""


def test_a_change_of_a_parameter_is_no_claim() -> None:
    case = quick("parameters")
    told = judged(case, {"kind": "parameter change", "mechanism": "R_ohm", "port": "parameter:R_ohm"})
    assert (told["outcome"], told["named"]) == ("abstained", "")
    assert judged(case, finding())["outcome"] == "false"


def test_parameters_are_covered_that_their_intervals_hold() -> None:
    case = quick("parameters")
    true = case.truth["parameters"]
    told = {
        "R_ohm": {"low": 0.9 * true["R_ohm"], "high": 1.1 * true["R_ohm"]},
        "L_H": {"low": 1.1 * true["L_H"], "high": 1.2 * true["L_H"]},
        "dry": {"low": 5.0, "high": 6.0},  # not the twin's
    }
    assert judged(case, parameters=told)["parameters_covered"] == 0.5
    assert math.isnan(judged(case)["parameters_covered"])


def test_the_onset_counts_on_the_recordings_clock() -> None:
    case = quick("onset", COULOMB)
    at = case.truth["onset_s"]
    row = judged(case, finding(since_s=at + 7.0), finding("periodic@omega_rad_s", since_s=at))
    assert row["onset_error_s"] == pytest.approx(7.0)
    assert math.isnan(judged(case, finding())["onset_error_s"])


# Gates.


@pytest.mark.parametrize(("hits", "n"), [(0, 1), (0, 200), (3, 7), (85, 100), (100, 100)])
def test_wilson_is_statsmodels(hits: int, n: int) -> None:
    assert wilson(hits, n) == pytest.approx(proportion_confint(hits, n, 0.05, "wilson"), abs=1e-12)


def test_rows_go_through_the_file(dry: Case, tmp_path: Path) -> None:
    dry = replace(dry, truth=dry.truth | {"detectable": True})  # too short in itself to tell it from Stribeck friction
    wrong = judged(dry, finding("cubic_friction@omega_rad_s"))
    rows = [judged(dry, finding(probability=0.99))] * 9 + [wrong, judged(quick("clean"))]
    pd.DataFrame(rows).to_csv(tmp_path / "cases.csv", index=False)
    table = read_cases(tmp_path / "cases.csv")
    assert table["detectable"].tolist() == [True] * 10 + [False]
    gates = gate_table(table).set_index("gate")
    name = gates.loc["single effect: right name alone, tuned machines"]
    assert (name["measured"], name["cases"], name["met"]) == (0.9, 10, True)
    assert (name["low"], name["high"]) == wilson(9, 10)
    assert gates.loc["confidently wrong, of all verdicts", "measured"] == pytest.approx(1 / 11)
    assert gates.loc["stated probability, mean error", "measured"] == pytest.approx(0.01)
    assert gates.loc["both of two effects, by class", "met"] is None
    assert misses(table)["miss"].tolist() == ["wrong name"]


# The run.


def test_a_suite_runs_seals_first_and_goes_on_where_it_stopped(spy: Path, tmp_path: Path) -> None:
    out, said = tmp_path / "proof", StringIO()
    gates = run(Study(1, 1, {"spy": "spy:look"}), out, Console(file=said), jobs=1)
    assert len(gates) > 10
    assert "to do: 1 answer; the cost is not known" in said.getvalue()
    table = read_cases(out / "cases.csv")
    assert tuple(table.columns) == COLUMNS
    assert (table["engine"] == "spy").all()
    folder = out / "cases" / table["case"][0]
    opened = json.loads((folder / "truth.json").read_text())
    from twinbench.proof.concealed.seal import Sealed

    assert Sealed(**opened).digest == json.loads((folder / "seal.json").read_text())["sha256"]
    assert (folder / "seal.json").stat().st_mtime_ns < (folder / "verdict-spy.json").stat().st_mtime_ns
    assert (folder / "verdict-spy.json").stat().st_mtime_ns < (folder / "truth.json").stat().st_mtime_ns
    before = (folder / "truth.json").read_bytes()
    run(Study(1, 1, {"spy": "spy:look"}), out, Console(file=said), jobs=1)
    assert (folder / "truth.json").read_bytes() == before  # kept: a new draw would have a new salt
    assert "1 of 1 cases are there" in said.getvalue()
    assert "to do: 0 answers\n" in said.getvalue()
    manifest = json.loads((out / "manifest.json").read_text())
    assert (manifest["cases"], manifest["seed"]) == (1, 1)
    written = {"cases.csv", "gates.csv", "gates.md", "power.csv", "power.svg", "reliability.csv", "reliability.svg"}
    assert written | {"outcomes.csv", "misses.csv", "engines.csv"} <= {p.name for p in out.iterdir()}


def test_a_new_judge_scores_what_is_there(spy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The answers are kept: no engine is asked again."""
    out, said = tmp_path / "proof", StringIO()
    run(Study(1, 1, {"spy": "spy:look"}), out, Console(file=said), jobs=1)
    answers = {path: path.read_bytes() for path in out.glob("cases/*/verdict-spy.json")}
    monkeypatch.setattr(case, "score", lambda *asked: score(*asked) | {"outcome": "set"})
    run(Study(1, 1, {"spy": "spy:look"}), out, Console(file=said), jobs=1)
    assert "1 of 1 cases are there" in said.getvalue()
    assert read_cases(out / "cases.csv")["outcome"].tolist() == ["set"]
    assert {path: path.read_bytes() for path in out.glob("cases/*/verdict-spy.json")} == answers


def checkout(folder: Path, says: str) -> str:
    """A checkout whose engine says the same of every case; its place."""
    for package in (folder / "proof", folder / "twinbench" / "proof"):
        package.mkdir(parents=True)
        (package / "blind.py").write_text(f"""
import json, sys
from pathlib import Path
for line in sys.stdin:
    verdict = dict(verdict="failed", says={says!r}, findings=[], seconds=1.0)
    (Path(json.loads(line)["folder"]) / "verdict.json").write_text(json.dumps(verdict))
    print("done", flush=True)
""")
    (folder / "twinbench" / "__init__.py").touch()
    (folder / "twinbench" / "proof" / "__init__.py").touch()
    return str(folder)


def test_the_engine_of_another_checkout_answers_beside_ours(
    spy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    first, second = checkout(tmp_path / "first", "first"), checkout(tmp_path / "second", "second")
    for folder, says in ((first, "first"), (Path(first).name, "first"), (second, "second")):
        engines = chosen(f"before={folder}") | {"spy": "spy:look"}
        run(Study(1, 1, engines), tmp_path / "out", Console(quiet=True), jobs=1)
        (answer,) = tmp_path.glob("out/cases/*/verdict-before.json")
        assert json.loads(answer.read_text())["answer"]["says"] == says
    assert read_cases(tmp_path / "out" / "cases.csv")["engine"].tolist() == ["before", "spy"]


def test_what_is_no_checkout_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"engine 'before': .* is no checkout of Twinbench; it has no proof/blind.py"):
        chosen(f"before={tmp_path}")
    with pytest.raises(BadInput, match=r"engine 'sindy' is one of this checkout; name the one in .* otherwise"):
        chosen(f"sindy={checkout(tmp_path / 'first', '')}")


def test_a_machine_that_diverges_as_it_is_drawn_is_no_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The suite goes on without it; another generator would have to draw it again."""

    def diverges(item: Item, seed: int) -> Case:
        raise FloatingPointError(f"machine {item.machine} diverged")

    monkeypatch.setattr(case, "draw", diverges)
    item, engines = Item("0003", "clean", "motor", (), 0.0), {"twinbench": "twinbench.mismatch:diagnose"}
    assert case.missing(item, 3, tmp_path, engines) == ["twinbench"]
    assert case.run_case(item, 3, tmp_path, engines, ["twinbench"]) == 1
    assert case.undrawn(item, 3, tmp_path) == "machine motor diverged"
    assert case.missing(item, 3, tmp_path, engines) == []
    assert case.undrawn(item, 4, tmp_path) == ""
    assert case.missing(item, 4, tmp_path, engines) == ["twinbench"]
