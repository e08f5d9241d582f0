"""What a cell of the benchmark stores: one estimator's estimates over the sequences of one split."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinbench.common.store import reading
from twinbench.machines.coordinates import Array


@dataclass(frozen=True)
class Estimates:
    """Estimates and intervals, no scores: nothing in here has seen the truth.

    B sequences, M stored ticks (every ``stride``-th of the recording), O forecast origins, L leads.

    Attributes:
        names: B sequence names.
        time_s: (M,) stored ticks, seconds.
        mean: (B, M, n) float32, in the quantities' units, the machine's states, then its health.
        low: (B, M, n) float32, lower bound of the central 95 %, in the quantities' units.
        high: (B, M, n) float32, their upper bound, likewise.
        nis: (B, M) float32, dimensionless: normalised innovation squared over the accepted channels; NaN if none.
        nis_dof: (B, M) int8, dimensionless: accepted channels.
        flags: (B, M) int16, dimensionless: bitwise or of the FLAG_ constants.
        forecast_time_s: (O,) seconds, origins, one a minute.
        leads_s: (L,) seconds, as asked: ``ticks_ahead`` says which ticks were foretold.
        forecast: (B, O, L, ny) in the channels' units: the sensors' noise-free readings predicted open
            loop.
        mean_at_origin: (B, O, n) float64, in the quantities' units, the machine's states, then its health.
        cov_at_origin: (B, O, n, n) float64, in those units squared.
        factors: (n,) dimensionless: how much wider each quantity's intervals must be, by the calibration recordings, to
            hold what they promise; NaN where nobody has asked.
    """

    estimator: str
    seed: int
    names: tuple[str, ...]
    time_s: NDArray[np.float64]
    mean: NDArray[np.float32]
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    nis: NDArray[np.float32]
    nis_dof: NDArray[np.int8]
    flags: NDArray[np.int16]
    forecast_time_s: NDArray[np.float64]
    leads_s: NDArray[np.float64]
    forecast: NDArray[np.float64]
    mean_at_origin: NDArray[np.float64]
    cov_at_origin: NDArray[np.float64]
    factors: NDArray[np.float64]

    def calibrated(self) -> Estimates:
        """The same estimates, with every interval so much wider on either side as ``factors`` says."""
        mean, low, high = (values.astype(np.float64) for values in (self.mean, self.low, self.high))
        with np.errstate(invalid="ignore"):  # an infinite bound stays one, an infinite estimate has no interval
            low, high = mean - self.factors * (mean - low), mean + self.factors * (high - mean)
        return replace(self, low=low.astype(np.float32), high=high.astype(np.float32))

    def save(self, path: Path) -> None:
        """Write one ``.npz``, without pickle."""
        about = json.dumps({"estimator": self.estimator, "seed": self.seed, "names": self.names})
        arrays = {f.name: getattr(self, f.name) for f in fields(self)[3:]}
        with open(path, "wb") as file:
            np.savez(file, allow_pickle=False, about=np.frombuffer(about.encode(), dtype=np.uint8), **arrays)

    @classmethod
    def load(cls, path: Path) -> Estimates:
        """Read what ``save`` wrote.

        Raises:
            BadInput: it is not that.
        """
        with reading(path):
            # What is no archive, NumPy would leave open.
            with open(path, "rb") as file, np.load(file, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files}
            about = json.loads(arrays.pop("about").tobytes())
            loaded = cls(about["estimator"], about["seed"], tuple(about["names"]), **arrays)
            loaded._check_shapes()
        return loaded

    def _check_shapes(self) -> None:
        ticks, n = (len(self.names), len(self.time_s)), self.mean.shape[-1]
        origins = (len(self.names), len(self.forecast_time_s))
        shapes = {
            "mean": (*ticks, n),
            "low": (*ticks, n),
            "high": (*ticks, n),
            "nis": ticks,
            "nis_dof": ticks,
            "flags": ticks,
            "forecast": (*origins, len(self.leads_s), self.forecast.shape[-1]),
            "mean_at_origin": (*origins, n),
            "cov_at_origin": (*origins, n, n),
            "factors": (n,),
        }
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, must have {shape}")


def ticks_ahead(leads_s: Array, period_s: float) -> np.ndarray:
    """How many ticks after its origin each forecast is for: at least one, where a tick lasts longer than the lead.

    Args:
        leads_s: (L,) seconds, or a single one.
        period_s: from tick to tick.
    """
    return np.maximum(np.round(leads_s / period_s).astype(int), 1)
