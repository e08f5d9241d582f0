"""Are the intervals honest? Coverage by quantity and regime, NIS, NEES, and what an exact filter gives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binom, chi2

from twinbench.bench.estimates import Estimates
from twinbench.bench.roster import ordered
from twinbench.bench.statistics.aligned import truth_at
from twinbench.bench.statistics.bootstrap import INTERVAL_LEVEL, interval, resample_weights
from twinbench.bench.statistics.ranked import ranked_from
from twinbench.bench.statistics.regimes import changes_of, regimes
from twinbench.data.batch import Array, Batch, Truth

SHARES = ("inside_pct", "calibrated_pct")
"""Columns of ``coverage_by_regime``: of the intervals as they are, and as the calibration recordings stretch them."""


def inside(estimates: Estimates, truth: Truth) -> Array:
    """(B, M, n): 1 where the truth lies in the interval, 0 where not, NaN where there is none.

    Args:
        truth: at the stored ticks, as ``truth_at`` gives it.
    """
    low, high = estimates.low, estimates.high
    hit = (low <= truth.estimated) & (truth.estimated <= high)
    return np.where(np.isfinite(low) & np.isfinite(high), hit, np.nan)


def coverage_by_regime(estimates: Estimates, truth: Batch) -> pd.DataFrame:
    """Share of ranked samples whose 95 % interval holds the truth, by sequence, regime and quantity.

    Returns:
        Columns ``sequence, regime, quantity, inside_pct, calibrated_pct, ticks``; quantities as the machine has them. A
        sequence that never enters a regime has no row there; NaN where an interval is not finite, and in
        ``calibrated_pct`` where nobody has calibrated them.
    """
    at = truth_at(truth, estimates.names, estimates.time_s)
    hits = inside(estimates, at), inside(estimates.calibrated(), at)
    ranked = estimates.time_s >= ranked_from(estimates.time_s)
    rows = []
    for regime, mask in regimes(truth.machine, estimates.time_s, at, changes_of(truth, estimates.names)).items():
        mask &= ranked
        for b in np.flatnonzero(mask.any(axis=1)):
            shares = [100.0 * hit[b, mask[b]].mean(axis=0) for hit in hits]
            for quantity, *both in zip(truth.machine.quantities, *shares, strict=True):
                rows.append((estimates.names[b], regime, quantity, *map(float, both), int(mask[b].sum())))
    return pd.DataFrame(rows, columns=["sequence", "regime", "quantity", *SHARES, "ticks"])


COLUMNS = [
    "estimator", "regime", "quantity", "coverage_pct", "low", "high", "n_sequences", "expected_pct", "expected_low",
    "expected_high", "reason", "calibrated_pct", "calibrated_low", "calibrated_high",
]  # fmt: skip
"""Of ``coverage_table``."""


def coverage_table(rows: pd.DataFrame, failed: Mapping[str, str] | None = None) -> pd.DataFrame:
    """Coverage of each estimator by regime and quantity, with its interval over sequences.

    Seeds are averaged inside a sequence; a sequence weighs as many samples as it has in the regime.

    Args:
        rows: what ``coverage_by_regime`` returns, with columns ``estimator`` and ``seed`` added.
        failed: estimators with a failed cell and its reason; one without rows gets a NaN ``mean`` of ``all``.

    Returns:
        Columns COLUMNS; quantity ``mean`` is the mean of all, and ``calibrated_pct`` the coverage of the
        calibrated intervals. Where an interval is not finite the coverage is NaN and ``reason`` says in which
        sequences.
    """
    failed = failed or {}
    table: list[tuple[Any, ...]] = []
    quantities = [*rows["quantity"].unique(), "mean"]
    groups = dict(iter(_wide(rows).groupby(level=["estimator", "regime"])))
    for estimator, regime in product(ordered(rows["estimator"].unique()), rows["regime"].unique()):
        if (estimator, regime) in groups:
            found = _by_quantity(groups[estimator, regime], quantities, failed.get(estimator))
            table += [(estimator, regime, *row) for row in found]
    missing = [name for name in failed if name not in set(rows["estimator"])]
    nothing = (np.nan, np.nan, np.nan, 0, 100 * INTERVAL_LEVEL, np.nan, np.nan)
    table += [(name, "all", "mean", *nothing, failed[name], *nothing[:3]) for name in ordered(missing)]
    return pd.DataFrame(table, columns=COLUMNS)


def _wide(rows: pd.DataFrame) -> pd.DataFrame:
    """By estimator, regime and sequence, seeds averaged: ``ticks``, and both of SHARES of each quantity and of all."""
    cell = ["estimator", "regime", "sequence"]
    wide = rows.pivot(index=[*cell, "seed", "ticks"], columns="quantity", values=list(SHARES))
    of_all = {(share, "mean"): wide.xs(share, axis=1).to_numpy(dtype=float).mean(axis=1) for share in SHARES}
    wide = pd.concat([wide, pd.DataFrame(of_all, index=wide.index)], axis=1).reset_index("ticks")
    return wide.groupby(level=cell).mean().mask(wide.isna().groupby(level=cell).any())


def _by_quantity(group: pd.DataFrame, quantities: list[str], failed: str | None) -> Iterator[tuple[Any, ...]]:
    """Rows of one estimator in one regime, COLUMNS from ``quantity`` on; ``group`` has a row for each sequence."""
    n, ticks = len(group), group["ticks"].to_numpy(dtype=float).ravel()
    weights = resample_weights(n) * ticks
    weights /= weights.sum(axis=1, keepdims=True)
    names = group.index.get_level_values("sequence")
    of = {share: group[share][quantities].to_numpy(dtype=float).T.copy() for share in SHARES}
    for quantity, *both in zip(quantities, *of.values(), strict=True):
        found = [(float(shares @ ticks / ticks.sum()), *interval(weights @ shares, n)) for shares in both]
        lost = names[np.isnan(both[0])]
        reason = f"no finite interval in {', '.join(lost)}" if len(lost) else ""
        about = (n, 100 * INTERVAL_LEVEL, *expected_band(n), "; ".join(filter(None, [failed, reason])))
        yield quantity, *found[0], *about, *found[1]


@lru_cache
def expected_band(n: int, level: float = INTERVAL_LEVEL) -> tuple[float, float]:
    """Central 95 % band, in per cent, of the coverage that an exact filter shows in n independent trials.

    Samples of one sequence are not independent: with n sequences this is the band if each counted
    as a single trial, the widest that it can be.
    """
    low, high = binom.ppf([0.025, 0.975], n, level) / n
    return 100.0 * float(low), 100.0 * float(high)


def nis_scores(nis: Array, dof: np.ndarray) -> tuple[Array, Array, Array]:
    """Mean NIS over mean dof, median of NIS over its expected median, per cent of ticks in their band; each (B,).

    Args:
        nis: (B, M) dimensionless, innovation' S^-1 innovation.
        dof: (B, M) dimensionless counts of accepted channels; 0 is left out.
    """
    used = dof > 0
    ticks = np.where(used.any(axis=1), used.sum(axis=1), np.nan)
    degrees = np.where(used.any(axis=1), dof.sum(axis=1), np.nan)
    low, high = (chi2.ppf(p, np.maximum(dof, 1)) for p in (0.5 - INTERVAL_LEVEL / 2, 0.5 + INTERVAL_LEVEL / 2))
    within = np.where(np.isfinite(nis), (low <= nis) & (nis <= high), np.nan)
    total, hits = (np.where(used, values, 0.0).sum(axis=1) for values in (nis, within))
    medians = [nis_median_ratio(n[u], d[u]) if u.any() else np.nan for n, d, u in zip(nis, dof, used, strict=True)]
    return total / degrees, np.array(medians), 100.0 * hits / ticks


def nis_median_ratio(nis: Array, dof: np.ndarray | int) -> float:
    """Median of normalised innovations squared, (n,), each over the median of its chi-square.

    Args:
        nis: (n,) dimensionless, innovation' S^-1 innovation.
        dof: degrees of freedom of all, or (n,) of each, dimensionless.
    """
    return float(np.median(nis / chi2.median(dof)))


def nees(error: Array, cov: Array) -> Array:
    """error' cov^-1 error, (B, O), of errors (B, O, n) and covariances (B, O, n, n); NaN where singular.

    Quantities are brought to unit variance first: their units are six decades apart.

    Args:
        error: (B, O, n), each in its quantity's unit.
        cov: (B, O, n, n), in those units squared.
    """
    sd = np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1).clip(0.0))
    usable = np.isfinite(cov).all(axis=(-2, -1)) & (sd > 0).all(axis=-1) & np.isfinite(error).all(axis=-1)
    found = np.full(usable.shape, np.nan)
    scaled_error = error[usable] / sd[usable]
    correlation = cov[usable] / (sd[usable][:, :, None] * sd[usable][:, None, :])
    values, vectors = np.linalg.eigh(correlation)
    values = np.where(values > 1e-12, values, np.nan)
    along = np.einsum("kij,ki->kj", vectors, scaled_error)
    found[usable] = (along**2 / values).sum(axis=-1)
    return found
