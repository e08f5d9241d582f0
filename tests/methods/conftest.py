"""A state of the augmented filter, for every test of it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from augmented_filter import ALIKE, OFF, SIZE

from twinbench.machines.compressor import COMPRESSOR
from twinbench.methods.deeponet_kalman.layout import pack
from twinbench.methods.deeponet_kalman.model import model_of
from twinbench.methods.deeponet_kalman.safeguards import Envelope
from twinbench.methods.operator import Operator
from twinbench.methods.training import weights_of


@pytest.fixture(scope="module")
def problem():
    torch.manual_seed(1)
    weights = pack(COMPRESSOR, weights_of(Operator()))
    rng = np.random.default_rng(0)
    A = rng.normal(size=(SIZE, SIZE)) * 1e-3
    scales = (
        np.array([0.92, 3.2, 440.0, 352.0, 0.9]),
        np.array([0.07, 0.7, 32.0, 11.0, 0.19]),
        np.array([0.003, 0.0065, 0.53, 0.0023, 0.0083]),
    )
    envelope = Envelope(np.full(5, -3.0), np.full(5, 3.0))
    model = model_of(COMPRESSOR, scales, A @ A.T, 0.999, OFF, envelope, ALIKE)._replace(
        noise_keep=np.array([0.88, 0.98, 0.92]),
        zeta_low=np.full(5, -10.0),
        zeta_high=np.full(5, 10.0),
        prior_sd=np.ones(5),
    )
    z = np.concatenate([model.state_mean, [435.0], rng.normal(size=SIZE - 6) * 0.1])
    B = rng.normal(size=(SIZE, SIZE))
    base = rng.normal(size=weights["from_latent_bias"].size).astype(np.float32)
    return weights, model, base, z, B @ B.T * 1e-4
