"""What is left of the errors that is no noise: the part that a black box can foretell from the operating point.

A noise model learnt from residuals takes what is left over for noise. But noise cannot be foretold
from inputs and simulated readings of other stretches of the recordings; left-out physics can.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.model_selection import GroupKFold, cross_val_predict

from mismatch.tracks import Track, held
from physics.simulator import Array

PIECES = 8
"""Contiguous pieces of each recording; one is foretold from the others."""
MEMORIES = (0.01, 0.05)
"""Time constants of the lagged features, in lengths of the shortest recording."""
TREES, LEAF = 60, 20


def foretold(tracks: Sequence[Track], residuals: Sequence[Array]) -> list[Array]:
    """The part (B, ny) of block-mean residuals that the rest of the recordings foretells; 0 where nothing is read."""
    shortest = min(len(t.starts) for t in tracks)
    features = np.concatenate([_features(t, r, shortest) for t, r in zip(tracks, residuals, strict=True)])
    target = np.nan_to_num(np.concatenate(list(residuals)))
    pieces = np.concatenate([
        r * PIECES + np.minimum(np.arange(len(t.starts)) * PIECES // len(t.starts), PIECES - 1)
        for r, t in enumerate(tracks)
    ])  # fmt: skip
    scale = np.maximum(target.std(axis=0), 1e-300)
    forest = ExtraTreesRegressor(TREES, min_samples_leaf=LEAF, max_features=0.5, random_state=0)
    found = cross_val_predict(forest, features, target / scale, groups=pieces, cv=GroupKFold(PIECES)) * scale
    return np.split(found.reshape(target.shape), np.cumsum([len(r) for r in residuals])[:-1])


def leftover(tracks: Sequence[Track], residuals: Sequence[Array], variance: Array) -> float:
    """Mean square of the residuals that is no noise, in noise variances (ny,), mean over channels; at least 0."""
    r, p = np.concatenate(list(residuals)), np.concatenate(foretold(tracks, residuals))
    gone = np.nanmean(r**2, axis=0) - np.nanmean((r - p) ** 2, axis=0)
    return float(np.nanmean(np.maximum(gone, 0.0) / variance))


def _features(track: Track, residual: Array, shortest: int) -> Array:
    """Inputs and simulated readings of each block, and the same with memory."""
    now = np.concatenate((track.coarse.u, track.means - residual), axis=1)
    now = held(now[:, np.isfinite(now).any(axis=0)])
    lagged = [
        lfilter([a], [1.0, a - 1.0], now, axis=0, zi=(1.0 - a) * now[:1])[0]
        for a in (1.0 / max(share * shortest, 1.0) for share in MEMORIES)
    ]
    return np.concatenate((now, *lagged), axis=1)
