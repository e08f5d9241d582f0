"""``twinbench estimate`` says what it used, and is not usable where it used nothing or the wrong things."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import io
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from helpers.documents import check, no_number
from helpers.refusals import listing
from helpers.tiny_run import run_arguments, run_here, twinbench, write_estimator, write_profile

from twinbench.bench.cli.main import build_parser
from twinbench.bench.estimate.reference import Reference
from twinbench.bench.estimate.sampling import joined, manner_of, read_as
from twinbench.common.errors import BadInput
from twinbench.data.units import ATMOSPHERE_BAR, units_of
from twinbench.machines.compressor import COMPRESSOR

CHANNELS, INPUTS, UNITS = COMPRESSOR.channels, COMPRESSOR.inputs, units_of(COMPRESSOR)
EVERY = (1,) * len(CHANNELS)
LEARNS = "return gaussian_state(state.mean, 0.5 * self.arrays['cov']), no_info(len(state.mean))"

HASTY = (
    "read = 1.0 - 0.5 * (~np.isnan(sample.measured[:, 4:])).any(); "
    "return gaussian_state(state.mean, read * self.arrays['cov']), no_info(len(state.mean))"
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """A run of the filter that knows the machine, and recordings of machines that it has not seen, the last one first.

    The first is of low pressures, which stay within the training's when they are a third too high.
    """
    folder = tmp_path_factory.mktemp("trained")
    profile = write_profile(folder)
    text = profile.read_text().replace("n_validation = 1", "n_validation = 6").replace("= 2.5", "= 4.0")
    text = text.replace("n_calibration = 1", "n_calibration = 6")
    profile.write_text(text.replace("n_train = 2", "n_train = 26"))
    with pytest.MonkeyPatch.context() as patch:
        run_here(patch)
        assert twinbench(*run_arguments(profile, folder / "run", ["oracle"])) == 0
    assert twinbench("simulate", "--profile", profile, "--no-truth", "--out", folder / "recordings") == 0
    tables = [pd.read_csv(path) for path in listing(folder / "recordings")[::-1]]
    return SimpleNamespace(profile=profile, run=folder / "run", tables=tables)


Ended = tuple[int, dict, set[str]]
"""Exit status, summary, and the names of the files written."""


def estimated(trained: SimpleNamespace, table: pd.DataFrame, folder: Path, *more: object) -> Ended:
    mine = folder / "mine.csv"
    table.to_csv(mine, index=False)
    arguments = ("estimate", "oracle", mine, "--profile", trained.profile, "--results", trained.run)
    with contextlib.redirect_stdout(io.StringIO()) as said:
        status = twinbench(*arguments, "--out", folder / "out", "--json", *more)
    (summary,) = json.loads(said.getvalue(), parse_constant=no_number)
    check("summary", summary)
    return status, summary, {p.name for p in listing(folder / "out")}


@pytest.fixture
def estimate(trained, tmp_path):
    """Estimate one table."""
    return lambda table, *more: estimated(trained, table, tmp_path, *more)


@pytest.fixture(scope="module")
def sound(trained, tmp_path_factory):
    """Of a recording as it is, by its number; each once."""
    return functools.cache(lambda which: estimated(trained, trained.tables[which], tmp_path_factory.mktemp("sound")))


ALL = {"mine.estimates.csv", "mine.png", "mine.summary.json"}


@pytest.mark.parametrize("which", [0, 1, 2])
def test_a_sound_recording_is_usable_and_says_what_was_used(trained, sound, which):
    status, said, written = sound(which)
    assert (status, said["usable"], said["verdict"], said["because"]) == (0, True, "usable", "")
    assert written == ALL
    for name, use in said["channels"].items():
        read = trained.tables[which][name].notna().mean()
        assert use["offered"] == pytest.approx(read)
        assert 0.98 < use["accepted"] <= 1.0
        assert use["outside"] < 0.5
        assert use["period_s"] == 0.05
        assert use["unit"] == UNITS[name]
    assert said["nis_low"] < said["nis_median"] < said["nis_high"]
    assert said["nis_median"] == pytest.approx(1.0, abs=0.15), "an exact filter's NIS is chi-square"
    assert 0.005 < said["flags"]["spike"] < 0.03
    assert said["gaps"] == 0


def test_the_summary_says_what_it_rests_on(trained, tmp_path):
    (tmp_path / "mine.toml").write_text("[channels]\nvalve = 'valve'\n")
    _, said, _ = estimated(trained, trained.tables[0], tmp_path, "--map", "valve=valve")
    assert json.loads((tmp_path / "out" / "mine.summary.json").read_text()) == said
    made = said["provenance"]
    assert made["settings"] == {
        "estimator": "oracle", "profile": str(trained.profile), "results": str(trained.run), "machine": "compressor",
        "map": ["valve=valve"], "force": False, "delay_s": 0.0, "seed": 0,
    }  # fmt: skip
    assert [f["role"] for f in made["files"]] == ["recording", "sidecar", "profile", "training", "calibration"]
    for file in made["files"]:
        content = Path(file["path"]).read_bytes()
        assert (file["bytes"], file["sha256"]) == (len(content), hashlib.sha256(content).hexdigest())
        assert not file["held_out"]


LATER = """
    delayed = True

    def smooth(self, measured, ticks, delay_s=np.inf):
        mean = np.tile(self.arrays["mean"], (len(measured) * len(ticks), 1))
        mean[:, 0] += 1e-6 * np.tile(ticks, len(measured)) + 1e-3 * delay_s
        return gaussian_state(mean, self.arrays["cov"])
