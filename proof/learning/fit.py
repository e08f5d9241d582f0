"""The decision learnt from collected cases: weights, thresholds, and how they do on machines that were left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import chi2

from twinbench.mismatch.naming.decision import FEATURES, features, is_set, never_said
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.outcome import UNKNOWN, WRONG_NAMES
from twinbench.proof.concealed.plan import FULL

SHRINKAGE = 8.0
"""Penalty on the squares of standardised weights: one of 1 fits the chance of a few hundred findings, between 4 and 16
the loss on machines left out is the same to a hundredth."""
SLIGHT = 1e-9
"""Keeps logarithms finite."""
CONFIDENCE = 0.8
"""Confidence with which the promise is kept on other cases. What is just kept on the cases at hand is broken on others
in one of two trials, with this in one of five. At 0.9 a quarter less would be named."""
WRONG_SETS = 0.07
"""Promised rate, among sets that are said, of those without the right name: what a set of credibility 0.95 may miss and
a little for what is in no catalogue. Twice as much lets three times as many sets be said."""


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
        stands_for: (C,) dimensionless, cases of a suite that each row stands for, as ``in_the_suite`` gives them.
    """

    x: Array
    weight: Array
    weight_of_set: Array
    right: np.ndarray
    is_set: np.ndarray
    holds: np.ndarray
    group: np.ndarray
    case: np.ndarray
    stands_for: Array

    @property
    def counts(self) -> Array:
        """(n,) dimensionless, cases of a suite that each finding's row stands for."""
        return np.asarray(self.stands_for[self.case])


def in_the_suite(rows: Sequence[Mapping[str, Any]]) -> Array:
    """Cases of a suite that each row stands for, (C,), one in the mean.

    Rows may be more of what teaches more. What a verdict is promised is for the cells in their shares of the suite.
    """
    cells = [row["cell"] for row in rows]
    shares = np.array([FULL[cell] / cells.count(cell) for cell in cells])
    return shares * len(rows) / shares.sum()


def findings(rows: Sequence[Mapping[str, Any]]) -> Findings:
    """Read off collected rows, but for what is never said."""
    every = [(i, row, f) for i, row in enumerate(rows) for f in row.get("findings", ())]
    found = [one for one in every if not never_said(one[2]["evidence"])]
    return Findings(
        np.array([list(features(f["evidence"]).values()) for *_, f in found]),
        np.array([f["marginals"][0] for *_, f in found]),
        np.array([f["marginals"][1] for *_, f in found]),
        np.array([bool(set(f["alike"]) & _right(row)) for _, row, f in found]),
        np.array([is_set(f["set"], f["alike"]) for *_, f in found]),
        np.array([f["holds"][1] for *_, f in found]),
        np.array([row["machine"] for _, row, _ in found]),
        np.array([i for i, *_ in found]),
        in_the_suite(rows),
    )


def _right(row: Mapping[str, Any]) -> set[str]:
    """Names that are right in a case; none where the catalogue has none."""
    return set() if row["cell"] in UNKNOWN else {n for e in row["effects"] for n in e["class"]}


def logistic(x: Array, y: np.ndarray, share: Array, count: Array) -> Array:
    """Constant and weights (1 + F,) of a ridge regression in which nothing that speaks for speaks against.

    The probability of y is that of a logistic regression times a known share.

    Args:
        x: (n, F) dimensionless features.
        y: (n,) bool.
        share: (n,) dimensionless.
        count: (n,) dimensionless, how often each counts.
    """
    mean, spread = x.mean(axis=0), np.maximum(x.std(axis=0), 1e-9)
    z = np.column_stack((np.ones(len(x)), (x - mean) / spread))
    share = np.clip(share, 0.0, 1.0 - SLIGHT)

    def loss(w: Array) -> tuple[float, Array]:
        q = np.clip(expit(z @ w), SLIGHT, 1.0 - SLIGHT)
        # Of the share itself nothing is learnt, so a right name costs its q alone.
        slope = z.T @ (count * np.where(y, q - 1.0, share * q * (1.0 - q) / (1.0 - share * q)))
        slope[1:] += SHRINKAGE * w[1:]
        cost = -count @ np.log(np.where(y, q, 1.0 - share * q)) + 0.5 * SHRINKAGE * np.sum(w[1:] ** 2)
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
        w = logistic(found.x[~mine], found.right[~mine], found.weight[~mine], found.counts[~mine])
        p[mine] = expit(w[0] + found.x[mine] @ w[1:])
    return p


