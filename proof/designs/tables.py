"""What became of the sets, as tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from twinbench.proof.concealed.gates import wilson
from twinbench.proof.concealed.generate import Item
from twinbench.proof.designs.trial import ARMS, IN_TURN, RIGHT, kept


def rows_of(item: Item, out: Path) -> dict[str, Any]:
    """A row of ``cases.csv``."""
    found = kept(out / "cases" / f"{item.case}.json") or {"status": "missing"}
    row = {"case": item.case, "machine": item.machine, "effect": item.effects[0], "severity": item.severity}
    row |= {key: found.get(key, "") for key in ("status", "before", *ARMS, "experiments", "says", "seconds")}
    row["in_turn"] = "+".join(found.get("in_turn", ()))
    return row | {f"promised_{key}": value for key, value in found.get("promised", {}).items()}


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """For each arm: cases, rate of the right name with its 95 % interval (Wilson), and likewise of a wrong one."""
    sets, found = rows[rows["status"] == "set"], []
    for arm in ARMS:
        row: dict[str, Any] = {"experiment": arm, "cases": len(sets)}
        for word, hit in (("right", sets[arm].isin(RIGHT)), ("wrong", sets[arm] == "wrong")):
            low, high = wilson(float(hit.sum()), len(sets))
            row |= {word: hit.mean() if len(sets) else float("nan"), f"{word}_low": low, f"{word}_high": high}
        found.append(row)
    return pd.DataFrame(found)


def as_markdown(table: pd.DataFrame, rows: pd.DataFrame) -> str:
    """The table to read, with how many experiments led to a name."""
    lines = ["| after one experiment | cases | right name, % | wrong name, % |", "|---|---:|---:|---:|"]
    for _, r in table.iterrows():
        cells = [f"{100 * r[w]:.0f} [{100 * r[f'{w}_low']:.0f}–{100 * r[f'{w}_high']:.0f}]" for w in ("right", "wrong")]
        lines.append(f"| {r['experiment']} | {r['cases']} | {cells[0]} | {cells[1]} |")
    sets = rows[rows["status"] == "set"]
    each = [f"{n}: {int((sets['experiments'] == n).sum())}" for n in range(1, IN_TURN + 1)]
    lines.append(f"\nRight name after so many proposed experiments, in cases: {', '.join(each)}.")
    counts = rows["status"].value_counts().to_dict()
    lines.append(f"Of {len(rows)} machines drawn: {', '.join(f'{status} {n}' for status, n in counts.items())}.")
    return "\n".join(lines) + "\n"
