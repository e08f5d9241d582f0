"""The sensors err as their data sheet says, each way of erring by itself."""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.common.errors import BadInput
from twinbench.data.corrupt import BURST, SPIKE_SIZE, Corruption, corrupt
from twinbench.machines.compressor import COMPRESSOR

CHANNELS, SAMPLE_PERIOD_S = COMPRESSOR.channels, COMPRESSOR.sample_period_s
SHEET, DRIFT = COMPRESSOR.noise, COMPRESSOR.drift
NOTHING = Corruption(noise=0.0, drift=0.0, dropout=0.0, spikes=0.0, jitter_s=0.0)
NOISE = Corruption(drift=0.0, dropout=0.0, spikes=0.0, jitter_s=0.0)


def steady(samples: int, N_rpm: float = 1350.0) -> np.ndarray:
    """(samples, 7) clean readings at one operating point."""
    return np.tile([0.95, 298.0, N_rpm, 0.6, 3.1, 430.0, 0.12], (samples, 1))


def read(clean: np.ndarray, level: Corruption, seed: int = 1) -> np.ndarray:
    return corrupt(COMPRESSOR, clean[:, :4], clean[:, 4:], level, np.random.default_rng(seed))


def in_sheet_units(clean: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Errors as the sheet counts them: of the reading, or in the unit."""
    return (measured - clean) / np.where([noise.relative for noise in SHEET], clean, 1.0)


def test_nothing_wrong_leaves_the_readings_alone():
    clean = steady(100) * (1.0 + 0.1 * np.sin(np.arange(100.0))[:, None])
    assert np.array_equal(read(clean, NOTHING), clean)


@pytest.mark.parametrize(("N_rpm", "factor"), [(900.0, 0.7), (1350.0, 1.0), (1800.0, 1.3)])
def test_noise_is_as_large_as_the_sheet_says_at_every_speed(N_rpm, factor):
    clean = steady(200_000, N_rpm)
    error = in_sheet_units(clean, read(clean, NOISE))
    for c, noise in enumerate(SHEET):
        expected = np.hypot(noise.white, noise.coloured) * (factor if noise.grows else 1.0)
        assert error[:, c].std() == pytest.approx(expected, rel=0.05), noise.channel
        assert abs(error[:, c].mean()) <= 0.05 * expected
    assert [n.channel for n in SHEET if n.grows] == ["p_dis_bar", "m_flow_kg_s"]


@pytest.mark.parametrize("lag_s", [0.05, 0.3, 1.5])
def test_the_coloured_part_forgets_with_its_time_constant(lag_s):
    clean = steady(400_000)
    error = in_sheet_units(clean, read(clean, NOISE))
    lag = round(lag_s / SAMPLE_PERIOD_S)
    for c, noise in enumerate(SHEET):
        kept = np.mean(error[:-lag, c] * error[lag:, c])
        expected = noise.coloured**2 * np.exp(-lag_s / noise.tau_s)
        total = noise.white**2 + noise.coloured**2
        assert kept == pytest.approx(expected, abs=0.015 * total), noise.channel


def test_channels_err_by_themselves():
    clean = steady(50_000)
    error = np.delete(read(clean, NOISE) - clean, CHANNELS.index("valve"), axis=1)
    between = np.corrcoef(error.T) - np.eye(6)
    assert np.abs(between).max() < 0.06


def test_both_pressures_share_one_slow_drift_and_nothing_else_drifts():
    later = round(0.2 * DRIFT.tau_s / SAMPLE_PERIOD_S)
    clean = steady(later + 1)
    level = Corruption(noise=0.0, dropout=0.0, spikes=0.0, jitter_s=0.0)
    ends = [in_sheet_units(clean, read(clean, level, seed))[[0, later]] for seed in range(500)]
    first, last = np.stack(ends, axis=1)
    suction, discharge = CHANNELS.index("p_suc_bar"), CHANNELS.index("p_dis_bar")
    assert np.allclose(first[:, suction], first[:, discharge], atol=1e-12)
    assert first[:, suction].std() == pytest.approx(DRIFT.share, rel=0.1)
    assert last[:, suction].std() == pytest.approx(DRIFT.share, rel=0.1)
    assert np.corrcoef(first[:, suction], last[:, suction])[0, 1] == pytest.approx(np.exp(-0.2), abs=0.06)
    others = np.delete(last, [suction, discharge], axis=1)
    assert np.abs(others).max() == 0.0


def test_jitter_shifts_all_sensors_together_and_by_its_own_size():
    t = np.arange(50_000) * SAMPLE_PERIOD_S
    rising = np.array([1e-4, 0.01, 0.1, 1e-4, 1e-3, 0.02, 1e-5])
    clean = steady(len(t)) + t[:, None] * rising
    late = (read(clean, Corruption(0.0, 0.0, 0.0, 0.0, jitter_s=0.005)) - clean) / rising
    assert late[:, 0].std() == pytest.approx(0.005, rel=0.03)
    moving = [c for c in range(7) if CHANNELS[c] != "valve"]
    assert np.allclose(late[:, moving], late[:, :1], atol=1e-7)


@pytest.mark.parametrize("level", [Corruption(), Corruption(noise=10.0, drift=10.0, spikes=0.2, jitter_s=0.02)])
def test_a_command_is_known_exactly(level):
    clean = steady(5_000) * (1.0 + 0.1 * np.sin(np.arange(5_000) / 50.0)[:, None])
    valve = read(clean, level)[:, CHANNELS.index("valve")]
    here = ~np.isnan(valve)
    assert here.mean() > 0.98
    assert np.array_equal(valve[here], clean[here, CHANNELS.index("valve")])


def test_spikes_come_as_often_and_as_high_as_told():
    clean = steady(200_000)
    level = Corruption(drift=0.0, dropout=0.0, spikes=0.02, jitter_s=0.0)
    error = in_sheet_units(clean, read(clean, level))
    for c, noise in enumerate(SHEET):
        if noise.white == 0.0:
            continue
        sds = np.abs(error[:, c]) / np.hypot(noise.white, noise.coloured)
        outside = sds > 0.5 * (SPIKE_SIZE[0] + 5.0)  # no noise comes so far, few spikes stay below
        assert outside.mean() == pytest.approx(0.02, rel=0.1), noise.channel
        assert sds.max() < SPIKE_SIZE[1] + 6.0
        assert (error[outside, c] > 0).mean() == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("share", [0.0, 0.005, 0.3, 0.99])
def test_dropout_takes_its_share_of_every_channel(share):
    missing = np.isnan(read(steady(200_000), Corruption(dropout=share)))
    assert np.allclose(missing.mean(axis=0), share, rtol=0.15)


def test_half_of_what_drops_out_does_so_in_bursts():
    missing = np.isnan(read(steady(400_000), Corruption(dropout=0.01)))
    edges = np.diff(np.concatenate([np.zeros((1, 7)), missing, np.zeros((1, 7))]), axis=0)
    lengths = np.concatenate([np.flatnonzero(edges[:, c] < 0) - np.flatnonzero(edges[:, c] > 0) for c in range(7)])
    assert lengths[lengths >= BURST].sum() / lengths.sum() == pytest.approx(0.5, abs=0.06)
    assert (lengths == 1).sum() / lengths.sum() == pytest.approx(0.5, abs=0.06)


def test_the_same_stream_corrupts_in_the_same_way_and_another_does_not():
    clean = steady(500)
    assert np.array_equal(read(clean, Corruption(), 3), read(clean, Corruption(), 3), equal_nan=True)
    assert not np.array_equal(read(clean, Corruption(), 3), read(clean, Corruption(), 4), equal_nan=True)


@pytest.mark.parametrize("name", ["noise", "drift", "dropout", "spikes", "jitter_s"])
@pytest.mark.parametrize("value", [-0.1, 101.0, float("nan")])
def test_a_level_out_of_range_is_refused(name, value):
    with pytest.raises(BadInput, match=rf"corruption: {name} is .*, must lie in \[0, "):
        Corruption(**{name: value})
