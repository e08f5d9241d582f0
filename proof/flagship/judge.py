"""What the engine said of a drawn plant against what is true of it: one row of ``draws.csv``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from twinbench.proof.concealed.judge import claims, size_error
from twinbench.proof.concealed.outcome import LARGEST_SET
from twinbench.proof.flagship.measure import METRICS, Errors

ABSTAINS = ("incomplete", "unexplained")
"""Verdicts that say that something is still missing."""
MODELS = ("oracle", "nominal", "mended")
COLUMNS = (
    "case", "cell", "number", "engine", "truth", "without", "verdict", "named_right", "named_wrong", "sets",
    "sets_right", "missed", "amplitude_error_pct", "amplitude_covered",
    *(f"{model}_{metric}" for model in MODELS for metric in METRICS), "parameter_share", "open60_share", "seconds",
)  # fmt: skip
"""``nominal`` is the best-calibrated nominal model, measure by measure. ``amplitude_error_pct`` and
``amplitude_covered`` hold one number for each name of ``named_right``."""


def names(truth: Mapping[str, Any], verdict: Mapping[str, Any]) -> dict[str, str]:
    """Which names are right and wrong, which sets hold something true, which effects are in neither.

    An effect counts as found if it is named alone or stands in a set of at most three.
    """
    effects = {e["name"]: e for e in truth["effects"]}
    found = claims(verdict)
    single = [c for c in found if c.single]
    sets = [c.names for c in found if len(c.names) > 1]
    right = [c for c in single if c.names[0] in effects]
    held = {n for s in sets if len(s) <= LARGEST_SET for n in s} | {c.names[0] for c in right}
    sizes = [size_error(effects[c.names[0]], c) for c in right]
    return {
        "named_right": "+".join(c.names[0] for c in right),
        "named_wrong": "+".join(c.names[0] for c in single if c.names[0] not in effects),
        "sets": "+".join("|".join(s) for s in sets),
        "sets_right": "+".join("|".join(s) for s in sets if len(s) <= LARGEST_SET and effects.keys() & set(s)),
        "missed": "+".join(n for n in effects if n not in held),
        "amplitude_error_pct": "+".join(f"{error:.1f}" for error, _ in sizes),
        "amplitude_covered": "+".join(f"{covered:.0f}" for _, covered in sizes),
    }


def shares(oracle: Errors, baselines: Sequence[Errors], mended: Errors) -> dict[str, float]:
    """Errors of the three models and the shares of the gap that mending closes; 1 is the oracle's error.

    The baseline is the best of several in each measure, though no one model may be the best in all.
    """
    best = {metric: float(np.nanmin([getattr(b, metric) for b in baselines])) for metric in (*METRICS, "open60")}
    columns = {f"oracle_{m}": getattr(oracle, m) for m in METRICS} | {f"nominal_{m}": best[m] for m in METRICS}
    columns |= {f"mended_{m}": getattr(mended, m) for m in METRICS}
    for metric in ("parameter", "open60"):
        gap = best[metric] - getattr(oracle, metric)
        columns[f"{metric}_share"] = (best[metric] - getattr(mended, metric)) / gap if gap > 0.0 else np.nan
    return columns
