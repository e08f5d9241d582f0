"""The benchmark's sequences: designed, simulated, corrupted, split. The same seed, the same bits."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.data.batch import Batch, Truth
from twinbench.data.corrupt import Corruption, corrupt
from twinbench.data.fresh import MIX, draw
from twinbench.data.population import worn_machines
from twinbench.data.scenario import Scenario, latin_hypercube, stream
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.machine import Machine
from twinbench.physics.integrate import Varying, simulate

PARTS = ("train", "validation", "calibration", "test")
SINGLE = "single"
"""What the names of the paper's recordings begin with."""
SINGLE_KINDS = ("capacity", "leakage", "heat_transfer", "T_bias_K", "efficiency")


@dataclass(frozen=True)
class DesignConfig:
    """How many sequences, how long, from which seed.

    Attributes:
        n_train, n_validation, n_calibration, n_test: recordings of worn machines in each part. Learners fit the first,
            settings are chosen on the second, intervals are calibrated on the third.
        n_single: the paper's recordings, which join the test part as a stratum of their own.
    """

    seed: int = 2024
    n_train: int = 26
    n_validation: int = 20
    n_calibration: int = 40
    n_test: int = 60
    n_single: int = 10
    minutes: float = 30.0
    warmup_minutes: float = 5.0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("n_train", 1, 1000),
            ("n_validation", 1, 1000),
            ("n_calibration", 1, 1000),
            ("n_test", 1, 1000),
            ("n_single", 0, 1000),
            ("minutes", 1.0, 600.0),
            ("warmup_minutes", 0.0, 60.0),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise BadInput(f"design: {name} is {value}, must lie in [{low}, {high}]")
        if self.warmup_minutes >= self.minutes:
            raise BadInput(
                f"design: warmup_minutes is {self.warmup_minutes}, must be shorter than minutes, {self.minutes}"
            )


@dataclass(frozen=True)
class Split:
    """Whole sequences, never parts of one, in four disjoint sets."""

    train: Batch
    validation: Batch
    calibration: Batch
    test: Batch


def design(config: DesignConfig = DesignConfig(), machine: Machine = COMPRESSOR) -> dict[str, tuple[Scenario, ...]]:
    """The scenarios of each part, all of the population of worn machines.

    The test part also holds the paper's recordings: a fresh machine, one health change, and load and suction
    transients that have nothing to do with it; every parameter comes in turn.

    A sequence does not depend on how many others there are.
    """
    parts = {}
    for part in PARTS:
        usual = getattr(DesignConfig, f"n_{part}")
        lengths = config.minutes, config.warmup_minutes
        parts[part] = worn_machines(machine, part, getattr(config, f"n_{part}"), usual, config.seed, *lengths)
    if machine is COMPRESSOR:  # the paper's recordings are of no other
        parts["test"] += _fresh(config)
    return {part: tuple(scenarios) for part, scenarios in parts.items()}


def _fresh(config: DesignConfig) -> list[Scenario]:
    mixes = latin_hypercube(config.n_single, DesignConfig.n_single, MIX, config.seed, "test", "lhs")
    lengths = config.minutes, config.warmup_minutes
    return [
        draw(f"{SINGLE}-{i:02d}", SINGLE_KINDS[i % len(SINGLE_KINDS)], config.seed, *lengths, mix)
        for i, mix in enumerate(mixes)
    ]


def run(scenarios: tuple[Scenario, ...], warmup_minutes: float, level: Corruption = Corruption()) -> Batch:
    """Simulate and corrupt scenarios of one machine and equal length; the warm-up is simulated and dropped."""
    machine = scenarios[0].machine
    period_s = machine.sample_period_s
    warm = round(warmup_minutes * 60.0 / period_s)
    u = np.stack([s.inputs() for s in scenarios])
    health = np.stack([s.health() for s in scenarios])
    x0 = np.stack([machine.at_first(row) for row in u[:, 0]])
    x, y = simulate(machine.plant, u, x0, dt_s=period_s, varying=Varying(machine.health_names, health))
    measured = np.stack(
        [corrupt(machine, u[b], y[b], level, stream(s.seed, s.name, "sensors")) for b, s in enumerate(scenarios)]
    )
    keep = slice(warm, None)
    return Batch(
        tuple(s.name for s in scenarios),
        np.arange(u.shape[1] - warm) * period_s,
        np.ascontiguousarray(measured[:, keep]),
        Truth(*(np.ascontiguousarray(a[:, keep]) for a in (x, health, y, u))),
        machine,
    )


def simulate_benchmark(
    config: DesignConfig = DesignConfig(), level: Corruption = Corruption(), machine: Machine = COMPRESSOR
) -> Split:
    """All sequences of the benchmark."""
    return Split(*(run(scenarios, config.warmup_minutes, level) for scenarios in design(config, machine).values()))


def fingerprint(batch: Batch) -> str:
    """sha256 over names, readings and truth."""
    digest = hashlib.sha256(repr(batch.names).encode())
    arrays = [batch.measured]
    if batch.truth is not None:
        arrays += [batch.truth.states, batch.truth.health, batch.truth.outputs, batch.truth.inputs]
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
