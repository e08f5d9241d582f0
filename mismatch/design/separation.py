"""How far one experiment would part rivals: the expected evidence, all that is unknown free.

The blocks of the experiment are added to those of the recordings at hand. Then everything that a rival leaves open is
integrated out: parameters, starts, its own size and form, and the discrepancy, which may also grow to explain what the
rival does not. In the linear case the log evidence between two rivals is c_A^2 (G_AA - G_AB^2 / G_BB) / 2, with c_A the
size of the one that is true.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.special import logsumexp

from twinbench.mismatch.design.hand import Folded, Hand
from twinbench.mismatch.design.trials import Trial
from twinbench.mismatch.naming.decision import CREDIBLE
from twinbench.mismatch.seed import ENGINE_SEED
from twinbench.physics.simulator import Array

SCATTER = 2.0
"""Nats that chance moves as far as the experiment: evidence of d nats has a variance of 2 d, as both are half of one
squared distance (Buzzi-Ferraris and Forzatti 1984)."""
EXPERIMENTS = 100
"""Simulated experiments: a probability of .9 is known to 3 points."""


class Expected(NamedTuple):
    """What is to be expected of an experiment that is made a number of times.

    Attributes:
        nats: (m, m) dimensionless, by how many a true rival (row) gains on another (column).
        worst: the least of these, of rivals that can be told apart at all.
        right, wrong: probability that the right name stands alone afterwards, or with what cannot be told from it; and
            of a wrong one.
    """

    nats: Array
    worst: float
    right: float
    wrong: float


def groups_of(nats: Sequence[Array]) -> np.ndarray:
    """(m,) labels of rivals, one label for those that no experiment tells apart: chance moves more than it adds.

    Where that is all of them, each has a label of its own: none may then be taken for right.

    Args:
        nats: (m, m) dimensionless, of each experiment.
    """
    told = np.max([np.minimum(n, n.T) for n in nats], axis=0)
    many, labels = connected_components(csr_array(told < SCATTER))
    return labels if many > 1 else np.arange(len(labels))


def worst(nats: Array, groups: np.ndarray) -> float:
    """The least of what any true rival gains on any other that can be told from it; on any at all if none can.

    Args:
        nats: (m, m) dimensionless, of an experiment.
        groups: (m,) dimensionless labels of rivals.
    """
    apart = groups[:, None] != groups
    return float(nats[apart].min())


class Part(NamedTuple):
    """What an experiment adds to one rival.

    Attributes:
        folded: products of M readings with the columns of what is shared.
        squares: (M,) of the whitened readings less what the rival foretells.
    """

    folded: Folded
    squares: Array


def truths(hand: Hand, trial: Trial) -> Array:
    """(n, m) whitened readings of each rival, were it true, with what the recordings say of all that is unknown."""
    means = [trial.kept(k, hand.truths[k][0][:, None])[:, 0] for k in range(len(trial.shown))]
    return np.stack([s.white + mean for s, mean in zip(trial.shown, means, strict=True)], axis=1)


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
    return log + hand.likeliest(rival, G, b) - hand.before[rival]


def expected(hand: Hand, trial: Trial, groups: np.ndarray, times: int = 1) -> Expected:
    """What to expect, by simulated experiments: machines as likely as each rival has them, noise, and all evidence.

    Args:
        groups: (m,) dimensionless labels of rivals, one for those that no experiment tells apart.
    """
    rng, m = np.random.default_rng(ENGINE_SEED), len(hand.rivals)
    base, right, wrong = truths(hand, trial), 0.0, 0.0
    for true, probability in enumerate(hand.probabilities):
        _, root = hand.truths[true]
        unknown = trial.kept(true, root @ rng.standard_normal((root.shape[1], EXPERIMENTS)))
        noise = rng.standard_normal(unknown.shape) / np.sqrt(times)  # their mean says all that they say together
        readings = base[:, [true]] + unknown + noise
        logs = np.stack([hand.logs[k] + gain(hand, k, Part(*trial.folded(k, readings)), times) for k in range(m)])
        posterior = np.exp(logs - logsumexp(logs, axis=0))
        mine = groups == groups[true]
        right += probability * float(np.mean(posterior[mine].sum(axis=0) >= CREDIBLE))
        others = [posterior[groups == g].sum(axis=0) for g in set(groups.tolist()) - {groups[true]}]
        wrong += probability * float(np.mean(np.any([p >= CREDIBLE for p in others], axis=0))) if others else 0.0
    added = nats(hand, trial, times)
    return Expected(added, worst(added, groups), right, wrong)
