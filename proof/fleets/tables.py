"""What was said of fleets, as tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pandas as pd

from twinbench.proof.concealed.gates import wilson
from twinbench.proof.fleets.trial import WAYS

RATES = {
    "shared_named": "shared effect named, %",
    "shared_told": "or told beside the name, %",
    "wrongly_named": "another named as shared, %",
    "odd_found": "odd machines found, %",
    "odd_named": "and their effect named right, %",
    "sound_accused": "sound machines accused, %",
}
"""Columns of the summary, and what they are called on a page."""


def rows_of(kept: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """A row of ``fleets.csv`` for everybody who said something of a fleet."""
    odd, right = set(kept["odd"]), set(kept["class"])
    for who in WAYS:
        said = kept["said"][who]
        named, accused = set(said["named"]), said["accused"]
        # Only a fleet tells names that do the same beside a name.
        told = [{name, *(kept["alike"][name] if who == WAYS[0] else ())} for name in named]
        yield {
            "fleet": kept["fleet"],
            "shared": kept["shared"],
            "own": kept["own"],
            "who": who,
            "named": " + ".join(sorted(named)),
            "shared_named": int(bool(named & right)),
            "shared_told": int(any(names & right for names in told)),
            "wrongly_named": int(any(not names & right for names in told)),
            "odd_machines": len(odd),
            "odd_found": len(odd & set(accused)),
            "odd_named": sum(accused.get(name) == kept["own"] for name in odd),
            "sound_machines": len(set(kept["machines"]) - odd),
            "sound_accused": len(set(accused) - odd),
            "seconds": kept["seconds"] if who == WAYS[0] else 0.0,
        }


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """For everybody: rates with their 95 % intervals (Wilson), of fleets, odd machines and sound ones."""
    found = []
    for who in WAYS:
        mine = rows[rows["who"] == who]
        row: dict[str, Any] = {"who": who, "fleets": len(mine)}
        odd, sound = int(mine["odd_machines"].sum()), int(mine["sound_machines"].sum())
        of_odd = dict.fromkeys(("odd_found", "odd_named"), odd)
        for rate in RATES:
            hits, of = int(mine[rate].sum()), {**of_odd, "sound_accused": sound}.get(rate, len(mine))
            low, high = wilson(hits, of)
            row |= {rate: hits / of if of else float("nan"), f"{rate}_low": low, f"{rate}_high": high}
        found.append(row)
    return pd.DataFrame(found)


def as_markdown(table: pd.DataFrame, every: Sequence[Mapping[str, Any]]) -> str:
    """The table to read, and of how much it is."""
    lines = [f"| | {' | '.join(RATES.values())} |", "|---|" + "---:|" * len(RATES)]
    for _, r in table.iterrows():
        cells = [f"{100 * r[rate]:.0f} [{100 * r[f'{rate}_low']:.0f}–{100 * r[f'{rate}_high']:.0f}]" for rate in RATES]
        lines.append(f"| {r['who']} | {' | '.join(cells)} |")
    machines, odd = (sum(len(kept[key]) for kept in every) for key in ("machines", "odd"))
    lines.append(f"\nOf {len(every)} fleets with {machines} machines, {odd} of them odd; 95 % intervals in brackets.")
    return "\n".join(lines) + "\n"
