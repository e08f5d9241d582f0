"""How far one experiment would part rivals: the expected evidence, all that is unknown free.

The blocks of the experiment are added to those of the recordings at hand. Then everything that a rival leaves open is
integrated out: parameters, starts, its own size and form, and the discrepancy, which may also grow to explain what the
rival does not. In the linear case the log evidence between two rivals is c_A^2 (G_AA - G_AB^2 / G_BB) / 2, with c_A the
size of the one that is true.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from twinbench.mismatch.design.hand import Folded, Hand, Known
from twinbench.mismatch.design.trials import Trial
from twinbench.mismatch.naming.decision import CREDIBLE
from twinbench.mismatch.naming.marginal import DISCREPANCY_PCT, factored
from twinbench.mismatch.seed import ENGINE_SEED
from twinbench.physics.simulator import Array

GROWN_PCT = (0.0, 0.1, 0.3, 0.7)
"""Sizes, in per cent, that the discrepancy may at least have beside a rival, up to its prior's sd: the likeliest one
counts, since the engine learns it anew when the experiment was made."""
EXPERIMENTS = 100
"""Simulated experiments: a probability of .9 is known to 3 points."""


class Expected(NamedTuple):
    """What is to be expected of an experiment that is made a number of times.

    Attributes:
        nats: (m, m) by which a true rival (row) is then ahead of another (column), beyond what it is now.
        names: probability that the right name stands alone afterwards, and of a wrong one.
    """

    nats: Array
    names: tuple[float, float]

    @property
    def worst(self) -> float:
        """The least of what any true rival gains on any other, nats."""
        apart = self.nats + np.where(np.eye(len(self.nats), dtype=bool), np.inf, 0.0)
        return float(apart.min())


class Part(NamedTuple):
    """What an experiment adds to one rival: readings of each truth as products, and their squares."""

    folded: Folded
    squares: Array


def truths(hand: Hand, trial: Trial) -> Array:
    """(n, m) whitened readings of each rival, were it true, with what the recordings say of all that is unknown."""
    return np.stack(
        [s.white + trial.kept(k) @ hand.truths[k][0] for k, s in enumerate(trial.shown)],
        axis=1,
    )


def nats(hand: Hand, trial: Trial, times: int = 1) -> Array:
    """(m, m) nats that the experiment, made so often, adds for a true rival (row) over another (column)."""
    readings = truths(hand, trial)
    gained = np.stack([gain(hand, k, Part(*trial.folded(k, readings)), times) for k in range(len(hand.rivals))], axis=1)
    return gained.diagonal()[:, None] - gained


def gain(hand: Hand, rival: int, part: Part, times: int = 1) -> Array:
    """(M,) nats that a rival gains by readings, beyond the evidence of the recordings at hand.

    Args:
        part: what the experiment adds to it.
    """
    known, folded = hand.known[rival], part.folded
    G = known.G + times * folded.G
    b = known.b[:, None] + times * folded.b
    log = times * (folded.log - 0.5 * part.squares)
    return log + _likeliest(hand, rival, G, b) - _likeliest(hand, rival, known.G, known.b[:, None])


def _likeliest(hand: Hand, rival: int, G: Array, b: Array) -> Array:
    """(M,) log evidence with the discrepancy as large as is likeliest for each reading."""
    known, s = hand.known[rival], hand.s[rival]
    if not len(s):
        return _evidence(hand, known, G, b, s)
    return np.max([_evidence(hand, known, G, b, np.maximum(s, least)) for least in GROWN_PCT], axis=0)


def _evidence(hand: Hand, known: Known, G: Array, b: Array, s: Array) -> Array:
    precision, mean = hand.precision(known, s), np.concatenate((known.mean, np.zeros(len(hand.group))))
    scale, L = factored(G + np.diag(precision))
    right = solve_triangular(L, scale[:, None] * (b + mean[:, None]), lower=True, check_finite=False)
    constant = 0.5 * np.log(precision).sum() - np.log(np.diag(L) / scale).sum() - 0.5 * known.mean @ known.mean
    return np.asarray(0.5 * np.sum(right**2, axis=0) + constant - 0.5 * np.sum((s / DISCREPANCY_PCT) ** 2))


def expected(hand: Hand, trial: Trial, times: int = 1) -> Expected:
    """What to expect, by simulated experiments: machines as likely as each rival has them, noise, and all evidence."""
    rng, m = np.random.default_rng(ENGINE_SEED), len(hand.rivals)
    base, right, wrong = truths(hand, trial), 0.0, 0.0
    for true, probability in enumerate(hand.probabilities):
        _, root = hand.truths[true]
        unknown = trial.kept(true) @ (root @ rng.standard_normal((root.shape[1], EXPERIMENTS)))
        noise = rng.standard_normal(unknown.shape) / np.sqrt(times)  # their mean says all that they say together
        readings = base[:, [true]] + unknown + noise
        logs = np.stack([hand.logs[k] + gain(hand, k, Part(*trial.folded(k, readings)), times) for k in range(m)])
        sure = np.exp(logs - logsumexp(logs, axis=0)) >= CREDIBLE
        right += probability * float(sure[true].mean())
        wrong += probability * float(np.delete(sure, true, axis=0).any(axis=0).mean())
    return Expected(nats(hand, trial, times), (right, wrong))
