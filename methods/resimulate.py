"""Training recordings run again with loads recombined and other health: the offline generator of all learners.

What a learner must not do is remember which wear went with which load, nor which of one input with which of another. So
the plant runs again, its inputs those of several recordings, under health paths drawn anew, with sensors drawn anew.
Open to every estimator, as the single transitions of ``methods.transitions`` are.
"""

from __future__ import annotations

import numpy as np

from twinbench.data.batch import Array, Batch, Truth
from twinbench.data.corrupt import Corruption, corrupt
from twinbench.data.population import BLOCK, courses
from twinbench.data.scenario import health_of
from twinbench.machines.machine import Machine
from twinbench.physics.integrate import Varying, simulate


def resimulate(train: Batch, rng: np.random.Generator, copies: int) -> Batch:
    """The training sequences and ``copies`` times as many others, with truth. Their health is the population's."""
    if train.truth is None:
        raise ValueError("re-simulation needs sequences with truth, these have none")
    machine = train.machine
    batch, samples = train.measured.shape[:2]
    parts = []
    for copy in range(copies):
        u = (machine.recombine or _mixed)(train.truth.inputs, train.truth.outputs, rng)
        health = health_paths(machine, batch, samples, rng)
        x0 = np.stack([machine.at_first(row) for row in u[:, 0]])
        varying = Varying(machine.health_names, health)
        x, y = simulate(machine.plant, u, x0, dt_s=machine.sample_period_s, varying=varying)
        measured = np.stack([corrupt(machine, u[b], y[b], Corruption(), rng) for b in range(batch)])
        names = tuple(f"{name}-again-{copy}" for name in train.names)
        parts.append(Batch(names, train.time_s, measured, Truth(x, health, y, u), machine))
    return joined([train, *parts])


def _mixed(inputs: Array, outputs: Array, rng: np.random.Generator) -> Array:
    """Each input (B, N, nu) from any of the recordings."""
    columns = [inputs[rng.permutation(len(inputs)), :, i] for i in range(inputs.shape[-1])]
    return np.stack(columns, axis=-1)


def health_paths(machine: Machine, batch: int, samples: int, rng: np.random.Generator) -> Array:
    """(B, N, nh) health of the population of worn machines, drawn anew."""
    time_s = np.arange(samples, dtype=np.float64) * machine.sample_period_s
    n, seconds = len(machine.health), samples * machine.sample_period_s
    paths = []
    for start in machine.start_of(rng.random((batch, n))):
        parameters = tuple(int(i) for i in rng.permutation(n)[: rng.choice(BLOCK)])
        changes = courses(machine, start, parameters, 0.0, seconds, rng)
        paths.append(health_of(machine.health_names, start, changes, time_s))
    return np.stack(paths)


def joined(batches: list[Batch]) -> Batch:
    """Batches of equal length as one."""
    truths = [b.truth for b in batches if b.truth is not None]
    truth = Truth(*(np.concatenate([getattr(t, f) for t in truths]) for f in ("states", "health", "outputs", "inputs")))
    names = tuple(n for b in batches for n in b.names)
    return Batch(names, batches[0].time_s, np.concatenate([b.measured for b in batches]), truth, batches[0].machine)
