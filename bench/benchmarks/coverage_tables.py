"""What the study of coverage shows: in how many pairs intervals are right, and what an exact posterior holds."""

from __future__ import annotations

import pandas as pd

from twinbench.bench.benchmarks.exact_posterior import REGIMES_SHOWN
from twinbench.bench.report.table_formats import Cell, Column, Table
from twinbench.bench.report.verdicts import CALIBRATED_PCT
from twinbench.bench.roster import label, ordered

KINDS = ("all samples", "by operating point", "by what health did")
"""Of regimes; the last ones only the truth tells apart."""


def right_pairs(table: pd.DataFrame) -> Table:
    """Of each estimator, in how many pairs of quantity and regime the calibrated coverage is right.

    Args:
        table: what ``coverage_table`` returns.
    """
    pairs = table[table["quantity"] != "mean"]
    pairs = pairs.assign(right=pairs["calibrated_pct"].between(*CALIBRATED_PCT), kind=pairs["regime"].map(_kind))
    found = pairs.groupby(["estimator", "kind"])["right"].agg(["sum", "count"]).reset_index()
    said = {(e, kind): f"{right} of {of}" for e, kind, right, of in found.itertuples(index=False)}
    names = ordered(pairs["estimator"].unique())
    rows = tuple((Cell(label(name)), *(Cell(said[name, kind]) for kind in KINDS)) for name in names)
    title = f"Pairs of quantity and regime with {CALIBRATED_PCT[0]:g} to {CALIBRATED_PCT[1]:g} % inside"
    return Table("right_pairs", title, found, (Column("estimator"), *map(Column, KINDS)), rows)


def _kind(regime: str) -> str:
    """All samples, an operating point that inputs and readings tell, or what only the truth tells."""
    if regime == "all":
        return KINDS[0]
    return KINDS[2] if regime.startswith(("after_", "steady_")) else KINDS[1]


def exact_table(found: pd.DataFrame) -> Table:
    """What an exact posterior holds, by noise and regime.

    Args:
        found: what ``exact_posterior.table`` returns.
    """
    wide = found.pivot(index="reading_sd_lives", columns="regime", values="coverage_pct")[list(REGIMES_SHOWN)]
    rows = tuple((Cell(f"{sd:g}"), *(Cell(f"{pct:.1f}") for pct in row)) for sd, row in wide.iterrows())
    columns = (Column("sd of a reading, lives"), *(Column(says) for says in REGIMES_SHOWN.values()))
    title = "What an exact posterior's 95 % intervals hold, %: one parameter that jumps, one reading a second"
    return Table("exact_posterior", title, found, columns, rows)
