"""In which regime what was found earns its place: a small tree over inputs and readings."""

from __future__ import annotations

import numpy as np
from sklearn.tree import DecisionTreeRegressor

from twinbench.mismatch.diagnosis import Diagnosis

LEAST_BLOCKS = 50
"""Blocks below which no regime is told."""
MOST_OF_IT, DENSER = 0.5, 1.5
"""Share of what is earned that lies in a regime, and how much more than its share of the time that is."""


def regime(d: Diagnosis) -> str:
    """Where in the operating range the mended simulator earns its place, in words; empty if all over it."""
    if d.mended is None:
        return ""
    sd, earned, features = d.noise_sd, [], []
    for track, b, a in zip(d.tracks, d.before.residuals, d.mended.residuals, strict=True):
        earned.append(np.nansum((b / sd) ** 2 - (a / sd) ** 2, axis=1))
        features.append(np.concatenate((track.u[track.starts], track.means), axis=1))
    x, y = np.concatenate(features), np.concatenate(earned)
    seen = np.isfinite(x).all(axis=1)
    x, y = x[seen], y[seen]
    total = float(y.sum())
    if len(y) < LEAST_BLOCKS or total <= 0:
        return ""
    tree = DecisionTreeRegressor(max_depth=2, min_samples_leaf=max(10, len(y) // 10), random_state=0).fit(x, y)
    leaf = tree.apply(x)
    sums = {int(i): float(y[leaf == i].sum()) for i in np.unique(leaf)}
    best = max(sums, key=lambda i: sums[i] / np.sum(leaf == i))
    share, part = sums[best] / total, float(np.mean(leaf == best))
    if share < MOST_OF_IT or share < DENSER * part:
        return ""
    names = [v.name for v in (*d.simulator.inputs, *d.simulator.outputs)]
    return " and ".join(_path(tree.tree_, best, names))


def _path(tree, leaf: int, names: list[str]) -> list[str]:  # type: ignore[no-untyped-def]
    """Conditions on the way from a tree's root to one of its leaves."""
    conditions: list[str] = []
    node = leaf
    while node != 0:
        for parent in range(tree.node_count):
            if node in (tree.children_left[parent], tree.children_right[parent]):
                sign = "<=" if node == tree.children_left[parent] else ">"
                conditions.insert(0, f"{names[tree.feature[parent]]} {sign} {tree.threshold[parent]:.4g}")
                node = parent
                break
    return conditions
