"""The estimator under test, the small benchmark it is fitted to, and its runs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np

from twinbench.bench.contract.outcome import need
from twinbench.data.batch import Batch, Truth
from twinbench.data.benchmark import DesignConfig, Split, fingerprint, simulate_benchmark
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine
from twinbench.methods.estimator import Estimator, Info, Sample, State

SUBJECT_SEED = 1
USUAL_PERIOD_S = 0.05
"""The sample period that DESIGN is for: with another, recordings are longer or shorter, and have as many ticks."""
DESIGN = DesignConfig(
    seed=7, n_train=3, n_validation=1, n_calibration=1, n_test=2, n_single=0, minutes=2.5, warmup_minutes=0.5
)
FLOAT32_ROUND_OFF = 1e-5
"""Deviation allowed where only the order of summation differs: a network's float32, carried by its recursion.
Its reductions differ at 1e-7; two orders more leave room for the recursion and none for a real coupling."""
FLOAT32 = 1e-4
"""Deviation allowed where the readings come as float32 and a method goes on in float32."""
FLOAT64_ROUND_OFF = 1e-9
"""Relative deviation allowed of float64 linear algebra written in another way."""
SHORT_RUN, LONG_RUN, JUDGED_TICKS = 400, 1800, 200
"""Ticks: of a short run, of a long one, and at the end of a long one where recovery is judged."""
BEGIN = 400
"""The tick at which faults begin."""
GAP_S, BLACKOUT_S, STANDS_S = 10.0, 2.0, 30.0
"""How long a channel is missing, all are, and one is stuck: seconds as on any plant, and twenty ticks at least."""
FAULTS = ("undisturbed", "missing", "late", "spiked", "stuck")
"""The recordings that any plant may deliver; the absurd one is for the bounds alone."""


class Trace(NamedTuple):
    """What an estimator said at N ticks of B machines: the fields of State and Info.

    Attributes:
        mean: (N, B, n) in the quantities' units.
        low: (N, B, n) likewise.
        high: (N, B, n) likewise.
        cov: (N, B, n, n) in those units squared.
        innovation: (N, B, ny) in the outputs' units.
        S: (N, B, ny, ny) in those units squared.
        nis: (N, B) dimensionless.
        accepted: (N, B, ny) bool.
        flags: (N, B) integers, dimensionless: bitwise or of the FLAG_ constants.
        age_s: (N, B, nu + ny) seconds.
    """

    mean: Array
    low: Array
    high: Array
    cov: Array
    innovation: Array
    S: Array
    nis: Array
    accepted: np.ndarray
    flags: np.ndarray
    age_s: Array


class Ground:
    """What promises are tried on: a machine's small benchmark, and its two test recordings under each fault."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine

    @cached_property
    def benchmark(self) -> Split:
        """Three training, one validation and two test sequences of 2400 ticks."""
        longer = self.machine.sample_period_s / USUAL_PERIOD_S
        design = replace(
            DESIGN,
            minutes=float(np.clip(longer * DESIGN.minutes, 1.0, 600.0)),
            warmup_minutes=float(np.clip(longer * DESIGN.warmup_minutes, 0.0, 60.0)),
        )
        return simulate_benchmark(design, machine=self.machine)

    @cached_property
    def truth(self) -> Truth:
        """Of the two test sequences."""
        truth = self.benchmark.test.truth
        assert truth is not None
        return truth

    @cached_property
    def recordings(self) -> dict[str, Array]:
        """Readings (2, N, nu + ny) of the two test machines, undisturbed and under each fault."""
        channels, inputs = len(self.machine.channels), len(self.machine.inputs)
        first, last = inputs, channels - 1
        moved = self.machine.channels.index((self.machine.commands or self.machine.inputs)[0])
        clean = self.benchmark.test.measured[:, :LONG_RUN]
        gap, blackout, stood = (max(round(s / self.machine.sample_period_s), 20) for s in (GAP_S, BLACKOUT_S, STANDS_S))
        spread = np.nanstd(self.benchmark.train.measured.reshape(-1, channels), axis=0)
        missing = clean.copy()
        missing[0, BEGIN : BEGIN + gap, last] = missing[1, BEGIN : BEGIN + gap, first] = np.nan
        missing[:, BEGIN + 400 : BEGIN + 400 + blackout] = np.nan
        late = clean[:, :SHORT_RUN].copy()
        late[:, :40] = np.nan
        spiked = clean.copy()
        for i, (tick, c) in enumerate(self.spikes()):
            spiked[:, tick, c] = np.nan_to_num(clean[:, tick, c]) + (50.0 if i % 2 else -50.0) * spread[c]
        stuck = clean.copy()
        stuck[0, BEGIN : BEGIN + stood, first] = np.nanmedian(clean[0, BEGIN - 20 : BEGIN, first])
        stuck[1, BEGIN : BEGIN + stood, moved] = np.nanmedian(clean[1, BEGIN - 20 : BEGIN, moved])
        absurd = clean[:, :SHORT_RUN].copy()
        rng = np.random.default_rng(SUBJECT_SEED)
        for tick in range(40, SHORT_RUN - 100, 20):  # twenty ticks each: gates let through what lasts
            absurd[:, tick : tick + 20] = rng.choice([-1.0, 0.0, 1e-3, 10.0, 1e3, 1e6], (2, 1, channels)) * spread
        return {
            "undisturbed": clean,
            "missing": missing,
            "late": late,
            "spiked": spiked,
            "stuck": stuck,
            "absurd": absurd,
        }

    def spikes(self) -> list[tuple[int, int]]:
        """Tick and channel of each spike that is put into the spiked recording."""
        return [(BEGIN + 10 * i, i % len(self.machine.channels)) for i in range(42)]

    def sample_at(self, measured: Array, k: int) -> Sample:
        """One tick of readings, as an estimator gets it.

        Args:
            measured: (B, N, nu + ny) readings in the channels' units; NaN means missing.
            k: which tick.
        """
        return Sample(k * self.machine.sample_period_s, measured[:, k].copy())

    def future(self, after: int, length: int) -> Array:
        """Inputs (2, L, nu) of the ticks after a run of the undisturbed recording, gaps filled."""
        return self.truth.inputs[:, after : after + length].copy()


