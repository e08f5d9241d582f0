"""What a stricter or a laxer rule would say: names that are right over verdicts that are wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from twinbench.common.style import BLUE, COLUMN_MM, INK, MUTED, PAGE_MM, VERMILION, canvas, styled
from twinbench.proof.concealed.findings import SINGLE
from twinbench.proof.concealed.outcome import UNKNOWN, WRONG_NAMES
from twinbench.proof.learning.fit import findings, left_out

THRESHOLDS = np.round(np.arange(0.3, 0.991, 0.01), 2)
"""Probabilities from which on a name would be said: below, more verdicts are wrong than anybody would bear."""


def tradeoff(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """For each probability from which on a name is said: what is named, on machines that were left out.

    Columns: ``say_name``; ``wrong``, the share of a suite's verdicts with a wrong name; ``single`` and ``named``, of
    single effects that can be told how many there are and how many are named rightly; ``unknown`` and
    ``named_unknown``, of effects that the catalogue lacks how many there are and how many are given a name.
    """
    rows = [row for row in rows if "failed" not in row]
    found = findings(rows)
    p = left_out(found) * found.weight
    single = {i for i, row in enumerate(rows) if row["cell"] in SINGLE and row["detectable"]}
    unknown = {i for i, row in enumerate(rows) if row["cell"] in UNKNOWN}
    lines = []
    for threshold in THRESHOLDS:
        said = p >= threshold
        wrong, right = (set(found.case[said & which].tolist()) for which in (~found.right, found.right))
        counts = len(single), len(single & right), len(unknown), len(unknown & wrong)
        lines.append((threshold, found.stands_for[list(wrong)].sum() / len(rows), *counts))
    return pd.DataFrame(lines, columns=["say_name", "wrong", "single", "named", "unknown", "named_unknown"])


@styled
def tradeoff_figure(curve: pd.DataFrame, say_name: float) -> Figure:
    """Single effects that are named rightly over verdicts with a wrong name; the rule's own threshold is marked.

    Args:
        curve: what ``tradeoff`` gives.
        say_name: the threshold that was learnt, a probability.
    """
    figure = canvas(PAGE_MM, 0.75 * COLUMN_MM)
    axes = figure.subplots()
    right = curve["named"] / curve["single"]
    axes.plot(100.0 * curve["wrong"], right, color=BLUE, drawstyle="steps-post")
    axes.axvline(100.0 * WRONG_NAMES, color=MUTED, linestyle=":", label="promised at most")
    own = int(np.argmin(np.abs(curve["say_name"] - say_name)))
    label = f"a name is said from {say_name:.2f} on"
    axes.plot(100.0 * curve["wrong"][own], right[own], "o", color=VERMILION, label=label)
    for threshold in (0.5, 0.7, 0.95):
        at = int(np.argmin(np.abs(curve["say_name"] - threshold)))
        axes.plot(100.0 * curve["wrong"][at], right[at], ".", color=INK)
        axes.annotate(f"{threshold}", (100.0 * curve["wrong"][at], right[at]), (4, -8), textcoords="offset points")
    axes.set_xlabel("verdicts with a wrong name, %")
    axes.set_ylabel("single effects named rightly, rate")
    axes.set_ylim(-0.02, 1.02)
    axes.legend(loc="lower right")
    return figure
