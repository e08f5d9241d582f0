"""What the sensors' noise looks like: an autoregression per channel, and the whitening it gives.

A test that takes coloured noise for white finds missing physics in every clean recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from twinbench.physics.simulator import Array

AUTOREGRESSION_ORDER = 3
MEMORY_BLOCKS_MOST = 15
"""Blocks that noise may remember: what lasts longer cannot be told from left-out physics, and counts as that."""
BY_CHANCE, HIGHEST_LEVEL = 1.2, 4.0
"""Noise whose variance differs by no more than so much counts as equal; more than so much is no longer noise."""
_MEMORY = 400
_AUTOREGRESSION_LEAST = 30  # readings without a gap before an autoregression is fitted at all


class Whitener(NamedTuple):
    """Per channel ``e_k = (r_k - sum_i a_i r_(k-i)) / sd``.

    Where errors last too long for noise, a is 0, and sd is that of independent errors as telling as these:
    ``sqrt(memory)`` times their own.

    Attributes:
        a: (ny, AUTOREGRESSION_ORDER) dimensionless, the autoregression of each output's errors.
        sd: (ny,) standard deviation of what it leaves, in the outputs' units.
        memory: (ny,) dimensionless, how many blocks make an independent one.
    """

    a: Array
    sd: Array
    memory: Array | float = 1.0

    def __call__(self, r: Array) -> Array:
        """Whitened residuals (B, ny) of block means, NaN where a needed one is missing; also for columns (B, ny, K).

        The first rows, which have no past, are held against the noise's whole spread.
        """
        order = self.a.shape[1]
        shape = (-1,) + (1,) * (r.ndim - 2)
        out = r.copy()
        for lag in range(1, order + 1):
            out[order:] -= self.a[:, lag - 1].reshape(shape) * r[order - lag : -lag]
        out[order:] /= self.sd.reshape(shape)
        out[:order] /= np.sqrt(self.variance() * self.memory).reshape(shape)
        return out

    def variance(self) -> Array:
        """Stationary variance (ny,) of the noise."""
        impulse = np.zeros(_MEMORY)
        impulse[0] = 1.0
        response = [lfilter([1.0], np.concatenate(([1.0], -a)), impulse) for a in self.a]
        return self.sd**2 / self.memory * np.sum(np.square(response), axis=1)


def fit_whitener(residuals: Sequence[Array], floor: Array, order: int = AUTOREGRESSION_ORDER) -> Whitener:
    """Least squares over the residuals (B, ny) of all recordings.

    Args:
        residuals: block means measured minus simulated, (B, ny) per recording, in the outputs' units.
        floor: (ny,) least standard deviation of an output, in its unit.
        order: 0 takes the errors for white.
    """
    n_channels = residuals[0].shape[1]
    a, sd, memory = np.zeros((n_channels, order)), np.ones(n_channels), np.ones(n_channels)
    for c in range(n_channels):
        series = [r[:, c] for r in residuals]
        lasts = blocks_to_forget(series) if order else 1.0
        # A smooth misfit is no noise to be whitened: that would leave the sensors' noise alone to be judged by.
        lags = order if lasts <= 2 * MEMORY_BLOCKS_MOST else 0
        rows, targets = [], []
        for x in series:
            lagged = np.stack([x[lags - i : len(x) - i] for i in range(lags + 1)], axis=-1)
            lagged = lagged[np.isfinite(lagged).all(axis=1)]
            targets.append(lagged[:, 0])
            rows.append(lagged[:, 1:])
        X, y = np.concatenate(rows), np.concatenate(targets)
        if lags and len(y) >= _AUTOREGRESSION_LEAST:
            a[c, :lags] = _stable(np.linalg.lstsq(X, y, rcond=None)[0])
        else:
            memory[c] = lasts
        e = y - X @ a[c, :lags] if len(y) else np.concatenate(series)
        e = e[np.isfinite(e)]
        own = float(np.sqrt(np.mean(e**2))) if len(e) else 1.0
        sd[c] = max(own, float(floor[c]), 1e-300) * np.sqrt(memory[c])
    return Whitener(a, sd, memory)


def blocks_to_forget(series: Sequence[Array]) -> float:
    """Blocks that make one independent reading: the sum of autocorrelations up to the first that is not positive.

    Args:
        series: errors of one output, (B,) per recording, in any unit.
    """
    products, n = np.zeros(max(len(x) for x in series)), 0
    for x in series:
        known = np.nan_to_num(x)
        spectrum = np.abs(np.fft.rfft(known, 2 * len(x))) ** 2
        products[: len(x)] += np.fft.irfft(spectrum)[: len(x)]
        n += int(np.isfinite(x).sum())
    if n < _AUTOREGRESSION_LEAST or products[0] <= 0.0:
        return 1.0
    rho = products / products[0]
    end = int(np.argmax(rho <= 0.0)) or len(rho)
    return float(max(1.0, 1.0 + 2.0 * np.sum(rho[1:end])))


def _stable(a: np.ndarray) -> np.ndarray:
    """The autoregression shrunk until its slowest memory is no longer than ``MEMORY_BLOCKS_MOST`` blocks."""
    slowest = np.abs(np.roots(np.concatenate(([1.0], -a)))).max(initial=0.0)
    shrink = min(1.0, np.exp(-1.0 / MEMORY_BLOCKS_MOST) / max(slowest, 1e-12))
    return np.asarray(a * shrink ** np.arange(1, len(a) + 1))


def levels(fitted: Sequence[Array], held: Sequence[Array]) -> list[Array]:
    """Variance (ny,) of the noise of each held-out recording, that of the fitted ones being 1.

    Many a sensor's noise grows with its reading, and another regime has other readings. A model that leaves no more
    than that noise must not be blamed for it. Less noise than usual, and what may be chance, counts as usual.

    Args:
        fitted: residuals of one model on the recordings that it was fitted to, (B, ny) per recording, in the
            outputs' units.
        held: its residuals on the held-out recordings, likewise.
    """
    usual = noise_floor(fitted)
    known = np.where(usual > 0.0, usual, np.inf)
    found = [np.minimum((noise_floor([r]) / known) ** 2, HIGHEST_LEVEL) for r in held]
    return [np.where(level > BY_CHANCE, level, 1.0) for level in found]


def noise_floor(means: Sequence[Array]) -> Array:
    """Standard deviation (ny,) of block means by their second differences, median over windows of twenty.

    A signal that moves smoothly leaves nothing in second differences; the noise leaves six times its
    variance. White noise is assumed, so coloured noise is underrated: a floor, no estimate.

    Args:
        means: block means, (B, ny) per recording, in the outputs' units.
    """
    n_channels = means[0].shape[1]
    out = np.empty(n_channels)
    for c in range(n_channels):
        squares = []
        for y in means:
            second = y[2:, c] - 2.0 * y[1:-1, c] + y[:-2, c]
            windows = np.array_split(second**2, max(1, len(second) // 20))
            squares += [np.nanmean(w) for w in windows if np.isfinite(w).any()]
        out[c] = np.sqrt(np.median(squares) / 6.0) if squares else 0.0
    return out
