"""The estimator under test, the small benchmark it is fitted to, and its runs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np

from twinbench.bench.contract.outcome import need
from twinbench.data.batch import CHANNELS, ESTIMATED, SAMPLE_PERIOD_S, STATES, Array, Batch, Truth
from twinbench.data.benchmark import DesignConfig, Split, fingerprint, simulate_benchmark
from twinbench.methods.estimator import Estimator, Info, Sample, State
from twinbench.physics.compressor import PLANT

DESIGN = DesignConfig(
    seed=7, n_train=3, n_validation=1, n_calibration=1, n_test=2, n_single=0, minutes=2.5, warmup_minutes=0.5
)
SUBJECT_SEED = 1
SCALE = np.array([v.scale for v in (*PLANT.states[: len(STATES)], *PLANT.parameters[: len(ESTIMATED) - len(STATES)])])
"""(10,) one typical change of each estimated quantity, order ESTIMATED: the unit of all deviations."""
FLOAT32_ROUND_OFF = 1e-5
"""Deviation allowed where only the order of summation differs: a network's float32, carried by its recursion.
Its reductions differ at 1e-7; two orders more leave room for the recursion and none for a real coupling."""
FLOAT32 = 1e-4
"""Deviation allowed where the readings come as float32 and a method goes on in float32."""
FLOAT64_ROUND_OFF = 1e-9
"""Relative deviation allowed of float64 linear algebra written in another way."""
SHORT, LONG, JUDGED = (round(s / SAMPLE_PERIOD_S) for s in (20.0, 90.0, 10.0))
"""Ticks: of a short run, of a long one, and at the end of a long one where recovery is judged."""
P_DIS, FLOW, N_RPM = CHANNELS.index("p_dis_bar"), CHANNELS.index("m_flow_kg_s"), CHANNELS.index("N_rpm")


FAULTS = ("undisturbed", "missing", "late", "spiked", "stuck")
"""The recordings that any plant may deliver; the absurd one is for the bounds alone."""


class Trace(NamedTuple):
    """What an estimator said at N ticks of B machines: the fields of State and Info.

    Attributes:
        mean: (N, B, 10) in the quantities' units, order ESTIMATED.
        low: (N, B, 10) likewise.
        high: (N, B, 10) likewise.
        cov: (N, B, 10, 10) in those units squared.
        innovation: (N, B, 3) in the outputs' units, order OUTPUTS.
        S: (N, B, 3, 3) in those units squared.
        nis: (N, B) dimensionless.
        accepted: (N, B, 3) bool.
        flags: (N, B) integers, dimensionless: bitwise or of the FLAG_ constants.
        age_s: (N, B, 7) seconds, order CHANNELS.
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


@cache
def small_benchmark() -> Split:
    """Three training, one validation and two test sequences of two minutes."""
    return simulate_benchmark(DESIGN)


@cache
def recordings() -> dict[str, Array]:
    """Readings (2, N, 7) of the two test machines, undisturbed and under each fault."""
    split = small_benchmark()
    clean = split.test.measured[:, :LONG]
    spread = np.nanstd(split.train.measured.reshape(-1, len(CHANNELS)), axis=0)
    begin = 400
    missing = clean.copy()
    missing[0, begin : begin + 200, FLOW] = missing[1, begin : begin + 200, P_DIS] = np.nan
    missing[:, begin + 400 : begin + 440] = np.nan
    late = clean[:, :SHORT].copy()
    late[:, :40] = np.nan
    spiked = clean.copy()
    for i, (tick, channel) in enumerate(spikes()):
        spiked[:, tick, channel] = np.nan_to_num(clean[:, tick, channel]) + (50.0 if i % 2 else -50.0) * spread[channel]
    stuck = clean.copy()
    stuck[0, begin : begin + 600, P_DIS] = np.nanmedian(clean[0, begin - 20 : begin, P_DIS])
    stuck[1, begin : begin + 600, N_RPM] = np.nanmedian(clean[1, begin - 20 : begin, N_RPM])
    absurd = clean[:, :SHORT].copy()
    rng = np.random.default_rng(SUBJECT_SEED)
    for tick in range(40, SHORT - 100, 20):  # a second each: gates let through what lasts
        absurd[:, tick : tick + 20] = rng.choice([-1.0, 0.0, 1e-3, 10.0, 1e3, 1e6], (2, 1, len(CHANNELS))) * spread
    return {
        "undisturbed": clean,
        "missing": missing,
        "late": late,
        "spiked": spiked,
        "stuck": stuck,
        "absurd": absurd,
    }


