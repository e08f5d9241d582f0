"""What the sensors' noise looks like: an autoregression per channel, and the whitening it gives.

A test that takes coloured noise for white finds missing physics in every clean recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from physics.simulator import Array

ORDER = 3
_MEMORY = 400
_LEAST = 30  # readings without a gap before an autoregression is fitted at all


class Whitener(NamedTuple):
    """Per channel ``e_k = (r_k - sum_i a_i r_(k-i)) / sd``: a (ny, ORDER), sd (ny,)."""

    a: Array
    sd: Array

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
        out[:order] /= np.sqrt(self.variance()).reshape(shape)
        return out

    def variance(self) -> Array:
        """Stationary variance (ny,) of the noise."""
        response = np.zeros((_MEMORY, len(self.sd)))
        response[0] = 1.0
        for k in range(1, _MEMORY):
            for lag in range(1, min(k, self.a.shape[1]) + 1):
                response[k] += self.a[:, lag - 1] * response[k - lag]
        return self.sd**2 * np.sum(response**2, axis=0)


def fit_whitener(residuals: Sequence[Array], floor: Array, order: int = ORDER) -> Whitener:
    """Least squares over the residuals (B, ny) of all recordings.

    Args:
        floor: (ny,) least standard deviation of a channel.
        order: 0 leaves the colour out.
    """
    n_channels = residuals[0].shape[1]
    a, sd = np.zeros((n_channels, order)), np.ones(n_channels)
    for c in range(n_channels):
        rows, targets = [], []
        for r in residuals:
            x = r[:, c]
            lagged = np.stack([x[order - i : len(x) - i] for i in range(order + 1)], axis=-1)
            lagged = lagged[np.isfinite(lagged).all(axis=1)]
            targets.append(lagged[:, 0])
            rows.append(lagged[:, 1:])
        X, y = np.concatenate(rows), np.concatenate(targets)
        if order and len(y) >= _LEAST:
            a[c] = _stable(np.linalg.lstsq(X, y, rcond=None)[0])
        e = y - X @ a[c] if len(y) else np.concatenate([r[:, c] for r in residuals])
        e = e[np.isfinite(e)]
        sd[c] = max(float(np.sqrt(np.mean(e**2))) if len(e) else 1.0, float(floor[c]), 1e-300)
    return Whitener(a, sd)


def _stable(a: np.ndarray) -> np.ndarray:
    """The autoregression shrunk until its slowest memory is short of for ever."""
    for _ in range(60):
        roots = np.roots(np.concatenate(([1.0], -a)))
        if not len(roots) or np.abs(roots).max() < 0.98:
            return a
        a = a * 0.98 ** np.arange(1, len(a) + 1)
    return a


def noise_floor(means: Sequence[Array]) -> Array:
    """Standard deviation (ny,) of block means by their second differences, median over windows of twenty.

    A signal that moves smoothly leaves nothing in second differences; the noise leaves six times its
    variance. White noise is assumed, so coloured noise is underrated: a floor, no estimate.
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
