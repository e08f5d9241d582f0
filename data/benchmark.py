"""The benchmark's sequences: designed, simulated, corrupted, split. The same seed, the same bits."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.data.batch import HEALTH, SAMPLE_PERIOD_S, Array, Batch, Truth
from twinbench.data.corrupt import Corruption, corrupt
from twinbench.data.scenario import KINDS, Scenario, draw, latin_hypercube, stream
from twinbench.physics.compressor import PLANT
from twinbench.physics.integrate import Varying, simulate
from twinbench.physics.steady import steady_state

PARTS = ("train", "validation", "test")


@dataclass(frozen=True)
class DesignConfig:
    """How many sequences, how long, from which seed. The defaults are the paper's."""

    seed: int = 2024
    n_train: int = 26
    n_validation: int = 6
    n_test: int = 10
    minutes: float = 30.0
    warmup_minutes: float = 5.0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("n_train", 1, 1000),
            ("n_validation", 1, 1000),
            ("n_test", 1, 1000),
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
    """Whole sequences, never parts of one, in three disjoint sets."""

    train: Batch
    validation: Batch
    test: Batch


def design(config: DesignConfig = DesignConfig()) -> dict[str, tuple[Scenario, ...]]:
    """The scenarios of each part.

    Training: half single-factor (each kind in turn), half Latin-hypercube mixes; every other
    sequence begins worn, so that a learner sees the whole range of health. Validation and test
    begin healthy, a fresh machine, which is what every filter's prior says. Test sequences combine
    one health change with load and suction transients that have nothing to do with it; every kind
    comes in turn, and the Latin hypercube spreads speed, ratio, suction and severity over each part.

    A validation or test sequence does not depend on how many others there are. Which half of training
    is single-factor does, and nothing else there.
    """
    scenarios = {}
    for part in PARTS:
        count = getattr(config, f"n_{part}")
        mixes = latin_hypercube(count, getattr(DesignConfig, f"n_{part}"), config.seed, part, "lhs")
        drawn = []
        for i in range(count):
            kind, worn = _role(part, i, count)
            drawn.append(
                draw(f"{part}-{i:02d}", kind, config.seed, config.minutes, config.warmup_minutes, worn, mixes[i])
            )
        scenarios[part] = tuple(drawn)
    return scenarios


def _role(part: str, i: int, count: int) -> tuple[str, bool]:
    """What wears in sequence i of a part, and whether it begins worn."""
    if part == "test":
        return ("capacity", "leakage", "heat_transfer", "T_bias_K", "efficiency")[i % 5], False
    if part == "validation":
        return ("mixed", "capacity", "leakage", "heat_transfer", "T_bias_K", "efficiency")[i % 6], False
    single = i < count // 2
    return (KINDS[i % (len(KINDS) - 1)] if single else "mixed"), i % 2 == 1


def run(scenarios: tuple[Scenario, ...], warmup_minutes: float, level: Corruption = Corruption()) -> Batch:
    """Simulate and corrupt scenarios of equal length; the warm-up is simulated and dropped."""
    warm = round(warmup_minutes * 60.0 / SAMPLE_PERIOD_S)
    u = np.stack([s.inputs() for s in scenarios])
    health = np.stack([s.health() for s in scenarios])
    x0 = np.stack([_nearly_settled(row) for row in u[:, 0]])
    x, y = simulate(PLANT, u, x0, varying=Varying(HEALTH, health))
    measured = np.stack(
        [corrupt(u[b], y[b], level, stream(s.seed, s.name, "sensors")) for b, s in enumerate(scenarios)]
    )
    keep = slice(warm, None)
    time_s = np.arange(u.shape[1] - warm) * SAMPLE_PERIOD_S
    return Batch(
        tuple(s.name for s in scenarios),
        time_s,
        np.ascontiguousarray(measured[:, keep]),
        Truth(*(np.ascontiguousarray(a[:, keep]) for a in (x, health, y, u))),
    )


def _nearly_settled(u0: Array) -> Array:
    """The plant's state (8,) a little off its operating point at inputs u0 (4,)."""
    return 0.98 * steady_state(PLANT, u0) + 0.02 * PLANT.initial(u0, np.array([3.0, 400.0, 0.1]), PLANT.theta())


def simulate_benchmark(config: DesignConfig = DesignConfig(), level: Corruption = Corruption()) -> Split:
    """All sequences of the benchmark."""
    return Split(*(run(scenarios, config.warmup_minutes, level) for scenarios in design(config).values()))


def fingerprint(batch: Batch) -> str:
    """sha256 over names, readings and truth."""
    digest = hashlib.sha256(repr(batch.names).encode())
    arrays = [batch.measured]
    if batch.truth is not None:
        arrays += [batch.truth.states, batch.truth.health, batch.truth.outputs, batch.truth.inputs]
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
