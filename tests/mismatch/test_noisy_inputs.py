"""Inputs that are recorded with noise: the noise is found and taken off, and no healthy machine is blamed for it."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from motor import MOTOR
from motor_case import CHANNELS, TRUE, record
from scipy.sparse.linalg import aslinearoperator
from scipy.stats import multivariate_normal

from twinbench.data.recording import Recording
from twinbench.mismatch import Verdict, diagnose
from twinbench.mismatch.calibrate import block_noise, calibrated
from twinbench.mismatch.fit import Problem
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.naming.input_noise import FELT, InputNoise, Moves
from twinbench.mismatch.noisy_inputs import find_noisy_inputs
from twinbench.mismatch.sensors import SensorNoise
from twinbench.mismatch.series import steadied
from twinbench.mismatch.steps import settle_step
from twinbench.mismatch.tracks import prepare
from twinbench.physics.simulator import Array

VOLTAGE = CHANNELS.index("voltage_V")
SD_V = 3.0
NOTHING_TOLD = np.zeros(len(MOTOR.inputs))


def noisy(recording: Recording, seed: int, sd_V: float = SD_V) -> Recording:
    values = recording.values.copy()
    values[:, VOLTAGE] += sd_V * np.random.default_rng(seed).normal(size=len(values))
    return replace(recording, values=values)


def fitted(recordings: Sequence[Recording]) -> tuple[Problem, Array]:
    machine, tracks = Machine(MOTOR, []), prepare(recordings, MOTOR)
    floor = block_noise(tracks, MOTOR)
    settle_step(machine, tracks, floor)
    problem, z = calibrated(machine, tracks, floor)
    return problem, z


@functools.cache
def healthy() -> Verdict:
    """A sound motor whose voltage is recorded with noise of 1.5 % of what it reaches."""
    many = [noisy(record(f"run_{k}", k, seconds=60.0), 1000 + k) for k in range(3)]
    return diagnose(MOTOR, many[:2], many[2:])


def test_a_healthy_machine_is_not_blamed_for_the_noise_of_an_inputs_record():
    verdict = healthy()
    assert not verdict.diagnosis.named
    assert verdict.verdict in ("consistent", "parameter change")
    assert any("the record of voltage_v has a noise of" in p.lower() for p in verdict.points)
    (one,) = verdict.to_dict()["noisy_inputs"]
    assert one["name"] == "voltage_V"
    assert one["sd"] == pytest.approx(SD_V, rel=0.1)


def test_its_parameters_are_those_of_the_machine():
    """By the noise as it is recorded, the inductance comes out ten standard deviations too large."""
    null = healthy().diagnosis.answer.naming.null
    for k, u in enumerate(null.problem.unknowns):
        if u.kind == "parameter":
            true = TRUE.get(u.name, u.mean)
            assert abs(null.at[k] - true) < 3.0 * np.sqrt(null.cov[k, k]) * u.sd, u.name


@pytest.mark.slow
def test_play_is_still_named_where_the_record_is_noisy():
    def with_play(recording: Recording, gap_V: float = 40.0) -> Recording:
        values = recording.values.copy()
        given = values[0, VOLTAGE]
        for k, wanted in enumerate(values[:, VOLTAGE]):
            given = min(max(given, wanted - 0.5 * gap_V), wanted + 0.5 * gap_V)
            values[k, VOLTAGE] = given
        return replace(recording, values=values)

    # The machine runs on what comes through the play; what was asked for is recorded.
    asked = [record(f"run_{k}", k) for k in range(3)]
    through = [driven(one, with_play(one).values[:, VOLTAGE], 50 + k) for k, one in enumerate(asked)]
    verdict = diagnose(MOTOR, [noisy(r, 2000 + k) for k, r in enumerate(through[:2])], through[2:])
    assert {n for f in verdict.findings for n in f.names} == {"backlash@voltage_V"}


def driven(asked: Recording, voltage_V: Array, seed: int) -> Recording:
    """What the motor does under another voltage than is recorded, with fresh noise of the sensors."""
    track = prepare([replace(asked, values=np.column_stack((voltage_V, asked.values[:, 1:])))], MOTOR)
    machine = Machine(MOTOR, [])
    settle_step(machine, track, np.ones(len(MOTOR.outputs)))
    theta = np.array([TRUE.get(v.name, v.nominal) for v in MOTOR.parameters])
    machine.theta[: len(theta)] = theta
    problem = Problem(machine, track, (), np.ones(len(MOTOR.outputs)))
    y = problem.readings(0, np.empty(0)) + np.random.default_rng(seed).normal(size=track[0].y.shape)
    return replace(asked, values=np.column_stack((asked.values[:, : len(MOTOR.inputs)], y)))


def test_an_exact_record_is_left_as_it_is():
    assert find_noisy_inputs(*fitted([record("run", 5)]), NOTHING_TOLD) == ()


def test_noise_that_is_told_is_taken_as_told():
    told = np.array([2.5, 0.0])
    (found,) = find_noisy_inputs(*fitted([noisy(record("run", 5), 6)]), told)
    assert (found.name, found.sd) == ("voltage_V", 2.5)


def test_noise_that_is_told_widens_what_is_said_of_the_parameters():
    """Also where the record shows none that could be taken off."""
    many = [record(f"run_{k}", k, seconds=60.0) for k in range(3)]
    widths = []
    for told in ({}, {"voltage_V": 5.0}):
        null = diagnose(MOTOR, many[:2], many[2:], (), measured=told).diagnosis.answer.naming.null
        at = [u.name for u in null.problem.unknowns].index("R_ohm")
        widths.append(np.sqrt(null.cov[at, at]))
    assert widths[1] > 1.2 * widths[0]


def test_a_record_whose_rows_are_in_a_wrong_order_is_no_noise():
    """Without it the motor would be driven by next to nothing, which fits better than what it was not driven by."""
    recording = record("run", 5)
    values = recording.values.copy()
    values[:, VOLTAGE] = np.random.default_rng(0).permutation(values[:, VOLTAGE])
    assert find_noisy_inputs(*fitted([replace(recording, values=values)]), NOTHING_TOLD) == ()


def test_what_really_shakes_the_machine_is_no_noise():
    """The same shaking, but the motor feels it."""
    asked = noisy(record("run", 6), 7, sd_V=10.0)
    assert find_noisy_inputs(*fitted([driven(asked, asked.values[:, VOLTAGE], 8)]), NOTHING_TOLD) == ()


def test_spikes_that_the_machine_did_not_get_are_taken_off():
    recording = record("run", 5)
    values, at = recording.values.copy(), np.array([100, 300, 700, 1100])
    values[at, VOLTAGE] += 150.0
    spiky = replace(recording, values=values)
    problem, z = fitted([spiky])
    (found,) = find_noisy_inputs(problem, z, NOTHING_TOLD)
    assert (found.name, found.many) == ("voltage_V", len(at))
    off = found.off(problem.tracks[0]).u[:, VOLTAGE]
    np.testing.assert_array_equal(off[at], recording.values[at - 1, VOLTAGE])


def test_pulses_that_drive_the_machine_stay():
    recording = record("run", 5)
    values = recording.values.copy()
    values[[100, 300, 700, 1100], VOLTAGE] += 150.0
    pulsed = replace(recording, values=values)
    assert find_noisy_inputs(*fitted([driven(pulsed, values[:, VOLTAGE], 9)]), NOTHING_TOLD) == ()


def test_noise_of_one_input_is_found_beside_shaking_of_another():
    """Taking both off would make the readings far less likely."""
    load = CHANNELS.index("load_Nm")
    asked = record("run", 6)
    values = asked.values.copy()
    values[:, load] += 5.0 * np.random.default_rng(3).normal(size=len(values))
    felt = driven(replace(asked, values=values), values[:, VOLTAGE], 8)
    assert [n.name for n in find_noisy_inputs(*fitted([noisy(felt, 4)]), NOTHING_TOLD)] == ["voltage_V"]


def test_steps_stay_and_noise_goes():
    steps = np.repeat([0.0, 15.0, -5.0, 20.0], 50)
    rough = steps + np.random.default_rng(0).normal(size=len(steps))
    smooth = steadied(rough, 1.0, 8.0)
    assert np.sqrt(np.mean((smooth - steps) ** 2)) < 0.4
    np.testing.assert_allclose(steadied(steps, 1.0, 8.0), steps, atol=1e-3)


def test_whitening_by_the_inputs_noise_is_that_by_the_dense_covariance():
    rng = np.random.default_rng(1)
    moves, columns = rng.normal(size=(40, 15)), rng.normal(size=(40, 3))
    white = InputNoise.of(moves).whitened(columns)
    whole = np.linalg.inv(np.eye(40) + moves @ moves.T)
    np.testing.assert_allclose(white.T @ white, columns.T @ whole @ columns, rtol=1e-8)


def test_what_the_readings_hardly_feel_of_an_inputs_noise_is_left_out():
    """So products of whitened columns change by less than the variance that is left out."""
    rng = np.random.default_rng(4)
    left, right = (np.linalg.qr(rng.normal(size=(n, 12)))[0] for n in (40, 15))
    moves = left * np.geomspace(10.0, 0.01, 12) @ right.T
    turn = InputNoise.felt(aslinearoperator(moves))
    np.testing.assert_allclose(turn.T @ turn, np.eye(turn.shape[1]), atol=1e-12)
    assert turn.shape[1] == np.sum(np.geomspace(10.0, 0.01, 12) ** 2 > FELT)
    columns = rng.normal(size=(40, 3))
    kept, whole = (InputNoise.of(m).whitened(columns) for m in (moves @ turn, moves))
    largest = np.linalg.eigvalsh(kept.T @ kept - whole.T @ whole).max()
    assert 0.0 < largest < FELT * np.linalg.eigvalsh(columns.T @ columns).max()


def test_noise_that_the_readings_do_not_feel_at_all_is_none():
    columns = np.random.default_rng(5).normal(size=(40, 3))
    moves = np.full((40, 6), 1e-4)
    np.testing.assert_array_equal(
        InputNoise.of(moves @ InputNoise.felt(aslinearoperator(moves))).whitened(columns), columns
    )


def test_few_combinations_that_are_felt_are_those_among_all():
    rng = np.random.default_rng(6)
    left, right = (np.linalg.qr(rng.normal(size=(n, 200)))[0] for n in (300, 200))
    moves = left * np.geomspace(3.0, 1e-4, 200) @ right.T
    turn = InputNoise.felt(aslinearoperator(moves))
    variances, whole = np.linalg.eigh(moves.T @ moves)
    whole = whole[:, variances > FELT]
    assert 0 < whole.shape[1] < 50
    np.testing.assert_allclose(turn @ turn.T, whole @ whole.T, atol=1e-8)


def test_noise_is_followed_along_the_run_and_back():
    """The transpose is one: also over gaps, and where blocks are joined of several stretches."""
    problem, z = fitted([record("run", 9, seconds=240.0)])
    course, rng = problem.course(0, z), np.random.default_rng(7)
    residuals = rng.normal(size=course.clean.shape)
    noise = SensorNoise(*rng.uniform(0.5, 3.0, (3, residuals.shape[1])))
    residuals[10:14, 0] = np.nan
    moves = Moves(course, np.array([2.0, 0.3])).whitened(noise, residuals)
    assert moves.shape[1] > 2 * course.clean.shape[0], "blocks are in parts"
    forth, back = rng.normal(size=moves.shape[1]), rng.normal(size=moves.shape[0])
    assert back @ moves.matvec(forth) == pytest.approx(forth @ moves.rmatvec(back), rel=1e-9)
    several = rng.normal(size=(moves.shape[1], 300))
    singly = np.stack([moves.matvec(several[:, k]) for k in (0, 299)], axis=1)
    np.testing.assert_allclose(moves.matmat(several)[:, [0, 299]], singly, atol=1e-12)


def test_draws_of_the_inputs_noise_are_of_its_posterior():
    rng = np.random.default_rng(2)
    moves, seen = rng.normal(size=(30, 4)), rng.normal(size=30)
    noise = InputNoise.of(moves)
    draws = np.array([noise.drawn(seen, rng) for _ in range(4000)])
    cov = np.linalg.inv(np.eye(4) + moves.T @ moves)
    mean = cov @ (moves.T @ seen)
    np.testing.assert_allclose(draws.mean(axis=0), mean, atol=5.0 * np.sqrt(cov.max() / 4000))
    np.testing.assert_allclose(np.cov(draws.T), cov, atol=0.15 * cov.max())
    assert multivariate_normal(mean, cov).logpdf(draws).mean() == pytest.approx(
        -2.0 * np.log(2.0 * np.pi) - 0.5 * np.linalg.slogdet(cov)[1] - 2.0, abs=0.1
    )


def test_what_the_noise_of_an_input_does_to_the_readings_is_what_runs_say():
    """The sum over all stretches is what an input does that is off by a constant."""
    problem, z = fitted([record("run", 9, seconds=60.0)])
    course = problem.course(0, z)
    sds = np.array([2.0, 0.0])
    summed = Moves(course, sds).of(np.sqrt(course.grid.samples)[:, None])[:, :, 0]
    u = problem.tracks[0].u.copy()
    u[:, 0] += sds[0]
    moved = replace(problem, tracks=[replace(problem.tracks[0], u=u)], offsets=())
    by_runs = moved.course(0, z).clean - course.clean
    np.testing.assert_allclose(summed, by_runs, atol=0.02 * np.abs(by_runs).max())
