"""Where and in which regime: free forces at each port, a tree over inputs and readings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from sklearn.tree import DecisionTreeRegressor

from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.evidence import port_weights
from twinbench.mismatch.fit import Unknown
from twinbench.mismatch.structure import positions_of
from twinbench.physics.simulator import Array, Port

KNOTS_FORCE = 8
_SIZES = np.logspace(-2, 4, 25)


@dataclass(frozen=True)
class Located:
    """Ports by how much a free force there would explain, best first, and the best one's course.

    Attributes:
        ports: (port, probability): of the accepted explanations' effects, else by how much a free force explains.
        force: at the first port, per recording, times (K,) and force (K,) in the port's units per second (its units at
            a sensor).
    """

    ports: tuple[tuple[Port, float], ...]
    force: tuple[tuple[Array, Array], ...]


def locate(d: Diagnosis) -> Located:
    """Let an unknown force act at each port in turn and weigh the evidence for it (Hooker 2009, linearised)."""
    problem, z = d.before.problem, d.before.z
    residuals = problem.residuals(z)
    _, _, nuisance = problem.normal(z, residuals)
    evidence, courses = [], []
    # The balance of a position is its velocity and lacks nothing.
    exact = {Port("balance", d.simulator.states[i].name) for i in positions_of(d.simulator).values()}
    candidates = [port for port in d.machine.ports if port not in exact]
    for port in candidates:
        scale = _scale(d, port)
        free = replace(problem, unknowns=(*problem.unknowns, *_force(d, port, scale)))
        wide = np.concatenate((z, np.zeros(len(free.unknowns) - len(z))))
        which = range(len(z), len(wide))
        columns = [problem.whitener(c) for c in free.columns(wide, residuals, which)]
        G, b = problem.projected(z, residuals, nuisance, columns)
        w, V = np.linalg.eigh(G * scale**2)
        w, b = np.maximum(w, 0.0), V.T @ (b * scale)
        gains = [0.5 * float(np.sum(s * b**2 / (1.0 + s * w)) - np.sum(np.log1p(s * w))) for s in _SIZES]
        best = int(np.argmax(gains))
        evidence.append(gains[best])
        a = scale * (V @ (_SIZES[best] * b / (1.0 + _SIZES[best] * w)))
        courses.append(a)
    order = np.argsort(evidence)[::-1]
    weight = np.exp(np.clip((np.array(evidence) - max(evidence)) / 5.0, -50.0, 0.0))
    weight /= weight.sum()
    ports = tuple((candidates[i], float(weight[i])) for i in order if weight[i] > 0.01)
    if d.chosen is not None:
        # A force says where something is; a name that was accepted says so too, and better.
        ports = port_weights(d)
    first = candidates.index(ports[0][0]) if ports[0][0] in candidates else order[0]
    top = courses[first].reshape(len(d.tracks), KNOTS_FORCE)
    force = tuple((np.linspace(t.time_s[0], t.time_s[-1], KNOTS_FORCE), a) for t, a in zip(d.tracks, top, strict=True))
    return Located(ports, force)


def _scale(d: Diagnosis, port: Port) -> float:
    """A plain force: a tenth of a variable's scale; at a balance, per tenth of the longest recording's hundredth."""
    scale = 0.1 * port.variable_of(d.simulator).scale
    if port.place == "balance":
        return scale / (0.01 * max(float(t.time_s[-1] - t.time_s[0]) for t in d.tracks))
    return scale


def _force(d: Diagnosis, port: Port, scale: float) -> list[Unknown]:
    at = d.machine.force_at[port]
    return [
        Unknown(str(port), "drift", at, -np.inf, np.inf, 0.0, np.inf, scale, r, k)
        for r in range(len(d.tracks))
        for k in range(KNOTS_FORCE)
    ]


def regime(d: Diagnosis) -> str:
    """Where in the operating range the chosen explanation earns its place, in words; empty if all over it."""
    assert d.chosen is not None
    whitener = d.chosen.problem.whitener
    sd = np.sqrt(whitener.variance())
    earned, features = [], []
    before, after = d.before.problem.residuals(d.before.z), d.chosen.problem.residuals(d.chosen.z)
    for track, b, a in zip(d.tracks, before, after, strict=True):
        earned.append(np.nansum((b / sd) ** 2 - (a / sd) ** 2, axis=1))
        features.append(np.concatenate((track.u[track.starts], track.means), axis=1))
    x, y = np.concatenate(features), np.concatenate(earned)
    seen = np.isfinite(x).all(axis=1)
    x, y = x[seen], y[seen]
    total = float(y.sum())
    if len(y) < 50 or total <= 0:
        return ""
    tree = DecisionTreeRegressor(max_depth=2, min_samples_leaf=max(10, len(y) // 10), random_state=0).fit(x, y)
    leaf = tree.apply(x)
    sums = {int(i): float(y[leaf == i].sum()) for i in np.unique(leaf)}
    best = max(sums, key=lambda i: sums[i] / np.sum(leaf == i))
    share, part = sums[best] / total, float(np.mean(leaf == best))
    if share < 0.5 or share < 1.5 * part:
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
