"""What an exact posterior's intervals hold while health changes, and before and after.

One health parameter jumps at most once, at a time and to a value that nobody foresees, and noisy readings of it come
once a second. On a grid Bayes' rule is exact here. Its intervals hold what they promise over all ticks. They hold
less just after a jump and more before one, since only the truth tells these ticks apart: no reading does.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from twinbench.bench.statistics.bootstrap import INTERVAL_LEVEL
from twinbench.bench.statistics.regimes import AFTER_HEALTH_S
from twinbench.machines.coordinates import Array

READINGS_SD = (0.1, 0.3, 1.0)
"""Of one reading a second, in lives. They tell health to .9, 2.7 and 9 % of a life in two minutes: a benchmark's
parameters lie between. Noisier readings take longer to show a jump, so that less is held after it."""
MACHINES = 1000
"""That are watched. With so many, coverage scatters by some tenths of a per cent; with fewer by more."""
SECONDS, WARM_S = 1500, 300
"""How long each is watched, and before when none changes: as in the compressor's recordings. A longer watch has more
ticks long before and long after a jump, where less goes wrong."""
LIFE_CELLS = 101
"""Into which the grid divides a life, all narrower than what readings tell. Far fewer would round the posterior."""
REGIMES_SHOWN = {
    "all": "all samples",
    "after_health": "two minutes after a jump",
    "steady_before": "before it",
    "steady_after": "later",
}
CHANGING = 0.5
"""Chance that a machine changes at all. It matters little to what intervals hold just after."""


def coverage(sd: float, rng: np.random.Generator) -> dict[str, float]:
    """Per cent of ticks whose central 95 % interval holds the truth, by regime that any machine is ever in.

    Args:
        sd: of a reading, in lives.
        rng: what machines and readings are drawn from.
    """
    n = MACHINES
    jump_s = np.where(rng.random(n) < CHANGING, rng.uniform(WARM_S, SECONDS, n), np.inf)
    start, end = rng.random((2, n))
    cells = (np.arange(LIFE_CELLS) + 0.5) / LIFE_CELLS
    still, moved = np.full((n, LIFE_CELLS), 1.0 / LIFE_CELLS), np.zeros((n, LIFE_CELLS))  # joint with: has it jumped?
    held: dict[str, list[Array]] = {regime: [] for regime in REGIMES_SHOWN}
    for t in range(SECONDS):
        if t >= WARM_S:
            gone = (t - WARM_S) / (SECONDS - WARM_S)
            chance = CHANGING / (SECONDS - WARM_S) / (1.0 - CHANGING * gone)  # of a jump now, if there was none
            moved += chance * still.sum(axis=1, keepdims=True) / LIFE_CELLS
            still *= 1.0 - chance
        true = np.where(t >= jump_s, end, start)
        off = ((true + sd * rng.normal(size=n))[:, None] - cells) / sd
        likelihood = np.exp(0.5 * (off**2).min(axis=1, keepdims=True) - 0.5 * off**2)
        still, moved = still * likelihood, moved * likelihood
        total = (still + moved).sum(axis=1, keepdims=True)
        still, moved = still / total, moved / total
        if t < WARM_S:
            continue
        below = _share_below(still + moved, true)
        inside = np.abs(below - 0.5) < 0.5 * INTERVAL_LEVEL
        fresh, done = (jump_s <= t) & (t < jump_s + AFTER_HEALTH_S), jump_s + AFTER_HEALTH_S <= t
        which = (np.ones(n, dtype=bool), fresh, ~fresh & ~done, done)
        for name, mask in zip(held, which, strict=True):
            held[name].append(inside[mask])
    together = {name: np.concatenate(ticks) for name, ticks in held.items()}
    return {name: 100.0 * float(hits.mean()) for name, hits in together.items() if len(hits)}


def _share_below(posterior: Array, true: Array) -> Array:
    """(n,) of the posteriors (n, LIFE_CELLS), each even inside its cells, the share below a value (n,) in [0, 1]."""
    rows, cell = np.arange(len(true)), np.minimum((true * LIFE_CELLS).astype(int), LIFE_CELLS - 1)
    before = np.cumsum(posterior, axis=1)[rows, cell] - posterior[rows, cell]
    return before + (true * LIFE_CELLS - cell) * posterior[rows, cell]


def table(seed: int) -> pd.DataFrame:
    """Columns reading_sd_lives, regime, coverage_pct."""
    rows = []
    for sd in READINGS_SD:
        found = coverage(sd, np.random.default_rng(seed))
        rows += [(sd, regime, round(pct, 2)) for regime, pct in found.items()]
    return pd.DataFrame(rows, columns=["reading_sd_lives", "regime", "coverage_pct"])
