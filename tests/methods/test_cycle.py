"""One update: what the operator's window holds when the filter forecasts."""

from __future__ import annotations

import numpy as np
import torch
from helpers.compressor_recordings import small_batch, trained_twin

from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.deeponet_kalman.windows import WindowSource
from twinbench.methods.estimator import Sample
from twinbench.methods.frontend import FrontEnd
from twinbench.methods.operator import Operator
from twinbench.methods.training import load_weights


def test_the_window_online_is_the_one_trained_on_and_a_step_held_back_is_put_right_in_it():
    test, twin = small_batch(3, sequences=2, samples=700), trained_twin()
    operator = Operator()
    load_weights(operator, twin.arrays)
    front_end = FrontEnd.from_arrays(twin.arrays)
    source = WindowSource(test, front_end, twin.arrays["query.mean"], twin.arrays["query.scale"])
    assert not np.array_equal(source.masks, front_end.run(test.measured)[1])
    state = twin.init(2)
    for k in range(450):
        state, _ = twin.step(state, Sample(k * COMPRESSOR.sample_period_s, test.measured[:, k]))
        last = np.full(2, k - 1)
        if k in (199, 200, 201, 202, 300, 401, 402, 449):  # the load steps every 200 samples
            with torch.no_grad():
                latent = operator.latent(*source.at(np.arange(2), last), torch.full((2,), COMPRESSOR.sample_period_s))
                expected = operator.heads.from_latent(latent).numpy()
            np.testing.assert_allclose(state.memory[0]["stream"]["base"], expected, rtol=1e-4, atol=2e-4)
