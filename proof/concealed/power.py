"""Power curves, reliability and outcomes: the tables behind the figures."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd

from twinbench.proof.concealed.findings import SINGLE
from twinbench.proof.concealed.outcome import OUTCOMES

DISTANCES = (0.0, 3.0, 5.5, 10.0, 17.0, 30.0, 55.0, 100.0, np.inf)
"""Edges of bins of the distance from "no effect", in noise sds; 5.5 is where an effect counts as there."""
STATED = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Edges of bins of stated probabilities."""


def power(rows: pd.DataFrame) -> pd.DataFrame:
    """The rate of right names or classes over the distance sqrt(D0_sq), beside the ideal observer's.

    A row per engine, machine, effect and bin, and for each engine and kind of machine one over all effects, with
    machine and truth "all": engine, kind, machine, truth, low, high, distance (mean), cases, right, ideal.
    """
    asked = rows[rows["cell"].isin((*SINGLE, "sensor"))]
    asked = asked.assign(
        distance=np.sqrt(asked["D0_sq"].astype(float)), right=asked["outcome"].isin(("name", "class")).astype(float)
    )
    every = pd.concat([asked, asked.assign(machine="all", truth="all")])
    every["bin"] = np.clip(np.searchsorted(DISTANCES, every["distance"], side="right") - 1, 0, len(DISTANCES) - 2)
    grouped = every.groupby(["engine", "kind", "machine", "truth", "bin"])
    table = grouped.agg(
        distance=("distance", "mean"), cases=("right", "size"), right=("right", "mean"), ideal=("ideal_class", "mean")
    ).reset_index()
    at = table.pop("bin").astype(int)
    table.insert(4, "low", np.array(DISTANCES)[at])
    table.insert(5, "high", np.array(DISTANCES)[at + 1])
    return table


def reliability(claims: pd.DataFrame) -> pd.DataFrame:
    """Of single names with a stated probability, by bins: low, high, stated (mean), right (rate), cases."""
    known = claims[claims["single"].astype(bool) & claims["probability"].notna()]
    at = np.clip(np.searchsorted(STATED, known["probability"], side="right") - 1, 0, len(STATED) - 2)
    table = []
    for i, (low, high) in enumerate(itertools.pairwise(STATED)):
        own = known[at == i]
        if len(own):
            right = float(own["right"].astype(float).mean())
            table.append((low, high, float(own["probability"].mean()), right, len(own)))
    return pd.DataFrame(table, columns=["low", "high", "stated", "right", "cases"])


def reliability_error(bins: pd.DataFrame) -> float:
    """Mean over all claims of the distance between what is stated and what is right in their bin; NaN without any."""
    if not len(bins):
        return float("nan")
    return float(np.average((bins["stated"] - bins["right"]).abs(), weights=bins["cases"]))


def outcomes(rows: pd.DataFrame) -> pd.DataFrame:
    """How often each outcome, by engine, machine and cell; with the number of cases."""
    counted = rows.groupby(["engine", "machine", "cell"])["outcome"].value_counts().unstack(fill_value=0)
    counted = counted.reindex(columns=list(OUTCOMES), fill_value=0)
    return counted.assign(cases=counted.sum(axis=1)).reset_index().rename_axis(columns=None)
