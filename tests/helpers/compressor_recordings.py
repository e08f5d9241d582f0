"""Short recordings of the compressor, and a DeepONet-Kalman trained on them for a moment."""

from __future__ import annotations

from functools import cache

import numpy as np

from twinbench.data.batch import Batch, Truth
from twinbench.machines.compressor import HEALTH, SAMPLE_PERIOD_S
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.physics.compressor import PLANT
from twinbench.physics.integrate import Varying, simulate
from twinbench.physics.steady import steady_state, valve_for


def small_batch(seed: int, sequences: int = 3, samples: int = 2600) -> Batch:
    """Load steps and drifting health, light white noise."""
    rng = np.random.default_rng(seed)
    n = samples + 1
    pieces = n // 200 + 1
    N = np.repeat(rng.uniform(900, 1800, (sequences, pieces)), 200, axis=1)[:, :n]
    ratio = np.repeat(rng.uniform(2.1, 5.0, (sequences, pieces)), 200, axis=1)[:, :n]
    p = np.repeat(rng.uniform(0.82, 1.08, (sequences, pieces)), 200, axis=1)[:, :n]
    u = np.stack([p, np.full_like(p, 298.0), N, valve_for(N, ratio)], axis=-1)
    healthy, worn = np.array([1, 1, 0.015, 1, 0.0]), np.array([0.88, 0.9, 0.052, 0.65, 5.0])
    share = rng.random((sequences, 1, 5)) * np.linspace(0, 1, n)[None, :, None]
    health = healthy + share * (worn - healthy)
    x0 = np.stack([steady_state(PLANT, u[b, 0]) for b in range(sequences)])
    x, y = simulate(PLANT, u, x0, varying=Varying(HEALTH, health))
    clean = np.concatenate([u, y], axis=-1)
    noise = np.array([1e-3, 0.2, 1.5, 0.0, 0.01, 0.6, 1e-3])
    measured = clean + noise * rng.normal(size=clean.shape)
    names = tuple(f"small-{seed}-{b}" for b in range(sequences))
    return Batch(names, np.arange(n) * SAMPLE_PERIOD_S, measured, Truth(x, health, y, u))


@cache
def trained_twin() -> DeepONetKalman:
    """As the contract trains it, on ``small_batch(1)``; once for a process. Nobody may change it."""
    train = small_batch(1)
    twin = DeepONetKalman(**DeepONetKalman.contract_settings)
    twin.fit(train, train, seed=0)
    return twin
