"""The benchmark as simulated: its size, its ranges, the same bits twice, and nothing leaks between parts."""

from __future__ import annotations

import hashlib
from itertools import combinations

import numpy as np
import pytest

from twinbench.data.benchmark import PARTS, DesignConfig, Split, design, fingerprint, run, simulate_benchmark
from twinbench.data.corrupt import Corruption
from twinbench.machines.compressor import COMPRESSOR, N_LIMITS_RPM, P_SUC_LIMITS_BAR

PAIRS = tuple(combinations(PARTS, 2))
PAPERS = {"train": 26, "validation": 20, "calibration": 40, "test": 70}
SOME = 3
"""One sequence of so many is simulated."""
RATIO_RANGE = (2.05, 5.0)
"""What comes of RATIO_LIMITS as suction and health change, but for 0.1 % at either end."""
SMALL = DesignConfig(n_train=2, n_validation=1, n_calibration=1, n_test=2, n_single=0, minutes=2.0, warmup_minutes=0.5)


@pytest.fixture(scope="module", params=[pytest.param(1, marks=pytest.mark.slow), SOME], ids=["all", "some"])
def one_of(request):
    return request.param


@pytest.fixture(scope="module")
def split(one_of):
    """The paper's numbers are checked on what is really simulated: one sequence of so many of each part."""
    warmup_minutes = DesignConfig().warmup_minutes
    return Split(**{part: run(scenarios[::one_of], warmup_minutes) for part, scenarios in design().items()})


@pytest.fixture(scope="module")
def small():
    return simulate_benchmark(SMALL)


def parts(split):
    return {part: getattr(split, part) for part in PARTS}


def test_the_papers_numbers(split, one_of):
    assert {part: len(scenarios) for part, scenarios in design().items()} == PAPERS
    simulated = {part: (len(range(0, n, one_of)), 30_000, 7) for part, n in PAPERS.items()}
    assert {part: b.measured.shape for part, b in parts(split).items()} == simulated
    for batch in parts(split).values():
        assert batch.truth.estimated.shape == (len(batch), 30_000, len(COMPRESSOR.quantities))
        assert batch.truth.outputs.shape == (len(batch), 30_000, len(COMPRESSOR.outputs))
        assert np.allclose(np.diff(batch.time_s), 0.05)
        assert np.isfinite(batch.truth.states).all()


def test_speed_suction_and_pressure_ratio_span_the_papers_ranges(split):
    u = np.concatenate([b.truth.inputs.reshape(-1, 4) for b in parts(split).values()])
    y = np.concatenate([b.truth.outputs.reshape(-1, 3) for b in parts(split).values()])
    for values, (low, high) in ((u[:, 2], N_LIMITS_RPM), (u[:, 0], P_SUC_LIMITS_BAR), (y[:, 0] / u[:, 0], RATIO_RANGE)):
        least, most = np.percentile(values, [0.1, 99.9])
        assert low <= least < most <= high
        assert most - least > 0.9 * (high - low)


def test_no_sequence_is_shared_between_parts(split, one_of):
    names = [name for b in parts(split).values() for name in b.names]
    contents = [hashlib.sha256(row.tobytes()).hexdigest() for b in parts(split).values() for row in b.measured]
    paths = [hashlib.sha256(row.tobytes()).hexdigest() for b in parts(split).values() for row in b.truth.states]
    assert len(names) == len(set(names)) == len(set(contents)) == len(set(paths))
    assert len(names) == sum(len(range(0, n, one_of)) for n in PAPERS.values())


@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_not_even_a_sample_is_shared_between_parts(split, one, other):
    a, b = (getattr(split, part).measured[..., COMPRESSOR.channels.index("p_dis_bar")] for part in (one, other))
    assert len(np.intersect1d(a[~np.isnan(a)], b[~np.isnan(b)])) == 0


@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_no_load_path_or_change_of_one_part_is_seen_in_another(one, other):
    scenarios = design()
    for field in ("N_rpm", "ratio", "p_suc_bar"):
        a, b = ({tuple(knot) for s in scenarios[part] for knot in getattr(s.drive, field)} for part in (one, other))
        assert not a & b
    a, b = ({(c.begin_s, c.end) for s in scenarios[part] for c in s.changes} for part in (one, other))
    assert not a & b


def test_sensors_of_two_sequences_err_independently(split):
    errors = []
    for batch in parts(split).values():
        error = batch.measured[0, :, 4:] - batch.truth.outputs[0]
        errors.append(np.clip(np.nan_to_num(error / np.nanstd(error, axis=0)), -3.0, 3.0).ravel())
    assert np.abs(np.corrcoef(errors) - np.eye(len(errors))).max() < 0.05


def test_the_same_seed_gives_the_same_bits(small):
    again = simulate_benchmark(SMALL)
    other = simulate_benchmark(DesignConfig(**{**SMALL.__dict__, "seed": SMALL.seed + 1}))
    for part in PARTS:
        assert fingerprint(getattr(again, part)) == fingerprint(getattr(small, part))
        assert fingerprint(getattr(other, part)) != fingerprint(getattr(small, part))


def test_a_sequence_alone_is_the_sequence_among_others(small):
    last = design(SMALL)["test"][-1]
    alone = run((last,), SMALL.warmup_minutes)
    assert fingerprint(alone) == fingerprint(small.test.select([1]))


def test_worse_sensors_leave_the_machine_as_it_was(small):
    worse = simulate_benchmark(SMALL, Corruption(noise=3.0, dropout=0.2))
    assert np.array_equal(worse.test.truth.states, small.test.truth.states)
    assert np.isnan(worse.test.measured).mean() > 0.15


def test_the_fingerprint_sees_every_array(small):
    batch = small.test
    seen = {fingerprint(batch), fingerprint(batch.without_truth()), fingerprint(batch.select([1, 0]))}
    for array in (batch.truth.health, batch.truth.inputs, batch.measured):
        before = array[0, 5].copy()
        array[0, 5] += 1.0
        seen.add(fingerprint(batch))
        array[0, 5] = before
    assert len(seen) == 6


def test_truth_and_readings_belong_together(small):
    batch = small.test
    clean = np.concatenate([batch.truth.inputs, batch.truth.outputs], axis=-1)
    assert np.nanmedian(np.abs(batch.measured / clean - 1.0)) < 0.005
    assert np.array_equal(batch.truth.outputs[..., 0], batch.truth.states[..., COMPRESSOR.estimated.index("p_exh_bar")])
    assert np.array_equal(batch.truth.estimated[..., -len(COMPRESSOR.health) :], batch.truth.health)


def test_select_takes_sequences_and_samples_of_everything(small):
    some = small.train.select([1], slice(10, 20))
    assert some.names == small.train.names[1:]
    assert np.array_equal(some.time_s, small.train.time_s[10:20])
    assert np.array_equal(some.measured, small.train.measured[1:, 10:20], equal_nan=True)
    for field in ("states", "health", "outputs", "inputs"):
        assert np.array_equal(getattr(some.truth, field), getattr(small.train.truth, field)[1:, 10:20])
    assert np.shares_memory(small.train.select(slice(1, 2)).measured, small.train.measured)
    assert small.train.without_truth().select([0]).truth is None


def test_without_truth_keeps_the_readings_and_the_original(small):
    blind = small.train.without_truth()
    assert blind.truth is None
    assert blind.measured is small.train.measured
    assert small.train.truth is not None
    assert len(blind) == len(small.train) == 2
