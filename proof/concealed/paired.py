"""Engines against one of them, case by case: which tells more, and which is wrong more often."""

from __future__ import annotations

import pandas as pd
from scipy.stats import binomtest

from twinbench.bench.statistics.ranks import holm
from twinbench.proof.concealed.findings import SINGLE, with_marks

ASKED = (*SINGLE, "two_effects", "sensor")
"""Cells whose effects the catalogue has."""
MARKS = {"told": "by_class", "wrong": "wrong_name"}


def paired_table(rows: pd.DataFrame, first: str) -> pd.DataFrame:
    """A row per engine but ``first``, over the cases that every engine answered.

    Columns are engine, then for ``told`` (every effect of a detectable case by its class) and ``wrong`` (a wrong name)
    in how many cases this engine alone does it, ``_alone``, in how many ``first`` alone, ``_first``, and ``_p`` of
    McNemar's exact test, with Holm's correction for all tests of the table.
    """
    marked = with_marks(rows)
    marked["by_class"] &= marked["detectable"] & marked["cell"].isin(ASKED)
    engines, table = list(dict.fromkeys(marked["engine"])), []
    both = {mark: marked.pivot(index="case", columns="engine", values=c).dropna() for mark, c in MARKS.items()}
    for engine in engines:
        if engine == first:
            continue
        line: dict[str, object] = {"engine": engine}
        for mark, by_case in both.items():
            own, other = (by_case[name].astype(bool) for name in (engine, first))
            alone, of_first = int((own & ~other).sum()), int((other & ~own).sum())
            p = float(binomtest(alone, alone + of_first).pvalue) if alone + of_first else 1.0
            line |= {f"{mark}_alone": alone, f"{mark}_first": of_first, f"{mark}_p": p}
        table.append(line)
    found, tests = pd.DataFrame(table), [f"{mark}_p" for mark in MARKS]
    if table:
        found[tests] = holm(found[tests].to_numpy().ravel()).reshape(-1, len(tests))
    return found


def paired_as_markdown(table: pd.DataFrame, first: str) -> str:
    """``paired_table`` to read.

    Args:
        first: the engine that the others are held against.
    """
    head = ["engine", "told by it alone", f"by {first} alone", "p", "wrong name by it alone", f"by {first} alone", "p"]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for _, row in table.iterrows():
        cells = [f"{row[f'{m}_alone']} | {row[f'{m}_first']} | {row[f'{m}_p']:.2g}" for m in MARKS]
        lines.append(f"| {row['engine']} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
