"""Promises of filters: implementations agree, and a linear one is the textbook's."""

from __future__ import annotations

from typing import Any

import numpy as np

from twinbench.bench.contract.outcome import NotOffered, at_most, need
from twinbench.bench.contract.promise import promise
from twinbench.bench.contract.subject import FLOAT64_ROUND_OFF, SHORT_RUN, Subject, begun, stacked, ticked
from twinbench.machines.coordinates import Array
from twinbench.methods.estimator import Estimator


@promise("its implementations agree")
def _implementations(s: Subject) -> str:
    if len(s.kind.implementations) < 2:
        raise NotOffered("it has one implementation")
    first, *others = (_as(s, name) for name in s.kind.implementations)
    # Each tick from the same state: left to themselves, finite differences let round-off grow to 1e-8.
    said: list[list[tuple[Any, ...]]] = [[] for _ in s.kind.implementations]
    measured = s.recordings["missing"][:, : 2 * SHORT_RUN]
    state = begun(first, len(measured))
    for k in range(measured.shape[1]):
        before = state
        state, info = first.step(before, s.ground.sample_at(measured, k))
        said[0].append(ticked(state, info))
        for other, column in zip(others, said[1:], strict=True):
            column.append(ticked(*other.step(before, s.ground.sample_at(measured, k))))
    traces = [stacked(column) for column in said]
    worst = max(s.deviation(traces[0], other) for other in traces[1:])
    return at_most(
        worst, FLOAT64_ROUND_OFF, f"{', '.join(s.kind.implementations)}, each tick from the same state, differ by"
    )


def _as(s: Subject, implementation: str) -> Estimator:
    estimator = s.kind(s.machine, **{**s.fitted.config, "implementation": implementation})
    # In double precision: what differs then is the method, not how float32 products are rounded.
    wide = {n: a.astype(np.float64) if a.dtype == np.float32 else a for n, a in s.fitted.arrays.items()}
    estimator.arrays = wide
    estimator.restore()
    return estimator


def textbook_filter(
    F: Array, H: Array, Q: Array, R: Array, x0: Array, P0: Array, measurements: Array
) -> tuple[Array, Array]:
    """The Kalman filter as in the textbook: means (N, n) and covariances (N, n, n) after each row of (N, m).

    x0 and P0 stand before the first prediction; NaN is missing.

    Args:
        F: (n, n) how a tick moves the state, in the states' units.
        H: (m, n) slope of the readings, a sensor's unit per unit of the state.
        Q: (n, n) covariance of a tick's process noise, in the states' units squared.
        R: (m, m) covariance of the measurement noise, in the sensors' units squared.
        x0: (n,) mean before the first prediction, each in its state's unit.
        P0: (n, n) covariance before the first prediction, in the states' units squared.
        measurements: (N, m) in the sensors' units; NaN means missing.
    """
    x, P, means, covs = x0, P0, [], []
    for y in measurements:
        x, P = F @ x, F @ P @ F.T + Q
        seen = ~np.isnan(y)
        if seen.any():
            M = H[seen]
            K = P @ M.T @ np.linalg.inv(M @ P @ M.T + R[np.ix_(seen, seen)])
            x, P = x + K @ (y[seen] - M @ x), (np.eye(len(x)) - K @ M) @ P
        means.append(x)
        covs.append(P)
    return np.array(means), np.array(covs)


@promise("on a linear-Gaussian toy it is the textbook Kalman filter")
def _toy(s: Subject) -> str:
    offered = s.kind.toy_filter
    if offered is None:
        raise NotOffered("it offers no toy_filter")
    worst = 0.0
    for seed in range(3):
        rng = np.random.default_rng(seed)
        n, m = 5, len(s.machine.outputs)
        F = 0.95 * np.linalg.qr(rng.normal(size=(n, n)))[0]
        H, q, r, p = (rng.normal(size=shape) for shape in ((m, n), (n, n), (m, m), (n, n)))
        plant = (F, H, 0.1 * q @ q.T, np.diag(r[0] ** 2 + 0.1), rng.normal(size=n), p @ p.T + np.eye(n))
        y = rng.normal(size=(200, m)) * 3.0
        y[rng.random(y.shape) < 0.2] = np.nan
        for ours, theirs in zip(offered(*plant)(y.copy()), textbook_filter(*plant, y), strict=True):
            need(ours.shape == theirs.shape, f"shape {ours.shape}, must be {theirs.shape}")
            worst = max(worst, float(np.nan_to_num(np.abs(ours - theirs), nan=np.inf).max() / np.abs(theirs).max()))
    return at_most(worst, FLOAT64_ROUND_OFF, "three plants, 200 ticks with gaps, relative deviation")
