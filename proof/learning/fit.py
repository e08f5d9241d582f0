"""The decision learnt from collected cases: weights, thresholds, and how they do on machines that were left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import beta

from twinbench.mismatch.naming.decision import FEATURES, features, is_set
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.outcome import UNKNOWN

SHRINKAGE = 8.0
"""Penalty on the squares of standardised weights: one of 1 fits the chance of a few hundred findings, between 4 and 16
the loss on machines left out is the same to a hundredth."""
SLIGHT = 1e-9
"""Keeps logarithms finite."""
WRONG_NAMES = 0.02
"""Promised rate of wrong names among all verdicts."""
CONFIDENCE = 0.8
"""Confidence with which the promise is kept on other cases. What is just kept on the cases at hand is broken on others
in one of two trials, with this in one of five. At 0.9 a quarter less would be named."""
WRONG_SETS = 0.07
"""Promised rate, among sets that are said, of those without the right name: what a set of credibility 0.95 may miss and
a little for what is in no catalogue. Twice as much lets a quarter more sets be said."""


class Findings(NamedTuple):
    """All findings of some cases.

    Attributes:
        x: (n, F) dimensionless features.
        weight: (n,) dimensionless share of the name, those alike counted in, among all sets that were weighed.
        weight_of_set: (n,) likewise of its set.
        right: (n,) bool, is the name right?
        is_set: (n,) bool, is it one that may be said?
        holds: (n,) bool, does it hold the right one?
        group: (n,) the machine's name, which has no unit.
        case: (n,) positions of the cases among the rows.
    """

    x: Array
    weight: Array
    weight_of_set: Array
    right: np.ndarray
    is_set: np.ndarray
    holds: np.ndarray
    group: np.ndarray
    case: np.ndarray


def findings(rows: Sequence[Mapping[str, Any]]) -> Findings:
    """Read off collected rows; echoes are never said."""
    found = [(i, row, f) for i, row in enumerate(rows) for f in row.get("findings", ()) if not f["evidence"]["echo"]]
    return Findings(
        np.array([list(features(f["evidence"]).values()) for *_, f in found]),
        np.array([f["marginals"][0] for *_, f in found]),
        np.array([f["marginals"][1] for *_, f in found]),
        np.array([bool(set(f["alike"]) & _right(row)) for _, row, f in found]),
        np.array([is_set(f["set"], f["alike"]) for *_, f in found]),
        np.array([f["holds"][1] for *_, f in found]),
        np.array([row["machine"] for _, row, _ in found]),
        np.array([i for i, *_ in found]),
    )


def _right(row: Mapping[str, Any]) -> set[str]:
    """Names that are right in a case; none where the catalogue has none."""
    return set() if row["cell"] in UNKNOWN else {n for e in row["effects"] for n in e["class"]}


def logistic(x: Array, y: np.ndarray, share: Array) -> Array:
    """Constant and weights (1 + F,) of a ridge regression in which nothing that speaks for speaks against.

    The probability of y is that of a logistic regression times a known share.

    Args:
        x: (n, F) dimensionless features.
        y: (n,) bool.
        share: (n,) dimensionless.
    """
    mean, spread = x.mean(axis=0), np.maximum(x.std(axis=0), 1e-9)
    z = np.column_stack((np.ones(len(x)), (x - mean) / spread))
    share = np.clip(share, 0.0, 1.0 - SLIGHT)

    def loss(w: Array) -> tuple[float, Array]:
        q = np.clip(expit(z @ w), SLIGHT, 1.0 - SLIGHT)
        # Of the share itself nothing is learnt, so a right name costs its q alone.
        slope = z.T @ np.where(y, q - 1.0, share * q * (1.0 - q) / (1.0 - share * q))
        slope[1:] += SHRINKAGE * w[1:]
        cost = -np.log(np.where(y, q, 1.0 - share * q)).sum() + 0.5 * SHRINKAGE * np.sum(w[1:] ** 2)
        return float(cost), slope

    bounds = [(None, None)] + [(0.0, None)] * x.shape[1]
    w = minimize(loss, np.zeros(z.shape[1]), jac=True, bounds=bounds, method="L-BFGS-B").x
    return np.concatenate(([w[0] - np.sum(w[1:] * mean / spread)], w[1:] / spread))


def left_out(found: Findings) -> Array:
    """(n,) probabilities that the right name is among those weighed.

    Each is by a rule that was learnt on all machines but the finding's own.
    """
    p = np.empty(len(found.x))
    for machine in np.unique(found.group):
        mine = found.group == machine
        w = logistic(found.x[~mine], found.right[~mine], found.weight[~mine])
        p[mine] = expit(w[0] + found.x[mine] @ w[1:])
    return p


def least_probability(p: Array, wrong: np.ndarray, case: np.ndarray, cases: int) -> float:
    """The least probability from which on no more than ``WRONG_NAMES`` of the verdicts hold a wrong name.

    Learn then test (Angelopoulos et al. 2021): the upper bound of the rate (Clopper and Pearson) has to keep the
    promise.

    Args:
        p: (n,) dimensionless probabilities.
        wrong: (n,) bool.
        case: (n,) positions of the cases; a verdict is wrong once, however many wrong names it holds.
        cases: how many there are.
    """
    for t in np.unique(np.concatenate((p, [0.5]))):
        seen = len(np.unique(case[wrong & (p >= t)]))
        if t >= 0.5 and beta.ppf(CONFIDENCE, seen + 1, cases - seen) <= WRONG_NAMES:
            return float(t)
    return float(np.nextafter(p.max(initial=0.5), 1.0))


def learnt(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The rule as ``decision.json`` holds it, without provenance, and how it does on machines left out."""
    rows = [row for row in rows if "failed" not in row]
    found = findings(rows)
    among = left_out(found)
    p, q = among * found.weight, among * found.weight_of_set
    say_name = least_probability(p, ~found.right, found.case, len(rows))
    sets = found.is_set & (p < say_name)
    say_set = 1.0
    for t in np.unique(np.concatenate(([0.5], q[sets]))):
        said = sets & (q >= t)
        if t >= 0.5 and said.any() and (np.sum(~found.holds[said]) + 1.0) / (said.sum() + 1.0) <= WRONG_SETS:
            say_set = float(t)
            break
    named = p >= say_name
    return {
        "weights": _weights(logistic(found.x, found.right, found.weight)),
        "say_name": say_name,
        "say_set": say_set,
        "left_out": {
            "cases": len(rows),
            "findings": len(p),
            "machines": len(np.unique(found.group)),
            "right": int(found.right.sum()),
            "named": int(named.sum()),
            "named_wrong": int((named & ~found.right).sum()),
            "sets": int((sets & (q >= say_set)).sum()),
            "sets_without_it": int((sets & (q >= say_set) & ~found.holds).sum()),
            "reliability_error": reliability_error(p, found.right),
        },
    }


def reliability_error(p: Array, y: np.ndarray, bins: int = 10) -> float:
    """Mean difference of stated and seen rates over bins of equal size.

    Args:
        p: (n,) stated probabilities, dimensionless.
        y: (n,) bool.
    """
    order = np.array_split(np.argsort(p), bins)
    return float(np.sum([len(i) * abs(p[i].mean() - y[i].mean()) for i in order if len(i)]) / len(p))


def _weights(w: Array) -> dict[str, float]:
    return {"constant": float(w[0])} | {name: float(v) for name, v in zip(FEATURES, w[1:], strict=True)}