"""


def test_a_delay_writes_what_is_known_later(trained, tmp_path):
    late = Path(write_estimator(tmp_path, "late"))
    late.write_text(late.read_text() + LATER)
    here = ("--profile", trained.profile, "--results", tmp_path / "run")
    assert twinbench(*run_arguments(trained.profile, tmp_path / "run", [str(late)])) == 0
    trained.tables[0].to_csv(tmp_path / "mine.csv", index=False)
    told = []
    for delay in ((), ("--delay", 60)):
        out = tmp_path / f"out{len(delay)}"
        assert twinbench("estimate", late, tmp_path / "mine.csv", *here, "--out", out, "--force", *delay) == 3
        told.append((pd.read_csv(out / "mine.estimates.csv"), json.loads((out / "mine.summary.json").read_text())))
    (now, said), (later, says_later) = told
    column = COMPRESSOR.quantities[0]
    ticks = np.round(now["time_s"] / COMPRESSOR.sample_period_s)
    np.testing.assert_allclose(later[column] - now[column], 0.06 + 1e-6 * (ticks - ticks[0]), atol=1e-6)
    assert [summary["provenance"]["settings"]["delay_s"] for summary in (said, says_later)] == [0.0, 60.0]
    assert says_later["rests_on"][-1] == "  estimates: as known 60 s later, the last ones as known at the end"
    check("summary", says_later)


@pytest.mark.parametrize(
    ("delay", "line"),
    [
        (60, "oracle does not say what it knows later; leave out --delay, or estimate with deeponet_kalman"),
        (-1, "--delay is -1 s; give the seconds to wait, 0 or more"),
        ("nan", "--delay is nan s; give the seconds to wait, 0 or more"),
    ],
)
def test_a_delay_that_cannot_be_is_one_line(trained, tmp_path, capsys, delay, line):
    trained.tables[0].to_csv(tmp_path / "mine.csv", index=False)
    here = ("--profile", trained.profile, "--results", trained.run, "--out", tmp_path / "out")
    assert twinbench("estimate", "oracle", tmp_path / "mine.csv", *here, f"--delay={delay}") == 2
    assert capsys.readouterr().err == f"twinbench: {line}\n"
    assert not (tmp_path / "out").exists()


def test_intervals_are_those_that_fit_the_calibration_recordings(trained, tmp_path):
    _, said, _ = estimated(trained, trained.tables[0], tmp_path)
    assert said["calibrated"] is True
    calibrated = pd.read_csv(tmp_path / "out" / "mine.estimates.csv")
    kept = {path: path.read_bytes() for path in trained.run.glob("store/estimate/*/*")}
    try:
        for path in kept:
            path.unlink()
        _, said, _ = estimated(trained, trained.tables[0], tmp_path)
        own = pd.read_csv(tmp_path / "out" / "mine.estimates.csv")
    finally:
        for path, content in kept.items():
            path.write_bytes(content)
    assert said["calibrated"] is False, "a run whose estimates are gone has no factors"
    for name in ("p_exh_bar", "flow_memory"):
        assert np.array_equal(calibrated[name], own[name])
        wide, narrow = (t[f"{name}_high"] - t[f"{name}_low"] for t in (calibrated, own))
        assert (wide / narrow).std() < 1e-3, "one factor for the whole recording"


def changed(table, **columns):
    return table.assign(**columns)


def swapped(a):
    return lambda t: t.assign(**{f"{a[0]}": t[a[1]], f"{a[1]}": t[a[0]]})


def scaled(factor, *names):
    return lambda t: t.assign(**{n: factor * t[n] for n in names})


def gauge(*names):
    return lambda t: t.assign(**{n: t[n] - ATMOSPHERE_BAR for n in names})


UNLIKE = "these recordings do not look like this machine"
P_SUC, P_DIS = "p_suc_bar", "p_dis_bar"
HOSTILE = {
    "suction and discharge pressure swapped": (swapped((P_SUC, P_DIS)), UNLIKE, "are they swapped?"),
    "temperatures swapped": (swapped(("T_suc_K", "T_dis_K")), UNLIKE, "T_suc_K and T_dis_K read as each other should"),
    "pressures ten times": (scaled(10.0, P_SUC, P_DIS), UNLIKE, "p_dis_bar has the median"),
    "pressures a tenth": (scaled(0.1, P_SUC, P_DIS), UNLIKE, "p_suc_bar has the median 0.0"),
    "discharge pressure ten times": (scaled(10.0, P_DIS), UNLIKE, "training was between"),
    "speed ten times": (scaled(10.0, "N_rpm"), UNLIKE, "N_rpm has the median 1"),
    "speed a tenth": (scaled(0.1, "N_rpm"), UNLIKE, "N_rpm has the median"),
    "discharge pressure is gauge": (gauge(P_DIS), UNLIKE, "is it in barg? Then say --map 'COLUMN[barg]=p_dis_bar'"),
    "discharge pressure a third too high": (scaled(4 / 3, P_DIS), UNLIKE, "it is 0.8 bar above the estimate"),
    "flow a tenth too high": (scaled(1.1, "m_flow_kg_s"), UNLIKE, "m_flow_kg_s was rejected in 99 %"),
    "no speed": (lambda t: changed(t, N_rpm=np.nan), "channels are missing", "N_rpm; on the validation recordings"),
    "no valve": (lambda t: changed(t, valve=np.nan), "channels are missing", "valve"),
    "no outputs": (
        lambda t: changed(t, p_dis_bar=np.nan, T_dis_K=np.nan, m_flow_kg_s=np.nan),
        "channels are missing",
        "its estimate was the prior",
    ),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_what_cannot_be_answered_is_not_written(trained, estimate, case):
    spoil, verdict, because = HOSTILE[case]
    status, said, written = estimate(spoil(trained.tables[0]))
    assert (status, said["usable"], said["verdict"], written) == (3, False, verdict, set())
    assert because in said["because"]


def test_suction_pressure_in_gauge_is_asked_about(trained, tmp_path, capsys):
    table = gauge(P_SUC)(trained.tables[0])
    table[P_SUC] += 0.2 - table[P_SUC].median()  # above nothing, so that no machine is ruled out by it
    table.to_csv(tmp_path / "g.csv", index=False)
    arguments = ("--profile", trained.profile, "--results", trained.run, "--out", tmp_path / "out")
    assert twinbench("estimate", "oracle", tmp_path / "g.csv", *arguments) == 3
    line = capsys.readouterr().out.splitlines()[0]
    assert "p_suc_bar has the median 0.2 bar, training was between 0.8" in line
    gauge(P_SUC)(trained.tables[0]).to_csv(tmp_path / "g.csv", index=False)
    status = twinbench("estimate", "oracle", tmp_path / "g.csv", *arguments)
    out, err = capsys.readouterr()
    assert status in (2, 3)
    assert "barg" in out + err


def test_gauge_pressure_that_is_said_to_be_gauge_changes_nothing(trained, estimate, sound):
    _, told, _ = sound(0)
    maps = ("--map", f"{P_SUC}[barg]={P_SUC}", "--map", f"{P_DIS}[bar(g)]={P_DIS}")
    status, said, _ = estimate(gauge(P_SUC, P_DIS)(trained.tables[0]), *maps)
    assert status == 0
    assert said["final"]["efficiency"]["value"] == pytest.approx(told["final"]["efficiency"]["value"], abs=1e-6)


def test_force_writes_what_is_not_usable_and_still_says_so(trained, estimate):
    status, said, written = estimate(HOSTILE["no speed"][0](trained.tables[0]), "--force")
    assert (status, said["usable"], written) == (3, False, ALL)


def test_what_is_refused_leaves_one_reason_and_no_estimate_on_the_screen(trained, tmp_path, capsys):
    swapped((P_SUC, P_DIS))(trained.tables[0]).to_csv(tmp_path / "mine.csv", index=False)
    arguments = ("estimate", "oracle", tmp_path / "mine.csv", "--profile", trained.profile, "--results", trained.run)
    assert twinbench(*arguments, "--out", tmp_path / "out") == 3
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"mine: {UNLIKE}: ")
    assert lines[-1] == "nothing was written for it; --force writes it all the same"
    assert not any("efficiency" in line for line in lines)


def test_of_two_recordings_the_usable_one_is_written(trained, tmp_path, capsys):
    trained.tables[0].to_csv(tmp_path / "good.csv", index=False)
    scaled(10.0, "N_rpm")(trained.tables[0]).to_csv(tmp_path / "bad.csv", index=False)
    arguments = ("--profile", trained.profile, "--results", trained.run, "--out", tmp_path / "out")
    assert twinbench("estimate", "oracle", tmp_path / "good.csv", tmp_path / "bad.csv", *arguments) == 3
    assert {p.name for p in listing(tmp_path / "out")} == {name.replace("mine", "good") for name in ALL}


@pytest.mark.parametrize(
    "every", [pytest.param(4, marks=pytest.mark.slow), 20, pytest.param(40, marks=pytest.mark.slow)]
)
def test_an_estimate_survives_seldom_readings_because_inputs_are_joined(trained, estimate, sound, every):
    _, whole, _ = sound(3)
    status, said, _ = estimate(trained.tables[3][::every])
    assert status == 0, said["because"]
    assert said["channels"][P_DIS]["period_s"] == pytest.approx(0.05 * every)
    assert said["channels"][P_DIS]["offered"] > 0.95
    efficiency = said["final"]["efficiency"]  # four minutes tell capacity and leakage only together
    assert efficiency["low"] <= whole["final"]["efficiency"]["value"] <= efficiency["high"]


def test_gaps_and_what_was_rejected_are_counted(trained, estimate):
    table = trained.tables[0].copy()
    table.loc[1000:1399, list(CHANNELS)] = np.nan
    table.loc[2000:2199, "T_dis_K"] = 900.0
    _, said, _ = estimate(table)
    assert said["gaps"] == 1
    assert said["longest_gap_s"] == pytest.approx(20.0, abs=0.2)
    use = said["channels"]["T_dis_K"]
    read = table["T_dis_K"].notna().sum()
    assert 1.0 - use["accepted"] > 200 / read
    assert 200 / read <= use["outside"] < 0.5


@pytest.fixture(scope="module")
def estimators(tmp_path_factory):
    """Three that cost nothing, trained: one never learns, one always does, one only at ticks that are read."""
    folder = tmp_path_factory.mktemp("estimators")
    profile = write_profile(folder)
    steps = {"prior": "", "learner": LEARNS, "hasty": HASTY}
    specs = {name: write_estimator(folder, name, step=step) for name, step in steps.items()}
    with pytest.MonkeyPatch.context() as patch:
        run_here(patch)
        assert twinbench(*run_arguments(profile, folder / "run", list(specs.values()))) == 0
    assert twinbench("simulate", "--part", "train", "--profile", profile, "--out", folder / "recordings") == 0
    table = pd.read_csv(folder / "recordings" / "train-00.csv")
    return SimpleNamespace(specs=specs, table=table, options=("--profile", profile, "--results", folder / "run"))


@pytest.mark.parametrize(
    ("name", "every", "status", "says"),
    [
        (
            "prior",
            1,
            3,
            "nothing was learnt: the estimate is the prior: no health interval is narrower than at the start",
        ),
        ("learner", 1, 0, "usable"),
        ("hasty", 1, 0, "usable"),
        (
            "hasty",
            40,
            3,
            "read too seldom: it was read every 2 s, hasty is trained for every 0.05 s and goes down to every "
            "0.1 s; on the validation recordings, read like that, hasty learnt nothing: its estimate was the prior",
        ),
    ],
)
def test_who_learns_nothing_says_so_and_from_where_on(estimators, tmp_path, capsys, name, every, status, says):
    estimators.table[::every].to_csv(tmp_path / "mine.csv", index=False)
    mine = (estimators.specs[name], tmp_path / "mine.csv", *estimators.options, "--out", tmp_path / "out")
    capsys.readouterr()
    assert twinbench("estimate", *mine) == status
    said = capsys.readouterr().out
    assert said.startswith(f"mine: {says}\n")
    assert "not told" in said, "which readings were used"
    assert (tmp_path / "out").exists() == (status == 0)


def test_inputs_are_joined_between_readings_and_not_across_gaps():
    measured = np.arange(24.0)[:, None] * np.arange(1.0, 8.0)
    seldom = read_as(measured[None], (4,) * 7)[0]
    assert manner_of(seldom) == (4,) * 7
    filled = joined(seldom[None], (4,) * 7, len(INPUTS))[0]
    assert np.allclose(filled[:21, : len(INPUTS)], measured[:21, : len(INPUTS)])
    assert np.array_equal(filled[:, len(INPUTS) :], seldom[:, len(INPUTS) :], equal_nan=True)
    seldom[8:13] = np.nan
    assert np.isnan(joined(seldom[None], (4,) * 7, len(INPUTS))[0][5:16]).all()


def test_what_is_read_every_tick_is_left_as_it_is():
    rng = np.random.default_rng(0)
    measured = np.where(rng.random((1, 400, 7)) < 0.05, np.nan, rng.random((1, 400, 7)))
    assert manner_of(measured[0]) == EVERY
    assert np.array_equal(joined(measured, EVERY, len(INPUTS)), measured, equal_nan=True)


def test_a_channel_that_mostly_lacks_counts_as_missing():
    measured = np.ones((100, 7))
    measured[40:, 2] = np.nan
    assert manner_of(measured) == (1, 1, 0, 1, 1, 1, 1)


def test_help_and_pages_name_each_channel_its_unit_and_the_rate(capsys):
    with pytest.raises(SystemExit):
        build_parser().parse_args(["estimate", "--help"])
    said = capsys.readouterr().out
    pages = [said, *(Path(p).read_text(encoding="utf-8") for p in ("README.md", "docs/estimate.md"))]
    short = {"1": "command"}
    for page in pages:
        assert "20 Hz" in page
        assert "gauge" in page
        for channel, unit in UNITS.items():
            lines = [line for line in page.splitlines() if line.strip(" |`").startswith(channel)]
            assert any(short.get(unit, unit) in line.partition(channel)[2].split() for line in lines)
    assert "exit status:\n    0  usable" in said


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda kept: kept.pop("narrowest"), "narrowest"),
        (lambda kept: kept.update(accepted=np.ones(7)), "accepted has shape (7,), must have (2, 7)"),
        (lambda kept: kept.update(covered=np.array(np.nan)), "no number"),
    ],
)
def test_a_reference_that_is_not_what_was_kept_is_one_line(tmp_path, spoil, says):
    kept = {
        "nis": np.ones((2, 9), np.float32),
        "off": np.ones((2, 9, 3), np.float16),
        "accepted": np.ones((2, 7)),
        "covered": np.array(0.95),
        "factors": np.ones(10),
        "narrowest": np.full(5, 0.5),
    }
    np.savez(tmp_path / "part.npz", **kept)
    assert Reference.load(tmp_path / "part.npz", COMPRESSOR).covered == 0.95
    spoil(kept)
    np.savez(tmp_path / "part.npz", **kept)
    with pytest.raises(BadInput, match=re.escape(says)):
        Reference.load(tmp_path / "part.npz", COMPRESSOR)