@cache
def ground_of(machine: Machine) -> Ground:
    """One for each machine, since its benchmark takes seconds."""
    return Ground(machine)


def small_benchmark(machine: Machine = COMPRESSOR) -> Split:
    """The sequences that promises are tried on, of a machine."""
    return ground_of(machine).benchmark


class Fit(NamedTuple):
    """An estimator, the copies of the sequences it was fitted to, and their fingerprints when it was done."""

    estimator: Estimator
    copies: tuple[Batch, Batch]
    fingerprints: tuple[str, ...]


class Subject:
    """An estimator under test on a machine: how it was fitted and how it ran, made when first asked for."""

    def __init__(self, kind: type[Estimator], machine: Machine = COMPRESSOR) -> None:
        self.kind, self.machine, self.ground = kind, machine, ground_of(machine)
        self._traces: dict[str, Trace] = {}

    @property
    def recordings(self) -> dict[str, Array]:
        """Readings (2, N, nu + ny) of the two test machines, undisturbed and under each fault."""
        return self.ground.recordings

    @property
    def fitted(self) -> Estimator:
        """Fitted on the small benchmark."""
        return self._first.estimator

    @cached_property
    def again(self) -> Fit:
        """Fitted once more, on the same sequences with the same seed."""
        return self._fit()

    @cached_property
    def _first(self) -> Fit:
        return self._fit()

    def fit_with(self, seed: int, **settings: Any) -> Estimator:
        """Fitted on the small benchmark with that seed, and with other settings than the contract's."""
        split = self.ground.benchmark
        estimator = self.kind(self.machine, **{**self.kind.contract_settings, **settings})
        estimator.fit(split.train, split.validation, seed)
        return estimator

    def _fit(self) -> Fit:
        split = self.ground.benchmark
        copies = (_copied(split.train), _copied(split.validation))
        estimator = self.kind(self.machine, **self.kind.contract_settings)
        estimator.fit(*copies, SUBJECT_SEED)
        return Fit(estimator, copies, tuple(fingerprint(batch) for batch in copies))

    def trace(self, name: str) -> Trace:
        """The run over one of the recordings."""
        if name not in self._traces:
            self._traces[name] = record(self.fitted, self.recordings[name])
        return self._traces[name]

    def state_after(self, estimator: Estimator, measured: Array) -> State:
        """The state after the last of the readings.

        Args:
            measured: (B, N, nu + ny) readings in the channels' units; NaN means missing.
        """
        state = begun(estimator, len(measured))
        for k in range(measured.shape[1]):
            state, _ = estimator.step(state, self.ground.sample_at(measured, k))
        return state

    def deviation(self, a: Trace, b: Trace) -> float:
        """Largest gap of estimates, intervals and covariances; inf where one is NaN.

        The unit is a typical change or the standard deviation, whichever is larger: a wide prior has no finer
        round-off.
        """
        sd = np.sqrt(np.maximum(np.diagonal(a.cov, axis1=-2, axis2=-1), 0.0))
        unit = np.maximum(sd, self.machine.scales)
        gaps = [(getattr(a, part) - getattr(b, part)) / unit for part in ("mean", "low", "high")]
        gaps.append((a.cov - b.cov) / (unit[..., :, None] * unit[..., None, :]))
        return max(float(np.nan_to_num(np.abs(gap), nan=np.inf).max()) for gap in gaps)

    def finite(self, trace: Trace) -> None:
        """Broken unless all that is reported is finite."""
        for name in ("mean", "low", "high", "cov"):
            values = getattr(trace, name)
            bad = ~np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
            at_s = np.argmax(bad) * self.machine.sample_period_s
            need(not bad.any(), f"{name} is not finite from {at_s:.2f} s on")


