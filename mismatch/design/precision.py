"""How much closer an experiment would know the parameters, where nothing is contested (D-optimal design)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinbench.mismatch.design.hand import Hand
from twinbench.mismatch.design.separation import truths
from twinbench.mismatch.design.trials import Trial
from twinbench.physics.simulator import Array


class Gained(NamedTuple):
    """What parameters gain.

    Attributes:
        nats: by which the logarithm of their posterior's volume falls.
        shares: (S,) shares of each parameter's standard deviation that are left.
    """

    nats: float
    shares: Array


def gained(hand: Hand, trial: Trial) -> Gained:
    """What the shared parameters of the first rival gain, what effects differ by and the discrepancy free."""
    known, rival = hand.known[0], hand.rivals[0]
    many = sum(u.recording == -1 for u in rival.problem.unknowns)
    precision = np.diag(hand.precision(known, hand.s[0]))
    folded, _ = trial.folded(0, truths(hand, trial)[:, :1])
    before, after = (np.linalg.inv(G + precision)[:many, :many] for G in (known.G, known.G + folded.G))
    nats = 0.5 * (np.linalg.slogdet(before)[1] - np.linalg.slogdet(after)[1])
    return Gained(float(nats), np.sqrt(np.diag(after) / np.diag(before)))
