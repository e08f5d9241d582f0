"""What became of the sets, as tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from twinbench.bench.statistics.bootstrap import BOOTSTRAP_SEED, RESAMPLES
from twinbench.proof.concealed.gates import wilson
from twinbench.proof.concealed.generate import Item
from twinbench.proof.designs.trial import ARMS, IN_TURN, RIGHT, SET
from twinbench.proof.kept import kept

SHAPE = {"reach": "how far it may go", "length_share": "how long it may last"}
"""What differs between the experiments of cases, beside the machine."""


def rows_of(item: Item, out: Path) -> dict[str, Any]:
    """A row of ``cases.csv``."""
    found = kept(out / "cases" / f"{item.case}.json") or {"status": "missing"}
    row = {"case": item.case, "machine": item.machine, "effect": item.effects[0], "severity": item.severity}
    row |= {
        key: found.get(key, "") for key in ("background_pct", *SHAPE, "status", "before", *ARMS, "experiments", "says")
    }
    row |= {"in_turn": "+".join(found.get("in_turn", ())), "seconds": found.get("seconds", "")}
    row["names"] = "+".join("|".join(names) for names in found.get("names", ()))
    row |= {f"promised_{key}": value for key, value in found.get("promised", {}).items()}
    return row | {f"ideal_{key}": value for key, value in found.get("ideal", {}).items()}


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """For each arm: cases, rates of the right name and of a wrong one with their 95 % intervals (Wilson).

    A right name is one that stands alone: several that nobody can tell apart are ``ALIKE``, which is neither.
    ``ideal`` is how often the ideal observer is sure of the right class. ``alone`` counts cases in which the proposed
    experiment gave the right name and this arm did not, ``other`` those the other way round, ``p`` is McNemar's exact
    test of the two.
    """
    sets, found = rows[rows["status"] == SET], []
    best = sets[ARMS[0]].isin(RIGHT)
    for arm in ARMS:
        row: dict[str, Any] = {"experiment": arm, "cases": len(sets)}
        right = sets[arm].isin(RIGHT)
        for word, hit in (("right", right), ("wrong", sets[arm] == "wrong")):
            low, high = wilson(float(hit.sum()), len(sets))
            row |= {word: hit.mean() if len(sets) else np.nan, f"{word}_low": low, f"{word}_high": high}
        alone, other = int((best & ~right).sum()), int((right & ~best).sum())
        p = float(binomtest(alone, alone + other).pvalue) if alone + other else 1.0
        ideal = pd.to_numeric(sets[f"ideal_{arm}"]).mean() if len(sets) else np.nan
        found.append(row | {"ideal": ideal, "alone": alone, "other": other, "p": p if arm != ARMS[0] else np.nan})
    return pd.DataFrame(found)


def times_random(rows: pd.DataFrame) -> tuple[float, float, float]:
    """How many times as often the proposed experiment gives the right name as a random one: low, value, high.

    The interval holds 95 % of what machines drawn anew give (bootstrap). NaN where a random one never does.
    """
    sets = rows[rows["status"] == SET]
    right = sets[list(ARMS[:2])].isin(RIGHT).groupby(sets["machine"]).sum().to_numpy(float)
    if not right[:, 1].any():
        return np.nan, np.nan, np.nan
    drawn = right[np.random.default_rng(BOOTSTRAP_SEED).integers(len(right), size=(RESAMPLES, len(right)))].sum(axis=1)
    low, high = np.quantile(drawn[:, 0] / np.maximum(drawn[:, 1], 1.0), [0.025, 0.975])
    return float(low), float(right[:, 0].sum() / right[:, 1].sum()), float(high)


def halves(sets: pd.DataFrame) -> list[str]:
    """How often a name is right where experiments may do little and where they may do much, as lines of a table."""
    lines = ["| | cases | right name, proposed, % | random, % |", "|---|---:|---:|---:|"]
    for column, says in SHAPE.items():
        values = pd.to_numeric(sets[column])
        middle = values.median()
        for word, part in (("at most", sets[values <= middle]), ("more than", sets[values > middle])):
            cells = " | ".join(f"{100 * part[arm].isin(RIGHT).mean():.0f}" if len(part) else "–" for arm in ARMS[:2])
            lines.append(f"| {says}: {word} {middle:.2g} times the recordings | {len(part)} | {cells} |")
    return lines


def as_markdown(table: pd.DataFrame, rows: pd.DataFrame) -> str:
    """The table to read, with how many experiments led to a name."""
    head = "| after one experiment | cases | right name, % | wrong name, % | ideal observer sure, % | p |"
    lines = [head, "|---|---:|---:|---:|---:|---:|"]
    for _, r in table.iterrows():
        cells = [f"{100 * r[w]:.0f} [{100 * r[f'{w}_low']:.0f}–{100 * r[f'{w}_high']:.0f}]" for w in ("right", "wrong")]
        p = "–" if np.isnan(r["p"]) else f"{r['p']:.2g}"
        lines.append(f"| {r['experiment']} | {r['cases']} | {cells[0]} | {cells[1]} | {100 * r['ideal']:.0f} | {p} |")
    sets = rows[rows["status"] == SET]
    each = [f"{n}: {int((sets['experiments'] == n).sum())}" for n in range(1, IN_TURN + 1)]
    low, middle, high = times_random(rows)
    lines.append(
        f"\nA right name comes {middle:.2f} times as often after the proposed experiment as after a random one, 95 % "
        f"interval {low:.2f} to {high:.2f} (bootstrap over machines)."
    )
    for arm in ARMS[:2]:
        words = ", ".join(f"{word} {n}" for word, n in sets[arm].value_counts().items())
        lines.append(f"\nOutcomes after the {arm} experiment: {words}.")
    lines.append(f"\nRight name after so many proposed experiments, in cases: {', '.join(each)}.")
    lines.append("\n" + "\n".join(halves(sets)))
    counts = rows["status"].value_counts().to_dict()
    lines.append(f"Of {len(rows)} machines drawn: {', '.join(f'{status} {n}' for status, n in counts.items())}.")
    return "\n".join(lines) + "\n"
