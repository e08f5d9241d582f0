"""The two kinds of test recordings: of worn machines, which are ranked, and the paper's, which are told apart."""

from __future__ import annotations

from typing import Literal

import pandas as pd

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