def spikes() -> list[tuple[int, int]]:
    """Tick and channel of each spike that is put into the spiked recording."""
    return [(400 + 10 * i, i % len(CHANNELS)) for i in range(42)]


class Fit(NamedTuple):
    """An estimator, the copies of the sequences it was fitted to, and their fingerprints when it was done."""

    estimator: Estimator
    copies: tuple[Batch, Batch]
    fingerprints: tuple[str, ...]


class Subject:
    """An estimator under test: how it was fitted and how it ran, made when first asked for."""

    def __init__(self, kind: type[Estimator]) -> None:
        self.kind = kind
        self._traces: dict[str, Trace] = {}

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
        split = small_benchmark()
        estimator = self.kind(**{**self.kind.contract_settings, **settings})
        estimator.fit(split.train, split.validation, seed)
        return estimator

    def _fit(self) -> Fit:
        split = small_benchmark()
        copies = (_copied(split.train), _copied(split.validation))
        estimator = self.kind(**self.kind.contract_settings)
        estimator.fit(*copies, SUBJECT_SEED)
        return Fit(estimator, copies, tuple(fingerprint(batch) for batch in copies))

    def trace(self, name: str) -> Trace:
        """The run over one of the recordings."""
        if name not in self._traces:
            self._traces[name] = record(self.fitted, recordings()[name])
        return self._traces[name]


def record(estimator: Estimator, measured: Array) -> Trace:
    """Step through readings (B, N, 7) from the beginning and keep everything.

    Args:
        measured: (B, N, 7) readings in the channels' units, order CHANNELS; NaN means missing.
    """
    state = begun(estimator, len(measured))
    ticks = []
    for k in range(measured.shape[1]):
        state, info = estimator.step(state, sample_at(measured, k))
        ticks.append(ticked(state, info))
    return stacked(ticks)


def ticked(state: State, info: Info) -> tuple[Any, ...]:
    """One tick of a trace."""
    return (state.mean, state.low, state.high, state.cov, *info)


def stacked(ticks: list[tuple[Any, ...]]) -> Trace:
    """The trace of ticks in order."""
    return Trace(*(np.stack(column) for column in zip(*ticks, strict=True)))


def begun(estimator: Estimator, machines: int) -> State:
    """The state before the first sample; not of its shape, it would make everything that follows slow."""
    state = estimator.init(machines)
    shape = np.asarray(getattr(state, "mean", None)).shape
    expected = (machines, len(ESTIMATED))
    need(shape == expected, f"init gives a state whose mean has shape {shape}, must be {expected}")
    return state


def state_after(estimator: Estimator, measured: Array) -> State:
    """The state after the last of the readings (B, N, 7).

    Args:
        measured: (B, N, 7) readings in the channels' units, order CHANNELS; NaN means missing.
    """
    state = begun(estimator, len(measured))
    for k in range(measured.shape[1]):
        state, _ = estimator.step(state, sample_at(measured, k))
    return state


def sample_at(measured: Array, k: int) -> Sample:
    """One tick of readings, as an estimator gets it.

    Args:
        measured: (B, N, 7) readings in the channels' units, order CHANNELS; NaN means missing.
        k: which tick.
    """
    return Sample(k * SAMPLE_PERIOD_S, measured[:, k].copy())


def deviation(a: Trace, b: Trace) -> float:
    """Largest gap of estimates, intervals and covariances; inf where one is NaN.

    The unit is a typical change or the standard deviation, whichever is larger: a wide prior has no finer round-off.
    """
    unit = np.maximum(np.sqrt(np.maximum(np.diagonal(a.cov, axis1=-2, axis2=-1), 0.0)), SCALE)
    gaps = [(getattr(a, part) - getattr(b, part)) / unit for part in ("mean", "low", "high")]
    gaps.append((a.cov - b.cov) / (unit[..., :, None] * unit[..., None, :]))
    return max(float(np.nan_to_num(np.abs(gap), nan=np.inf).max()) for gap in gaps)


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


def finite(trace: Trace) -> None:
    for name in ("mean", "low", "high", "cov"):
        values = getattr(trace, name)
        bad = ~np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
        need(not bad.any(), f"{name} is not finite from {np.argmax(bad) * SAMPLE_PERIOD_S:.2f} s on")


def future(after: int, length: int) -> Array:
    """Inputs (2, L, 4) of the ticks after a run of the undisturbed recording, gaps filled."""
    truth = small_benchmark().test.truth
    assert truth is not None
    return truth.inputs[:, after : after + length].copy()
