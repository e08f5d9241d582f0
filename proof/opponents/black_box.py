"""What calibration leaves, learnt by a black box: it predicts, and says nothing about why.

A Volterra model: ridge regression of each output's residual on inputs and simulated readings, their moving
averages, and all products of two. It runs in open loop, from what is known on held-out recordings too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.signal import lfilter
from sklearn.linear_model import RidgeCV
from sklearn.model_selection import LeaveOneGroupOut
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from twinbench.data.recording import Recording
from twinbench.mismatch.series import held
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array, Mechanism, Simulator
from twinbench.proof.opponents.base import Progress, calibrate, check_folds, quiet, told

MEMORY = (0.0, 0.01, 0.05)
"""Time constants of the moving averages, in shares of a recording."""
PENALTIES = np.logspace(0.0, 8.0, 17)


def diagnose(
    simulator: Simulator,
    recordings: Sequence[Recording],
    hold_out: Sequence[Recording] = (),
    catalogue: Sequence[Mechanism] | None = None,
    progress: Progress = quiet,
) -> dict[str, Any]:
    """Calibrate, then learn the residual; arguments as for ``mismatch.diagnose``.

    The penalty is found by leaving out one recording at a time. An output that is then predicted no better than by
    nothing is left as it is. What was seen of an input in training bounds it on held-out recordings.

    Raises:
        BadInput: as there, or one recording is all there is.
    """
    d = calibrate(simulator, recordings, hold_out, progress)
    check_folds(d)
    residuals = d.before.residuals
    X = np.concatenate([features(t, t.means - r) for t, r in zip(d.tracks, residuals, strict=True)])
    E = np.concatenate(residuals)
    recording = np.repeat(np.arange(len(residuals)), [len(r) for r in residuals])
    low, high = X.min(axis=0), X.max(axis=0)
    after = d.held_before.rmse.copy()
    for c in range(E.shape[1]):
        seen = np.isfinite(E[:, c]) & np.isfinite(X).all(axis=1)
        e, groups = E[seen, c], recording[seen]
        folds = list(LeaveOneGroupOut().split(e, e, groups))
        ridge = RidgeCV(PENALTIES, cv=folds, scoring="neg_mean_squared_error")
        model = make_pipeline(PolynomialFeatures(2, include_bias=False), StandardScaler(), ridge)
        model.fit(X[seen], e)
        if -ridge.best_score_ >= np.mean([np.mean(e[test] ** 2) for _, test in folds]):
            continue
        squares = []
        for track, residual in zip(d.held, d.held_before.residuals, strict=True):
            predicted = model.predict(np.clip(features(track, track.means - residual), low, high))
            # A correction that is constant over a block takes as much off the samples' error as off the block's.
            squares.append((residual[:, c] - predicted) ** 2 - residual[:, c] ** 2)
        after[c] = np.sqrt(max(after[c] ** 2 + np.nanmean(np.concatenate(squares)), 0.0))
    if np.array_equal(after, d.held_before.rmse):
        return told(d, "A black box predicts the residual no better than nothing.")
    unnamed: dict[str, Any] = {
        "kind": "unexplained",
        "mechanism": None,
        "port": "",
        "ports": [],
        "parameters": {},
        "since_s": None,
    }
    return told(d, "A black box predicts the residual; it names nothing.", [unnamed], after)


def features(track: Track, simulated: Array) -> Array:
    """Inputs and simulated block means (B, ny), gaps held, as they are and averaged over the past, (B, F).

    Args:
        track: the recording.
        simulated: (B, ny) block means, in the outputs' units; NaN means missing.
    """
    now = np.concatenate((track.coarse.u, held(simulated)), axis=1)
    found = []
    for share in MEMORY:
        keep = np.exp(-1.0 / (share * len(now))) if share else 0.0
        found.append(lfilter([1.0 - keep], [1.0, -keep], now, axis=0, zi=keep * now[:1])[0])
    return np.concatenate(found, axis=1)
