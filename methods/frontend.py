"""The front end that every estimator shares: spike gate, gap filling, standardisation.

A Hampel precheck rejects isolated samples beyond six robust standard deviations; a shift that lasts
two samples is let through, because it may be a real change. Gaps are filled with the last accepted
value and told apart by a mask and an age. An output that repeats itself, without even a sensor's noise,
is stuck, and what it reads is missing. Causal: a tick sees its own and earlier samples only.

What the gate holds back for a sample and then lets through, it has known a sample too late. So each
tick says, too, what is now known of the tick before: who forecasts from there, forecasts from the truth.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numba import njit

from twinbench.data.batch import Array, Batch

HAMPEL_WINDOW = 11
"""Samples in the Hampel window, the present one included."""
THRESHOLD = 6.0
STUCK_S = 3.0
"""An output that reads the same for so long is stuck, unless it did so in training. An input may well be constant."""
PLAUSIBLE_SPREADS = 10.0
"""Training spreads around the training mean: what lies beyond is no reading, however long it lasts
(a historian's -9999, an open circuit, another unit)."""


class Memory(NamedTuple):
    """What the front end carries from tick to tick, B machines of C channels.

    Attributes:
        recent: (B, HAMPEL_WINDOW, C) raw samples in the channels' units, inputs first, newest last; NaN before the
            first and where missing.
        filled: (B, C) last accepted values in the channels' units, inputs first.
        age_s: (B, C) seconds since then; inf before the first.
        outlier: (B, C) dimensionless, sign of the previous sample's rejection, 0 if none.
        last: (B, C) last raw readings in the channels' units, inputs first.
        still: (B, C) how many readings before them were the same, in samples.
    """

    recent: Array
    filled: Array
    age_s: Array
    outlier: Array
    last: Array
    still: Array


class Fitted(NamedTuple):
    """What the gate knows of the channels, and how strict it is.

    Attributes:
        mean: (C,) means of the training readings in the channels' units, inputs first.
        scale: (C,) their spreads in the channels' units, inputs first.
        floor: (C,) least noise sd that the gate assumes in the channels' units, inputs first.
        still: (C,) samples: so many readings in a row that are the same, from which on a sensor is stuck.
        threshold: of the Hampel precheck, robust standard deviations.
        period_s: from tick to tick.
    """

    mean: Array
    scale: Array
    floor: Array
    still: Array
    threshold: float
    period_s: float


class Clean(NamedTuple):
    """One tick after the gate.

    Attributes:
        filled: (B, C) accepted or last accepted values in the channels' units, inputs first; never NaN.
        accepted: (B, C) bool, was it taken?
        spike: (B, C) bool, rejected by the gate.
        age_s: (B, C) seconds since each channel was last accepted.
        before: (B, C) values of the tick before, as they are known now, in the channels' units, inputs first.
    """

    filled: Array
    accepted: np.ndarray
    spike: np.ndarray
    age_s: Array
    before: Array


@njit(cache=True)
def _median(a, n):  # type: ignore[no-untyped-def]
    """Median of the first n entries of a, sorted in place; n is small."""
    for i in range(1, n):
        value = a[i]
        j = i - 1
        while j >= 0 and a[j] > value:
            a[j + 1] = a[j]
            j -= 1
        a[j + 1] = value
    return a[n // 2] if n % 2 else 0.5 * (a[n // 2 - 1] + a[n // 2])


@njit(cache=True)
def gate_one(m, fitted, measured, accepted, spike, confirmed, before, kept):  # type: ignore[no-untyped-def]
    """Advance one machine by one tick, in place. The function takes plain arrays because it is compiled.

    Args:
        m: its Memory, without the leading axis.
        fitted: a Fitted.
        measured: (C,) the tick's readings in the channels' units, inputs first; NaN means missing.
        accepted: (C,) bool, is written: was the reading taken?
        spike: (C,) bool, is written: was it rejected as an isolated spike?
        confirmed: (C,) bool, is written: was the reading of the tick before held back, and rightly there?
        before: (C,) is written: the values of the tick before, what is confirmed put right, in the channels' units.
        kept: (HAMPEL_WINDOW,) is scratch.
    """
    window, channels = m.recent.shape
    for c in range(channels):
        for i in range(window - 1):
            m.recent[i, c] = m.recent[i + 1, c]
        value = measured[c]
        m.recent[window - 1, c] = value
        accepted[c] = False
        spike[c] = False
        confirmed[c] = False
        before[c] = m.filled[c]
        m.age_s[c] += fitted.period_s
        if np.isnan(value):
            continue
        m.still[c] = m.still[c] + 1.0 if value == m.last[c] else 0.0
        m.last[c] = value
        if m.still[c] >= fitted.still[c]:
            m.recent[window - 1, c] = np.nan
            continue
        if abs(value - fitted.mean[c]) > PLAUSIBLE_SPREADS * fitted.scale[c]:
            m.recent[window - 1, c] = np.nan
            spike[c] = True
            continue
        n = 0
        for i in range(window):
            if not np.isnan(m.recent[i, c]):
                kept[n] = m.recent[i, c]
                n += 1
        median = _median(kept, n)
        for i in range(n):
            kept[i] = abs(kept[i] - median)
        spread = 1.4826 * _median(kept, n)
        deviation = value - median
        sign = 0.0
        if n >= 5 and abs(deviation) > fitted.threshold * max(spread, fitted.floor[c]):
            sign = 1.0 if deviation > 0.0 else -1.0
        if sign != 0.0 and m.outlier[c] != sign:
            spike[c] = True
        else:
            earlier = m.recent[window - 2, c]
            if sign != 0.0 and m.age_s[c] > 1.5 * fitted.period_s and not np.isnan(earlier):
                confirmed[c] = True
                before[c] = earlier
            accepted[c] = True
            m.filled[c] = value
            m.age_s[c] = 0.0
        m.outlier[c] = sign


@njit(cache=True)
def _gate(memory, fitted, measured, accepted, spike, confirmed, before):  # type: ignore[no-untyped-def]
    """Advance all machines by one tick, in place."""
    kept = np.empty(HAMPEL_WINDOW)
    for b in range(measured.shape[0]):
        one = Memory(
            memory.recent[b], memory.filled[b], memory.age_s[b], memory.outlier[b], memory.last[b], memory.still[b]
        )
        gate_one(one, fitted, measured[b], accepted[b], spike[b], confirmed[b], before[b], kept)


@njit(cache=True)
def _gate_sequence(memory, fitted, measured, hindsight, out, accepted, ages):  # type: ignore[no-untyped-def]
    ok = np.empty(memory.filled.shape, np.bool_)
    spike, confirmed, before = np.empty_like(ok), np.empty_like(ok), np.empty_like(memory.filled)
    for k in range(measured.shape[1]):
        _gate(memory, fitted, measured[:, k], ok, spike, confirmed, before)
        out[:, k] = memory.filled
        accepted[:, k] = ok
        ages[:, k] = memory.age_s
        if hindsight and k > 0:
            out[:, k - 1] = before
            accepted[:, k - 1] |= confirmed


def _longest_run(readings: Array) -> int:
    """Of readings (B, N) that are the same as the one before them."""
    same = np.pad(np.diff(readings, axis=1) == 0.0, ((0, 0), (1, 1)))
    edges = np.flatnonzero(np.diff(same.ravel().astype(np.int8)))
    return int(np.max(edges[1::2] - edges[::2], initial=0))


class FrontEnd:
    """Fitted on the training split; ``step`` for one tick, ``run`` for whole sequences, same numbers.

    Attributes:
        mean: (C,) means of the training readings in the channels' units, inputs first.
        scale: (C,) their spreads in the channels' units, inputs first.
        floor: (C,) least noise sd that the gate assumes in the channels' units, inputs first.
        still: (C,) samples: so many readings in a row that are the same, from which on a sensor is stuck.
        period_s: from tick to tick.
        threshold: of the Hampel precheck, robust standard deviations; inf leaves it out.
    """

    def __init__(
        self, mean: Array, scale: Array, floor: Array, still: Array, period_s: float, threshold: float = THRESHOLD
    ) -> None:
        self.mean, self.scale, self.floor, self.still = mean, scale, floor, still
        self.period_s, self.threshold = period_s, threshold

    @property
    def fitted(self) -> Fitted:
        """For compiled code."""
        return Fitted(self.mean, self.scale, self.floor, self.still, self.threshold, self.period_s)

    @classmethod
    def fit(cls, train: Batch) -> Self:
        """Channel means and spreads, and the noise floor from the median step between samples."""
        channels, period_s = train.measured.shape[-1], train.machine.sample_period_s
        flat = train.measured.reshape(-1, channels)
        mean, spread = np.nanmean(flat, axis=0), np.nanstd(flat, axis=0)
        steps = np.abs(np.diff(train.measured[:, ::1], axis=1)).reshape(-1, channels)
        floor = np.nanmedian(steps, axis=0) / (0.6745 * np.sqrt(2.0))
        scale = np.maximum(spread, 1e-9)
        still = np.full(channels, np.inf)
        for c in range(len(train.machine.inputs), channels):
            still[c] = max(STUCK_S / period_s, 2.0 * _longest_run(train.measured[..., c]))
        return cls(mean, scale, np.maximum(floor, 0.01 * scale), still, period_s)

    def arrays(self) -> dict[str, Array]:
        """What is learnt, for ``Estimator.arrays``."""
        return {f"front.{name}": getattr(self, name) for name in Fitted._fields[:4]} | {
            "front.period_s": np.array(self.period_s)
        }

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray], threshold: float = THRESHOLD) -> Self:
        """The inverse of ``arrays``.

        Args:
            arrays: by name, what ``arrays`` gave: one per field of Fitted, in its units.
            threshold: of the Hampel precheck.
        """
        mean, scale, floor, still = (arrays[f"front.{name}"] for name in Fitted._fields[:4])
        return cls(mean, scale, floor, still, float(arrays["front.period_s"]), threshold)

    def init(self, batch: int) -> Memory:
        """Before the first sample: the training means stand in."""
        n = len(self.mean)
        return Memory(
            np.full((batch, HAMPEL_WINDOW, n), np.nan),
            np.tile(self.mean, (batch, 1)),
            np.full((batch, n), np.inf),
            np.zeros((batch, n)),
            np.full((batch, n), np.nan),
            np.zeros((batch, n)),
        )

    def step(self, memory: Memory, measured: Array) -> tuple[Memory, Clean]:
        """Gate and fill one tick (B, C); ``memory`` is not changed.

        Args:
            memory: of the tick before.
            measured: (B, C) readings in the channels' units, inputs first; NaN means missing.
        """
        after = Memory(*(part.copy() for part in memory))
        accepted, spike, confirmed = (np.empty(measured.shape, dtype=np.bool_) for _ in range(3))
        measured, before = np.asarray(measured, dtype=np.float64), np.empty(measured.shape)
        _gate(after, self.fitted, measured, accepted, spike, confirmed, before)
        return after, Clean(after.filled, accepted, spike, after.age_s, before)

    def run(self, measured: Array, hindsight: bool = False) -> tuple[Array, np.ndarray, Array]:
        """Whole sequences (B, N, C): filled values, accepted mask, ages in seconds, same shape.

        Args:
            measured: (B, N, C) readings in the channels' units, inputs first; NaN means missing.
            hindsight: values and mask of each tick as they are known one tick later.
        """
        filled = np.empty(measured.shape)
        accepted = np.empty(measured.shape, dtype=np.bool_)
        ages = np.empty(measured.shape)
        measured = np.ascontiguousarray(measured)
        _gate_sequence(self.init(len(measured)), self.fitted, measured, hindsight, filled, accepted, ages)
        return filled, accepted, ages

    def standardise(self, filled: Array) -> Array:
        """Zero mean, unit spread on the training split, (..., C).

        Args:
            filled: (..., C) values in the channels' units, inputs first.
        """
        return (filled - self.mean) / self.scale
