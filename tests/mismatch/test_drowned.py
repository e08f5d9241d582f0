"""A machine of which nothing shows in the readings but the noise of its sensor."""

from __future__ import annotations

import numpy as np
from tank_files import TANK, write_python

from twinbench.data.recording import Recording
from twinbench.mismatch import diagnose
from twinbench.mismatch.model import load_simulator

LEVEL_M, NOISE_M = 0.5, 0.08


def at_rest(seed: int, samples: int = 80) -> Recording:
    level = LEVEL_M + NOISE_M * np.random.default_rng(seed).normal(size=samples)
    values = np.column_stack((np.full(samples, 3.0), level))
    return Recording(f"rest_{seed}", 0.5 * np.arange(samples), ("pump_V", "h_m"), values)


def test_a_healthy_tank_at_rest_with_a_noisy_sensor_is_consistent(tmp_path):
    """No function of the discrepancy is seen, so there is none to weigh."""
    verdict = diagnose(load_simulator(write_python(tmp_path, TANK)), [at_rest(1)], [at_rest(2)])
    assert not len(verdict.diagnosis.answer.naming.ground.group)
    assert (verdict.verdict, verdict.findings) == ("consistent", ())