def least_probability(p: Array, wrong: np.ndarray, case: np.ndarray, stands_for: Array) -> float:
    """The least probability from which on no more than ``WRONG_NAMES`` of the verdicts hold a wrong name.

    Learn then test (Angelopoulos et al. 2021): the upper bound of the rate has to keep the promise.

    Args:
        p: (n,) dimensionless probabilities.
        wrong: (n,) bool.
        case: (n,) positions of the cases; a verdict is wrong once, however many wrong names it holds.
        stands_for: (C,) dimensionless, cases of a suite that each of them stands for.
    """
    for t in np.unique(np.concatenate((p, [0.5]))):
        seen = stands_for[np.unique(case[wrong & (p >= t)])]
        if t >= 0.5 and at_most(seen, stands_for) <= WRONG_NAMES * stands_for.sum():
            return float(t)
    return float(np.nextafter(p.max(initial=0.5), 1.0))


def least_of_a_set(q: Array, count: Array) -> float:
    """The least probability from which on sets state that at most ``WRONG_SETS`` of them are without the right name.

    What was seen does not choose it. Sets are few, so the rate that was seen goes up and down with the limit, and of
    many limits a lucky one keeps the promise. ``sets_without_it`` tells it, beside the limit.

    Args:
        q: (n,) dimensionless probabilities that the sets hold it.
        count: (n,) dimensionless, how often each counts.
    """
    for t in np.unique(q[q >= 0.5]):
        said = q >= t
        if count[said] @ (1.0 - q[said]) <= WRONG_SETS * count[said].sum():
            return float(t)
    return 1.0


def at_most(seen: Array, stands_for: Array) -> float:
    """Upper bound, with ``CONFIDENCE``, of how many are expected where rare ones were seen that count differently.

    After Tiwari, Clegg and Zou, Efficient interval estimation for age-adjusted cancer rates, Stat. Methods Med. Res. 15
    (2006). Where all count one, it is that of a Poisson count.

    Args:
        seen: (k,) dimensionless, how much each of those that were seen counts.
        stands_for: (C,) dimensionless, how much each counts of which they could be. The next one counts as these do in
            the mean.
    """
    total, squares = seen.sum() + stands_for.mean(), np.sum(seen**2) + np.mean(stands_for**2)
    return float(squares / (2.0 * total) * chi2.ppf(CONFIDENCE, 2.0 * total**2 / squares))


def learnt(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The rule as ``decision.json`` holds it, without provenance, and how it does on machines left out."""
    rows = [row for row in rows if "failed" not in row]
    found = findings(rows)
    among = left_out(found)
    p, q = among * found.weight, among * found.weight_of_set
    say_name = least_probability(p, ~found.right, found.case, found.stands_for)
    sets = found.is_set & (p < say_name)
    count = found.counts
    say_set = least_of_a_set(q[sets], count[sets])
    named = p >= say_name
    wrong = np.unique(found.case[named & ~found.right])
    return {
        "weights": _weights(logistic(found.x, found.right, found.weight, count)),
        "say_name": say_name,
        "say_set": say_set,
        "left_out": {
            "cases": len(rows),
            "findings": len(p),
            "machines": len(np.unique(found.group)),
            "right": int(found.right.sum()),
            "named": int(named.sum()),
            "named_wrong": int((named & ~found.right).sum()),
            "wrong_in_the_suite": float(found.stands_for[wrong].sum() / len(rows)),
            "sets": int((sets & (q >= say_set)).sum()),
            "sets_without_it": int((sets & (q >= say_set) & ~found.holds).sum()),
            "reliability_error": reliability_error(p, found.right, count),
        },
    }


def reliability_error(p: Array, y: np.ndarray, count: Array, bins: int = 10) -> float:
    """Mean difference of stated and seen rates over bins of equal size.

    Args:
        p: (n,) stated probabilities, dimensionless.
        y: (n,) bool.
        count: (n,) dimensionless, how often each counts.
    """
    order = np.array_split(np.argsort(p), bins)
    return float(np.sum([abs(count[i] @ (p[i] - y[i])) for i in order]) / count.sum())


def _weights(w: Array) -> dict[str, float]:
    return {"constant": float(w[0])} | {name: float(v) for name, v in zip(FEATURES, w[1:], strict=True)}
