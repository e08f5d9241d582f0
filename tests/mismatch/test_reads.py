"""A controller inside the simulator reads a sensor: a fault of the sensor acts on the machine through it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from twinbench.common.errors import BadInput
from twinbench.mismatch.faults import faults
from twinbench.mismatch.machine import Machine, Setting
from twinbench.mismatch.recordings import read_recordings
from twinbench.mismatch.tracks import prepare
from twinbench.physics.simulator import Simulator, Variable

STEP_S, BIAS_K = 0.5, 4.0


def rhs(x, u, theta):
    gain_W_K, capacity_J_K, loss_W_K = theta
    power = max(gain_W_K * (u[0] - u[1]), 0.0)
    return np.array([(power - loss_W_K * (x[0] - 290.0)) / capacity_J_K])


OVEN = Simulator(
    name="oven",
    states=(Variable("T_K", "K", 250.0, 600.0, 350.0, 20.0),),
    inputs=(Variable("set_K", "K", 280.0, 600.0, 350.0, 20.0), Variable("read_K", "K", 250.0, 600.0, 350.0, 20.0)),
    outputs=(Variable("probe_K", "K", 250.0, 600.0, 350.0, 20.0),),
    parameters=(
        Variable("gain_W_K", "W/K", 0.0, 500.0, 50.0),
        Variable("capacity_J_K", "J/K", 100.0, 9000.0, 1000.0),
        Variable("loss_W_K", "W/K", 0.0, 50.0, 5.0),
    ),
    rhs=rhs,
    output=lambda x, u, theta: np.array([x[0]]),
    initial=lambda u0, y0, theta: np.array([y0[0]]),
    reads=(("read_K", "probe_K"),),
)


def recorded(path: Path, bias_K: float) -> Path:
    """A file of the oven under control, whose probe reads too high; the controller reads the probe."""
    time_s = STEP_S * np.arange(600)
    set_K = 350.0 + 20.0 * np.sign(np.sin(time_s / 20.0))
    temperature, probe = np.empty(600), np.empty(600)
    temperature[0] = 340.0
    for k in range(600):
        probe[k] = temperature[k] + bias_K
        if k < 599:
            # The reading holds for a step, so the oven's equation is linear over it, and solved.
            power = max(50.0 * (set_K[k] - probe[k]), 0.0)
            end = 290.0 + power / 5.0
            temperature[k + 1] = end + (temperature[k] - end) * np.exp(-5.0 * STEP_S / 1000.0)
    pd.DataFrame({"time_s": time_s, "set_K": set_K, "probe_K": probe}).to_csv(path, index=False)
    return path


def misfit(simulator: Simulator, path: Path, bias_K: float) -> float:
    """Root mean square of what the simulator misses when its probe is off by so much, in K."""
    track = prepare(read_recordings([path], simulator), simulator)[0]
    machine = Machine(simulator, [m for m in faults(simulator, STEP_S) if m.name == "sensor_bias@probe_K"])
    machine.step_s = 0.25 * STEP_S
    theta = machine.theta.copy()
    theta[machine.candidates[0].at[0]] = bias_K
    read = machine.run(Setting(track, theta, np.array([340.0])))
    return float(np.sqrt(np.mean((read - track.y) ** 2)))


def test_the_input_is_the_sensors_own_reading(tmp_path):
    path = recorded(tmp_path / "day.csv", BIAS_K)
    (recording,) = read_recordings([path], OVEN)
    assert recording.channels == ("set_K", "read_K", "probe_K")
    assert np.array_equal(recording.values[:, 1], recording.values[:, 2])


def test_a_gap_of_the_sensor_holds_for_the_controller(tmp_path):
    path = recorded(tmp_path / "day.csv", BIAS_K)
    frame = pd.read_csv(path)
    frame.loc[100:109, "probe_K"] = np.nan
    frame.to_csv(path, index=False)
    (recording,) = read_recordings([path], OVEN)
    assert np.isnan(recording.values[100:110, 2]).all()
    assert np.array_equal(recording.values[100:110, 1], np.full(10, frame["probe_K"][99]))


def test_a_column_of_its_own_is_taken_as_it_is(tmp_path):
    path = recorded(tmp_path / "day.csv", BIAS_K)
    pd.read_csv(path).assign(read_K=333.0).to_csv(path, index=False)
    (recording,) = read_recordings([path], OVEN)
    assert (recording.values[:, 1] == 333.0).all()


def test_without_the_declaration_the_input_has_to_be_there(tmp_path):
    path = recorded(tmp_path / "day.csv", BIAS_K)
    with pytest.raises(BadInput, match="no column 'read_K'"):
        read_recordings([path], replace(OVEN, reads=()))


def test_a_false_sensor_in_the_loop_is_explained_by_its_bias_alone(tmp_path):
    path = recorded(tmp_path / "day.csv", BIAS_K)
    assert misfit(OVEN, path, BIAS_K) < 1e-6
    assert misfit(OVEN, path, 0.0) == pytest.approx(BIAS_K, rel=1e-6)


def test_the_loop_that_reads_the_true_state_is_another_machine(tmp_path):
    """Were the controller's reading the simulated state, no bias of the probe would explain the recording."""
    path = recorded(tmp_path / "day.csv", BIAS_K)

    def closed(x, u, theta):
        power = max(theta[0] * (u[0] - x[0]), 0.0)
        return np.array([(power - theta[2] * (x[0] - 290.0)) / theta[1]])

    blind = replace(OVEN, rhs=closed)
    assert min(misfit(blind, path, bias) for bias in np.linspace(-6.0, 6.0, 25)) > 0.1


@pytest.mark.parametrize(
    ("reads", "says"),
    [
        ((("seen", "probe_K"),), "reads 'seen' of 'probe_K', but has no input 'seen'"),
        ((("read_K", "seen"),), "reads 'read_K' of 'seen', but has no output 'seen'"),
    ],
)
def test_what_is_read_has_to_exist(reads, says):
    with pytest.raises(ValueError, match=says):
        replace(OVEN, reads=reads)


def test_a_reading_and_its_sensor_have_one_unit():
    degrees = (OVEN.inputs[0], replace(OVEN.inputs[1], unit="degC"))
    with pytest.raises(ValueError, match="one is in 'degC' and the other in 'K'; give both one unit"):
        replace(OVEN, inputs=degrees)
