"""Inputs between samples: held, or joined by lines; which, a short stretch tells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from motor import MOTOR
from motor_case import record
from scipy.signal import lfilter

from twinbench.data.recording import Recording
from twinbench.mismatch import diagnose
from twinbench.mismatch.joining import how_joined
from twinbench.mismatch.machine import Machine, Setting
from twinbench.mismatch.model import load_model
from twinbench.mismatch.replay import replay
from twinbench.mismatch.report.explain import Request, explain
from twinbench.mismatch.series import lag_reading
from twinbench.mismatch.steps import settle_step
from twinbench.mismatch.tracks import prepare
from twinbench.physics.simulator import Simulator

RC = """
import numpy as np
from twinbench.physics.simulator import Simulator, Variable

def rhs(x, u, theta):
    return np.array([(u[0] - x[0]) / theta[0]])

CIRCUIT = Simulator(
    name="circuit", states=(Variable("q_V", "V", -20.0, 20.0, 0.0, 2.0),),
    inputs=(Variable("drive_V", "V", -20.0, 20.0, 0.0, 2.0),), outputs=(Variable("out_V", "V", -20.0, 20.0, 0.0, 2.0),),
    parameters=(Variable("tau_s", "s", 0.1, 10.0, 1.5, 0.5),), rhs=rhs,
    output=lambda x, u, theta: np.array([x[0]]), initial=lambda u0, y0, theta: np.array([y0[0]]),
)
"""
TAU_S, DT_S, NOISE_V = 1.2, 0.5, 0.004


def circuit() -> Simulator:
    space: dict[str, Simulator] = {}
    exec(RC, space)
    return space["CIRCUIT"]


def driven(name: str, seed: int, lines: bool, n: int = 800) -> Recording:
    """A resistor and a capacitor under a drive that goes in lines from sample to sample, or stays: exact solutions."""
    rng = np.random.default_rng(seed)
    time_s = DT_S * np.arange(n)
    drive_V = lfilter([0.5], [1.0, -0.8], rng.normal(size=n))
    if lines:
        out_V = lag_reading(time_s, drive_V, TAU_S)
    else:
        out_V = np.zeros(n)
        for k in range(n - 1):
            out_V[k + 1] = drive_V[k] + np.exp(-DT_S / TAU_S) * (out_V[k] - drive_V[k])
    readings = np.stack([drive_V, out_V + NOISE_V * rng.normal(size=n)], axis=1)
    return Recording(name, time_s, ("drive_V", "out_V"), readings)


@pytest.mark.parametrize("lines", [True, False])
def test_a_run_is_the_exact_solution_of_its_kind_of_input(lines):
    (track,) = prepare([driven("run", 1, lines)], circuit(), linear=lines)
    machine = Machine(circuit().with_values(tau_s=TAU_S), ())
    settle_step(machine, [track], np.array([1e-3]))
    x0 = machine.start(track)
    x0[0] = track.u[0, 0] if lines else 0.0
    readings = machine.run(Setting(track, machine.theta, x0))
    assert np.sqrt(np.mean((track.y - readings)[20:] ** 2)) == pytest.approx(NOISE_V, rel=0.08)
    other = machine.run(Setting(prepare([driven("run", 1, lines)], circuit(), linear=not lines)[0], machine.theta, x0))
    assert np.sqrt(np.mean((track.y - other)[20:] ** 2)) > 10.0 * NOISE_V


def test_block_means_under_lines_are_those_of_a_run_sample_by_sample():
    (track,) = prepare([record("slow", 4, seconds=60.0, dt_s=0.02)], MOTOR, blocks=600, linear=True)
    machine = Machine(MOTOR, ())
    settle_step(machine, [track], np.array([1.0, 0.5, 0.5]))
    x0 = machine.start(track)
    fine = track.block_means(machine.run(Setting(track, machine.theta, x0)))
    coarse = machine.run(Setting(track, machine.theta, x0), blocks=True)
    assert coarse.shape == track.means.shape
    assert (np.sqrt(np.nanmean((coarse - fine) ** 2, axis=0)) < 0.05 * np.nanstd(fine, axis=0)).all()


@pytest.mark.parametrize(("lines", "inputs", "by"), [(True, "linear", "fit"), (False, "held", "default")])
def test_a_short_stretch_tells_how_inputs_go(lines, inputs, by):
    tracks = prepare([driven("run", 2, lines)], circuit())
    found = how_joined(Machine(circuit(), ()), tracks)
    assert (found.inputs, found.by) == (inputs, by)
    better, worse = sorted([found.rmse_held, found.rmse_linear])
    assert better == (found.rmse_linear if lines else found.rmse_held)
    assert better < 0.5 * worse


def test_without_an_input_that_moves_nothing_is_tried():
    still = driven("run", 2, True)
    still.values[:, 0] = 1.0
    assert how_joined(Machine(circuit(), ()), prepare([still], circuit())).by == "default"


def test_the_right_kind_of_input_alone_is_the_whole_mismatch():
    """Held inputs look like a late sensor or worse; joined ones leave noise, and nothing is named."""
    runs = [driven("run", 3, True)]
    held_out = [driven("held out", 4, True)]
    joined, held = (diagnose(circuit(), runs, held_out, inputs=inputs) for inputs in ("auto", "held"))
    assert joined.diagnosis.joined.inputs == "linear"
    assert joined.mechanisms == ()
    assert joined.values["tau_s"] == pytest.approx(TAU_S, rel=0.01)
    assert held.mechanisms or held.verdict == "unexplained"
    assert held.diagnosis.joined == ("held", "user", "", "", None, None)
    errors = [v.diagnosis.held_before.rmse[0] for v in (joined, held)]
    assert errors[0] < 1.1 * NOISE_V < 0.25 * errors[1]


def test_a_mended_simulator_keeps_how_its_inputs_go(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "circuit.py").write_text(RC)
    for k, name in enumerate(("a", "b")):
        run = driven(name, k, True)
        pd.DataFrame(np.column_stack((run.time_s, run.values)), columns=["time_s", *run.channels]).to_csv(
            tmp_path / f"{name}.csv", index=False
        )
    spec, out = str(tmp_path / "circuit.py"), tmp_path / "found"
    explain(Request(spec, [tmp_path / "a.csv"], [tmp_path / "b.csv"]), out)
    assert load_model(str(out / "model.toml")).inputs == "linear"
    (written,) = replay(str(out / "model.toml"), [tmp_path / "b.csv"], tmp_path, (), "csv")
    left = pd.read_csv(written)["out_V"] - pd.read_csv(tmp_path / "b.csv")["out_V"]
    assert np.sqrt(np.mean(left[20:] ** 2)) < 1.2 * NOISE_V
    again = explain(Request(str(out / "model.toml"), [tmp_path / "a.csv"], [tmp_path / "b.csv"]), tmp_path / "again")
    assert again.verdict.diagnosis.joined.by == "user"
    assert 'inputs = "linear"' in Path(tmp_path / "again" / "model.toml").read_text()
