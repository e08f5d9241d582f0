"""The compiled filters against filterpy: from the same state, at every step of a whole sequence."""

import numpy as np
import pytest

from twinbench.baselines.nominal_ekf import NominalEKF
from twinbench.baselines.pinn_ukf import PINNUnscentedKalman
from twinbench.data.benchmark import DesignConfig, simulate_benchmark
from twinbench.methods.estimator import Sample

SETTINGS = {"nominal_ekf": {"calibration_minutes": 0.5}, "pinn_ukf": PINNUnscentedKalman.contract_settings}


@pytest.fixture(scope="module")
def split():
    return simulate_benchmark(
        DesignConfig(n_train=2, n_validation=1, n_calibration=1, n_test=1, n_single=0, minutes=2.0, warmup_minutes=0.5)
    )


@pytest.mark.parametrize("kind", [NominalEKF, PINNUnscentedKalman])
def test_compiled_filter_equals_filterpy_at_every_step(kind, split):
    ours, peer = kind(**SETTINGS[kind.name]), kind(**SETTINGS[kind.name], implementation="filterpy")
    ours.fit(split.train, split.validation, 0)
    if kind is PINNUnscentedKalman:  # float32 products of other shapes round differently
        for name, array in ours.arrays.items():
            if name.startswith("net."):
                ours.arrays[name] = array.astype(np.float64)
        ours.restore()
    peer.arrays = ours.arrays
    peer.restore()
    state = ours.init(1)
    for k in range(split.test.measured.shape[1]):
        sample = Sample(split.test.time_s[k], split.test.measured[:, k])
        other, other_info = peer.step(state, sample)
        state, info = ours.step(state, sample)
        sd = np.sqrt(np.diagonal(state.cov[0]))
        np.testing.assert_allclose(other.mean[0] / sd, state.mean[0] / sd, rtol=1e-9, atol=1e-9, err_msg=f"tick {k}")
        np.testing.assert_allclose(other.cov[0] / sd[:, None] / sd, state.cov[0] / sd[:, None] / sd, atol=1e-9)
        np.testing.assert_allclose(other_info.nis, info.nis, rtol=1e-8)
