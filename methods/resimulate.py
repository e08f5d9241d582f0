"""Training sequences run again with loads recombined and other health: the offline generator of all learners.

What a learner must not do is remember which wear went with which load, nor which suction with which
speed. So the plant runs again: the speed of one training sequence, the pressure ratio of another,
the suction of two more, under health paths drawn anew, with sensors drawn anew. Open to every
estimator, as the single transitions of ``methods.transitions`` are.
"""

from __future__ import annotations

import numpy as np

from twinbench.data.batch import HEALTH, SAMPLE_PERIOD_S, Array, Batch, Truth
from twinbench.data.corrupt import Corruption, corrupt
from twinbench.data.population import BLOCK, courses, start_of
from twinbench.data.scenario import RATIO_LIMITS, health_of
from twinbench.physics.compressor import PLANT, U, Y
from twinbench.physics.integrate import Varying, simulate
from twinbench.physics.steady import steady_state, valve_for

VALVE_LIMITS = next((v.low, v.high) for v in PLANT.inputs if v.name == "valve")


def resimulate(train: Batch, rng: np.random.Generator, copies: int) -> Batch:
    """The training sequences and ``copies`` times as many others, with truth. Their health is the population's."""
    if train.truth is None:
        raise ValueError("re-simulation needs sequences with truth, these have none")
    batch, samples = train.measured.shape[:2]
    parts = []
    for copy in range(copies):
        u = _recombined(train.truth, rng)
        health = health_paths(batch, samples, rng)
        x0 = np.stack([steady_state(PLANT, row) for row in u[:, 0]])
        x, y = simulate(PLANT, u, x0, varying=Varying(HEALTH, health))
        measured = np.stack([corrupt(u[b], y[b], Corruption(), rng) for b in range(batch)])
        names = tuple(f"{name}-again-{copy}" for name in train.names)
        parts.append(Batch(names, train.time_s, measured, Truth(x, health, y, u)))
    return joined([train, *parts])


def _recombined(truth: Truth, rng: np.random.Generator) -> Array:
    """(B, N, 4) inputs: each of suction pressure, suction temperature, speed and ratio from any of the sequences."""
    p_suc, T_suc, N, ratio = (rng.permutation(len(truth.inputs)) for _ in range(4))
    ratios = (truth.outputs[..., Y.p_dis_bar] / truth.inputs[..., U.p_suc_bar])[ratio]
    u = truth.inputs.copy()
    for column, drawn in ((U.p_suc_bar, p_suc), (U.T_suc_K, T_suc), (U.N_rpm, N)):
        u[..., column] = truth.inputs[drawn, :, column]
    u[..., U.valve] = np.clip(valve_for(u[..., U.N_rpm], np.clip(ratios, *RATIO_LIMITS)), *VALVE_LIMITS)
    return u


def health_paths(batch: int, samples: int, rng: np.random.Generator) -> Array:
    """(B, N, 5) health of the population of worn machines, drawn anew."""
    time_s = np.arange(samples, dtype=np.float64) * SAMPLE_PERIOD_S
    paths = []
    for start in start_of(rng.random((batch, len(HEALTH)))):
        parameters = tuple(int(i) for i in rng.permutation(len(HEALTH))[: rng.choice(BLOCK)])
        paths.append(health_of(start, courses(start, parameters, 0.0, samples * SAMPLE_PERIOD_S, rng), time_s))
    return np.stack(paths)


def joined(batches: list[Batch]) -> Batch:
    """Batches of equal length as one."""
    truths = [b.truth for b in batches if b.truth is not None]
    truth = Truth(*(np.concatenate([getattr(t, f) for t in truths]) for f in ("states", "health", "outputs", "inputs")))
    names = tuple(n for b in batches for n in b.names)
    return Batch(names, batches[0].time_s, np.concatenate([b.measured for b in batches]), truth)