def begun(estimator: Estimator, machines: int) -> State:
    """The state before the first sample; not of its shape, it would make everything that follows slow."""
    state = estimator.init(machines)
    shape = np.asarray(getattr(state, "mean", None)).shape
    expected = (machines, len(estimator.machine.quantities))
    need(shape == expected, f"init gives a state whose mean has shape {shape}, must be {expected}")
    return state


def record(estimator: Estimator, measured: Array) -> Trace:
    """Step through readings from the beginning and keep everything.

    Args:
        measured: (B, N, nu + ny) readings in the channels' units; NaN means missing.
    """
    state, ground = begun(estimator, len(measured)), ground_of(estimator.machine)
    ticks = []
    for k in range(measured.shape[1]):
        state, info = estimator.step(state, ground.sample_at(measured, k))
        ticks.append(ticked(state, info))
    return stacked(ticks)


def ticked(state: State, info: Info) -> tuple[Any, ...]:
    """One tick of a trace."""
    return (state.mean, state.low, state.high, state.cov, *info)


def stacked(ticks: list[tuple[Any, ...]]) -> Trace:
    """The trace of ticks in order."""
    return Trace(*(np.stack(column) for column in zip(*ticks, strict=True)))


def same(a: Any, b: Any) -> bool:
    """Bit for bit, through tuples and the fields of records, whose padding says nothing."""
    if isinstance(a, tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    a, b = np.asarray(a), np.asarray(b)
    if a.dtype.names:
        return a.dtype == b.dtype and all(same(a[name], b[name]) for name in a.dtype.names)
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def snapshot(value: Any) -> Any:
    """A deep copy of a State, Info or Sample."""
    return tuple(snapshot(v) for v in value) if isinstance(value, tuple) else np.array(value)


def _copied(batch: Batch) -> Batch:
    assert batch.truth is not None
    truth = Truth(*(np.array(getattr(batch.truth, part)) for part in ("states", "health", "outputs", "inputs")))
    return replace(batch, measured=batch.measured.copy(), truth=truth)
