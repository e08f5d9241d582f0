"""What a trained estimator is like on machines whose truth is known, when they are read as a user's is.

The validation recordings of its run are read as seldom as the user's recording, and without the channels that it
lacks. What the estimator then says of them is what may be expected of it; how often its intervals then hold the
truth is whether that is worth having. Measured once for each manner of reading, and kept in the run's store.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from twinbench.bench import cells
from twinbench.bench.cells import Cell
from twinbench.bench.estimate.sampling import Manner, joined, read_as
from twinbench.bench.estimate.witness import Witnessed, watch
from twinbench.bench.estimates import Estimates
from twinbench.bench.statistics.aligned import truth_at
from twinbench.bench.statistics.bootstrap import INTERVAL_LEVEL
from twinbench.bench.statistics.conformal import factors
from twinbench.bench.statistics.coverage import inside
from twinbench.bench.statistics.ranked import cut_to, ranked_from
from twinbench.common.store import CannotWrite, Store, key_of, reading
from twinbench.common.versions import code_version
from twinbench.data.batch import Batch
from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine
from twinbench.methods.estimator import Estimator, State

KIND = "reference"
STRIDE = 19
"""Ticks between those at which coverage is counted, a second. A prime, so as not to keep step with seldom readings."""
ENVELOPE = (0.001, 0.999)
"""Quantiles of the training readings between which a channel is known: spikes, a five-hundredth of the readings,
lie beyond. As for the operator's own envelope."""
NIS_LEVEL = 0.999
"""Of the range in which a sound recording's median NIS is expected: one in a thousand is refused wrongly. At 0.99
the range of the nominal filter, from six recordings, would refuse sound recordings, too."""
NARROWER = 0.99
"""Width of a health interval over that at the start, below which something was learnt. The estimators that were at
their prior had 1.05 and more, those that learnt 0.8 and less in at least one parameter: anything between will do."""
PERIODS_TICKS = (1200, 600, 400, 200, 100, 40, 20, 10, 4, 2, 1)
"""Tried one after the other, from a minute down to the trained period, for the slowest at which an answer holds."""


class Envelope(NamedTuple):
    """Where the training recordings were read.

    Attributes:
        low: (nu + ny,) lower ends in the channels' units.
        high: (nu + ny,) upper ends in the channels' units.
    """

    low: Array
    high: Array

    @classmethod
    def of(cls, train: Batch) -> Envelope:
        """Of the readings, spikes apart."""
        low, high = np.nanquantile(train.measured, ENVELOPE, axis=(0, 1))
        return cls(low, high)


@dataclass(frozen=True)
class Reference:
    """An estimator over B validation recordings of N ticks.

    Attributes:
        nis: (B, N) float32, dimensionless, each over the median of its chi-square; NaN where no channel was accepted.
        off: (B, N, ny) float16, dimensionless, absolute innovation over its expected sd.
        accepted: (B, nu + ny) dimensionless, share of the readings that were used.
        covered: share of the truths, states and health, that lay in their 95 % intervals, once these are stretched so
            that they hold what they promise where every channel is read at every tick.
        factors: (n,) dimensionless, by how much they are stretched.
        narrowest: (nh,) dimensionless, typical width of the health intervals over that at the start.
    """

    nis: np.ndarray
    off: np.ndarray
    accepted: Array
    covered: float
    factors: Array
    narrowest: Array

    def save(self, path: Path) -> None:
        """Write one ``.npz``, without pickle."""
        with open(path, "wb") as file:
            np.savez_compressed(file, allow_pickle=False, **{f.name: getattr(self, f.name) for f in fields(self)})

    @classmethod
    def load(cls, path: Path, machine: Machine) -> Reference:
        """Read what ``save`` wrote of an estimator of a machine.

        Raises:
            BadInput: it is not.
        """
        with reading(path), open(path, "rb") as file, np.load(file, allow_pickle=False) as stored:
            arrays = {f.name: stored[f.name] for f in fields(cls)}
            nis, narrowest = arrays["nis"], arrays["narrowest"]
            shapes = {
                "off": (*nis.shape[:2], len(machine.outputs)),
                "accepted": (len(nis), len(machine.channels)),
                "covered": (),
                "factors": (len(machine.quantities),),
                "narrowest": (len(machine.health),),
            }
            for name, shape in shapes.items():
                if arrays[name].shape != shape:
                    raise ValueError(f"{name} has shape {arrays[name].shape}, must have {shape}")
            if not np.isfinite([*narrowest, *arrays["factors"], arrays["covered"]]).all():
                raise ValueError("it holds what is no number")
            return cls(**{**arrays, "covered": float(arrays["covered"])})

    def nis_range(self, ticks: int) -> tuple[float, float]:
        """Where the median NIS of one more recording is expected, NIS_LEVEL of the time; NaN if that is not known.

        That of a new draw from a log-normal of which there are B. Each of these counts from its start for as
        long as the new one: an estimator that begins at the prior is farther off at first.
        """
        medians = np.array([np.nanmedian(row) for row in self.nis[:, :ticks] if np.isfinite(row).any()])
        if len(medians) < 2:
            return np.nan, np.nan
        logs = np.log(np.maximum(medians, np.finfo(np.float32).tiny))
        half = student.ppf(0.5 + 0.5 * NIS_LEVEL, len(logs) - 1) * logs.std(ddof=1) * np.sqrt(1.0 + 1.0 / len(logs))
        return float(np.exp(logs.mean() - half)), float(np.exp(logs.mean() + half))


