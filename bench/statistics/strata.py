"""The two kinds of test recordings: of worn machines, which are ranked, and the paper's, which are told apart."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import pandas as pd

from twinbench.bench.estimates import Estimates

Stratum = Literal["worn", "single"]
SINGLE = "single-"
"""How the names of the paper's recordings begin: a healthy start, and one health parameter that changes."""


def in_stratum(sequence: str, stratum: Stratum) -> bool:
    """Is a recording, by its name, one of those?"""
    return sequence.startswith(SINGLE) == (stratum == "single")


def of_stratum(scores: pd.DataFrame, stratum: Stratum) -> pd.DataFrame:
    """The rows of one stratum's recordings.

    Args:
        scores: with a column ``sequence``.
    """
    return scores[scores["sequence"].astype(str).str.startswith(SINGLE) == (stratum == "single")]


def select(estimates: Estimates, stratum: Stratum) -> Estimates:
    """One cell's estimates of one stratum's recordings."""
    rows = [b for b, name in enumerate(estimates.names) if in_stratum(name, stratum)]
    by_sequence = ("mean", "low", "high", "nis", "nis_dof", "flags", "forecast", "mean_at_origin", "cov_at_origin")
    kept = {f: getattr(estimates, f)[rows] for f in by_sequence}
    return replace(estimates, names=tuple(estimates.names[b] for b in rows), **kept)
