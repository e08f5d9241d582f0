"""The compressor's record holds the numbers that the benchmark had before it knew of other machines."""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.machines.compressor import COMPRESSOR
from twinbench.physics.compressor import M_REF_KG_S

OUTPUT_NOISE = {
    "p_dis_bar": (0.0040, 0.0025, 0.4, True, True),
    "T_dis_K": (0.6, 0.4, 3.0, False, False),
    "m_flow_kg_s": (0.008, 0.005, 0.6, True, True),
}
INPUT_NOISE = {"p_suc_bar": (0.0015, True), "T_suc_K": (0.2, False), "N_rpm": (1.5, False), "valve": (0.0, False)}


def test_names_and_their_order():
    assert COMPRESSOR.inputs == ("p_suc_bar", "T_suc_K", "N_rpm", "valve")
    assert COMPRESSOR.outputs == ("p_dis_bar", "T_dis_K", "m_flow_kg_s")
    assert COMPRESSOR.channels == COMPRESSOR.inputs + COMPRESSOR.outputs
    assert COMPRESSOR.estimated == ("p_int_bar", "p_exh_bar", "T_gas_K", "T_wall_K", "flow_memory")
    assert COMPRESSOR.health_names == ("capacity", "efficiency", "leakage", "heat_transfer", "T_bias_K")
    assert COMPRESSOR.quantities == COMPRESSOR.estimated + COMPRESSOR.health_names
    assert COMPRESSOR.sample_period_s == 0.05


def test_a_life_and_how_health_wanders():
    assert COMPRESSOR.span == pytest.approx([0.12, 0.10, 0.037, 0.35, 6.0])
    assert COMPRESSOR.health_walk == pytest.approx([4e-4, 4e-4, 1.2e-4, 2e-3, 0.05])
    fresh, worn = (COMPRESSOR.start_of(np.full(5, end)) for end in (0.0, 1.0))
    assert fresh == pytest.approx([1.0, 1.0, 0.015, 1.0, -3.0])
    assert worn == pytest.approx([0.88, 0.90, 0.052, 0.65, 3.0])


def test_what_networks_are_shown():
    low, high = COMPRESSOR.counterfactual
    assert low == pytest.approx([0.86, 0.88, 0.008, 0.60, -7.0])
    assert high == pytest.approx([1.03, 1.03, 0.060, 1.06, 7.0])
    assert COMPRESSOR.states_spread == pytest.approx([0.006, 0.06, 6.0, 8.0, 0.04])


def test_states_wander_and_the_flow_stays_above_nothing():
    assert COMPRESSOR.states_walk == pytest.approx([1e-3, 1e-3, 0.05, 0.05, 1e-3, 0.01, 1e-4, 0.05])
    low, _ = COMPRESSOR.state_bounds
    assert low[COMPRESSOR.estimated.index("flow_memory")] == 0.05


def test_the_data_sheet():
    for noise in COMPRESSOR.noise:
        if noise.channel in INPUT_NOISE:
            assert (noise.white, noise.relative) == INPUT_NOISE[noise.channel]
            assert noise.grows is None
        else:
            grows = noise.grows is not None
            own = (noise.white, noise.coloured, noise.tau_s, noise.relative, grows)
            assert own == OUTPUT_NOISE[noise.channel]
    growth = next(n.grows for n in COMPRESSOR.noise if n.grows)
    N_rpm = np.array([900.0, 1350.0, 1800.0])
    assert growth.factor(N_rpm) == pytest.approx(0.7 + 0.6 * (N_rpm - 900.0) / 900.0)
    drift = COMPRESSOR.drift
    assert (drift.channels, drift.share, drift.tau_s) == (("p_suc_bar", "p_dis_bar"), 0.0008, 300.0)


def test_readings_of_estimates():
    mean = np.array([0.93, 3.1, 430.0, 355.0, 1.1, 1.0, 1.0, 0.015, 1.0, 2.5])
    assert COMPRESSOR.observe(mean) == pytest.approx([3.1, 432.5, 1.1 * M_REF_KG_S])
    assert COMPRESSOR.observe(np.tile(mean, (3, 2, 1))).shape == (3, 2, 3)


def test_a_ratio_of_channels():
    channels = np.array([[1.0, 300.0, 1350.0, 0.6, 3.3, 430.0, 0.12]])
    assert COMPRESSOR.along("p_dis_bar/p_suc_bar", channels) == pytest.approx([3.3])
    assert COMPRESSOR.along("N_rpm", channels) == pytest.approx([1350.0])