class References:
    """Of one trained estimator, for any manner of reading."""

    def __init__(self, store: Store, cell: Cell, estimator: Estimator) -> None:
        self.store, self.cell, self.estimator, self.machine = store, cell, estimator, estimator.machine
        self.every_tick: Manner = (1,) * len(self.machine.channels)  # as the estimators are trained
        split = cells.load_split(store, cell)
        self.validation, self.envelope = split.validation, Envelope.of(split.train)

    def calibrated(self) -> Array | None:
        """What intervals are stretched by so that they hold what they promise, (n,); None if the run has no such."""
        if not self.store.has("estimate", self.cell.estimates):
            return None
        found = cells.load_estimates(self.store, self.cell).factors
        return found if np.isfinite(found).all() else None

    def of(self, manner: Manner) -> Reference:
        """Measured now, or as the store keeps it."""
        cell = self.cell
        key = key_of(
            fit=cell.fit,
            online=cells.online(cell),
            manner=manner,
            code=[code_version("twinbench.bench.estimate.reference"), code_version("twinbench.bench.evaluate")],
        )
        path = self.store.path(KIND, key)
        if self.store.has(KIND, key):
            return Reference.load(path, self.machine)
        measured = joined(read_as(self.validation.measured, manner), manner, len(self.machine.inputs))
        batch = replace(self.validation, measured=measured, truth=None)
        estimates, seen = watch(self.estimator, batch, STRIDE, cell.seed)
        own = factors(estimates, self.validation) if manner == self.every_tick else self.of(self.every_tick).factors
        estimates = replace(estimates, factors=own)
        found = _summed_up(estimates, seen, self.validation, manner, self.estimator.init(1))
        try:
            self.store.put(KIND, key, found.save)
        except CannotWrite:  # a run that may only be read serves as well, only slower
            pass
        return found

    def slowest(self, manner: Manner) -> float | None:
        """Seconds between readings, the slowest that is sound for channels of ``manner``; None if none is."""
        for slower in _faster(manner):
            if sound(self.of(slower), self.of(self.every_tick)):
                return max(slower) * self.machine.sample_period_s
        return None


def sound(reference: Reference, trained: Reference) -> bool:
    """Do intervals still hold, and does it learn?

    They may miss the truth twice as often as they promise, or as they do where every channel is read at every tick.
    """
    missed = max(1.0 - trained.covered, 1.0 - INTERVAL_LEVEL)
    return learns(reference.narrowest) and 1.0 - reference.covered <= 2.0 * missed


def learns(narrowest: Array) -> bool:
    """Is any health parameter's interval narrower than at the start?

    Args:
        narrowest: (nh,) dimensionless, widths of the health intervals over those at the start.
    """
    return bool((narrowest < NARROWER).any())


def narrowing(estimates: Estimates, start: State, machine: Machine) -> Array:
    """(B, nh) widths of the health intervals over those at the start: their median over the second half."""
    health = slice(len(machine.estimated), None)
    at_first = (start.high - start.low)[:, None, health]
    late = slice(estimates.low.shape[1] // 2, None)
    width = (estimates.high - estimates.low)[:, late, health].astype(float)
    return np.median(width / np.maximum(at_first, np.finfo(float).tiny), axis=1)


def nis_ratio(seen: Witnessed) -> np.ndarray:
    """(B, N) NIS, each over the median of the chi-square of the channels that were accepted."""
    medians = np.array([np.nan, *chi2.median(np.arange(1, seen.off.shape[-1] + 1))], dtype=np.float32)
    return seen.nis / medians[seen.dof]


def _summed_up(estimates: Estimates, seen: Witnessed, validation: Batch, manner: Manner, start: State) -> Reference:
    offered = ~np.isnan(read_as(validation.measured, manner))
    accepted = (seen.accepted & offered).sum(axis=1) / np.maximum(offered.sum(axis=1), 1)
    ranked = cut_to(estimates.calibrated(), ranked_from(estimates.time_s))
    covered = float(np.nanmean(inside(ranked, truth_at(validation, ranked.names, ranked.time_s))))
    off = np.minimum(np.abs(seen.off), np.finfo(np.float16).max).astype(np.float16)
    narrowest = np.median(narrowing(estimates, start, validation.machine), axis=0)
    return Reference(nis_ratio(seen), off, accepted, covered, estimates.factors, narrowest)


def _faster(manner: Manner) -> Iterator[Manner]:
    """The same channels, read more and more often."""
    for most in PERIODS_TICKS:
        if most < max(manner):
            yield tuple(min(every, most) for every in manner)
