"""What the rows of ``cases.csv`` say, claim by claim and case by case."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from twinbench.proof.concealed.judge import COLUMNS
from twinbench.proof.concealed.outcome import SOUND, UNKNOWN, wrong_names

TEXTS = ("case", "truth", "class", "verdict", "named", "set", "probability", "ports", "port_truth", "detectable",
         "inexact")  # fmt: skip
SINGLE = ("mechanism", "onset")
"""Cells with one effect that the catalogue has."""


class Stated(NamedTuple):
    """One claim of a verdict.

    Attributes:
        single: is it one name?
        probability: that the verdict states; NaN if none.
        right: is the name right, does the set hold an effect of the case?
    """

    single: bool
    probability: float
    right: bool


def read_cases(path: Path) -> pd.DataFrame:
    """``cases.csv``, empty texts as such and ``detectable`` a truth value; sound machines lack nothing to detect."""
    table = pd.read_csv(
        path,
        dtype=dict.fromkeys(TEXTS, str),
        keep_default_na=False,
        na_values={c: [""] for c in COLUMNS if c not in TEXTS},
    )
    return table.assign(detectable=table["detectable"] == "True")


def with_marks(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows, and for each: what it was asked and what it did.

    Columns added, all bool: ``by_class`` and ``by_name`` (every effect by its class, by its own name), ``wrong_name``
    (a single name that is wrong), ``said`` (a name or a set), ``pointed`` (every effect located), ``physics`` (a
    sensor's or input's fault for which physics is blamed).
    """
    marked = rows.assign(
        by_name=rows["outcome"] == "name",
        by_class=rows["outcome"].isin(("name", "class")),
        said=(rows["named"] != "") | (rows["set"] != ""),
        wrong_name=[bool(_wrong(row)) for _, row in rows.iterrows()],
        pointed=[_pointed(row) for _, row in rows.iterrows()],
    )
    # Who says that nothing explains it calls it nothing.
    called = rows["ports"].str.contains(r"(?:^|[+|])(?:balance|flux):") & (rows["verdict"] != "unexplained")
    found = rows["outcome"].isin(("name", "class", "set"))
    return marked.assign(physics=called & ~found & (rows["cell"] == "sensor"))


def stated(rows: pd.DataFrame) -> pd.DataFrame:
    """Every claim that names something: single, probability, right."""
    return pd.DataFrame([s for _, row in rows.iterrows() for s in _claims(row)], columns=list(Stated._fields))


def miss(row: pd.Series) -> str:
    """What went wrong in a marked case, in a word or two; empty if nothing."""
    if row["verdict"] == "failed":
        return "engine failed"
    if row["cell"] in SOUND:
        return "false name" if row["named"] else "false set" if row["set"] else ""
    if row["wrong_name"]:
        return "wrong name"
    if row["outcome"] == "wrong":
        return "wrong set"
    if row["physics"]:
        return "sensor called physics"
    if not row["detectable"]:
        return ""
    if row["cell"] in UNKNOWN:
        return "" if row["pointed"] else "located elsewhere"
    return {"name": "", "class": "", "set": "set only"}.get(row["outcome"], "not named")


def parts(text: str, by: str) -> list[str]:
    """The parts of a joined text; none of an empty one."""
    return [part for part in str(text).split(by) if part]


def classes(row: pd.Series) -> list[set[str]]:
    """Of each effect of a case, the names that are the same as its own."""
    return [set(parts(one, "|")) for one in parts(row["class"], "+")]


def _wrong(row: pd.Series) -> list[str]:
    return wrong_names(row["cell"], classes(row), parts(row["named"], "+"))


def _pointed(row: pd.Series) -> bool:
    at = set(parts((row["ports"] or row["inexact"]).replace("+", "|"), "|"))
    return all(at & set(parts(ports, "|")) for ports in parts(row["port_truth"], "+"))


def _claims(row: pd.Series) -> Iterator[Stated]:
    singles, several = parts(row["named"], "+"), parts(row["set"], "+")
    told = str(row["probability"]).split("+") + [""] * (len(singles) + len(several))
    known = [float(p) if p else float("nan") for p in told]
    wrong = wrong_names(row["cell"], classes(row), singles)
    has_name = row["cell"] not in (*SOUND, *UNKNOWN)
    for name, probability in zip(singles, known, strict=False):
        yield Stated(True, probability, name not in wrong)
    for names, probability in zip(several, known[len(singles) :], strict=False):
        yield Stated(False, probability, has_name and any(same & set(parts(names, "|")) for same in classes(row)))
