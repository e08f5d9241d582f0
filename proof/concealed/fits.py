"""How nearly the catalogue fits an effect that it has a name for, and one that it has none for.

A second bound, beside the ideal observer's. That observer knows which effects there can be. This one does not: whether
the catalogue has the name at all it can tell by what the best fit leaves, no more. It knows the noise.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from twinbench.proof.concealed.outcome import UNKNOWN, WRONG_NAMES

QUANTILES = (0.1, 0.5, 0.9)


def limit_sq(rows: pd.DataFrame) -> float:
    """What may be left, in squared sds, so that no more than ``WRONG_NAMES`` of the cases are wrongly named."""
    left = np.sort(rows.loc[rows["cell"].isin(UNKNOWN) & rows["detectable"], "left_sq"])
    wrong = int(WRONG_NAMES * len(rows))
    return float(left[wrong]) if wrong < len(left) else np.inf


def fits(rows: pd.DataFrame) -> pd.DataFrame:
    """Of detectable effects, by cell: what the catalogue leaves of them, and the share of which it leaves less.

    Columns are cell, cases, left_10, left_50, left_90 (quantiles, in squared sds of the noise) and fitted (the share of
    which less is left than ``limit_sq``: right names, or wrong ones where the catalogue has none).
    """
    there, most, table = rows[rows["detectable"]], limit_sq(rows), []
    for cell, own in there.groupby("cell", sort=False):
        left = own["left_sq"].astype(float)
        line = {f"left_{100 * q:.0f}": float(left.quantile(q)) for q in QUANTILES}
        table.append({"cell": cell, "cases": len(own), **line, "fitted": float((left < most).mean())})
    return pd.DataFrame(table)


def fits_as_markdown(table: pd.DataFrame, most_sq: float) -> str:
    """``fits`` to read, and the limit."""
    lines = [
        f"Less than {most_sq:.3g} squared sds of the noise may be left.",
        "",
        "| cell | cases | left: 10 % | median | 90 % | less is left of |",
        "|---|---|---|---|---|---|",
    ]
    for _, row in table.iterrows():
        left = " | ".join(f"{row[f'left_{100 * q:.0f}']:.3g}" for q in QUANTILES)
        lines.append(f"| {row['cell']} | {row['cases']} | {left} | {row['fitted']:.2f} |")
    return "\n".join(lines) + "\n"
