"""What the engine's constants decide: ``python -m twinbench.proof.sensitivity --cases 60 --seed 7`` tries them.

Each constant that a verdict may hang on is halved and doubled by itself, on cases that are drawn for development. The
table says how many verdicts differ from those of the constants as they are, and which way. The rule that decides what
is said is the same throughout: it was learnt with the constants as they are.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pandas as pd

from twinbench.common.errors import BadInput
from twinbench.common.store import check_writable, key_of, write_text
from twinbench.common.versions import code_version, write_manifest
from twinbench.proof import blind
from twinbench.proof.command import each, refusing
from twinbench.proof.concealed.engines import ENGINES
from twinbench.proof.concealed.findings import read_cases, with_marks
from twinbench.proof.concealed.generate import Item, draw, write
from twinbench.proof.concealed.judge import COLUMNS, score
from twinbench.proof.concealed.plan import cases
from twinbench.proof.concealed.seal import seal

ROOT = Path(__file__).resolve().parents[1]
ENGINE = ENGINES["twinbench"]
CONSTANTS = {
    "calibrate.PRIOR_SD": "prior sd of parameters, scales",
    "sensors.LONGEST_MEMORY": "longest memory of the noise, blocks",
    "naming.marginal.DISCREPANCY_PCT": "prior sd of the discrepancy, per cent",
    "naming.discrepancy.FUNCTIONS": "functions of a discrepancy",
    "naming.view.WANDERS": "prior sd of a size from place to place",
    "naming.picture.SHOWS": "how strongly a candidate is tried, noise sds",
    "naming.picture.VISIBLE": "prior sd of how strongly an effect shows, noise sds",
    "naming.sets.PARAMETER": "share of a column's square that is left of a parameter",
    "naming.name.SINGLES": "single effects that are settled",
    "naming.name.SETS": "larger sets that are settled",
    "naming.name.NEAR": "nats at which a hypothesis is near",
    "naming.settle.SETTLED": "nats that end settling",
    "naming.settle.HOPELESS": "nats at which a hypothesis is given up",
    "naming.settle.AS_WIDE": "factor by which a prior may be too wide",
    "naming.answer.SOMETHING": "prior odds of something unnamed",
    "naming.answer.PLAIN": "nats within which the plainest set is told",
    "naming.steady.UNSTEADY": "how much a stand-in's size differs",
}
"""Module and name of each constant that is tried, and what it is."""
FACTORS = (0.5, 2.0)
AS_IT_IS = ("as it is", 1.0)
TRIAL = ("constant", "factor")
"""Columns of a trial."""


@contextlib.contextmanager
def scaled(constant: str, factor: float) -> Iterator[None]:
    """A constant of the engine times a factor, wherever it is used; whole numbers stay whole."""
    importlib.import_module(ENGINE.partition(":")[0])  # a module that is imported later would keep what it found
    module, _, name = constant.rpartition(".")
    value = getattr(sys.modules[f"twinbench.mismatch.{module}"], name)
    other = round(value * factor) if isinstance(value, int) else value * factor
    users = [m for key, m in sys.modules.items() if key.startswith("twinbench.mismatch.") and hasattr(m, name)]
    with contextlib.ExitStack() as stack:
        for user in users:
            stack.enter_context(patch.object(user, name, other))
        yield


def tried(item: Item, seed: int, out: Path) -> None:
    """Every trial on one case, one after the other; answers that an earlier run got with the same code are kept."""
    path = out / "cases" / f"{item.case}.json"
    key = key_of(item=list(item.__dict__.values()), seed=seed, code=[code_version(m) for m in _CODE])
    answers = _kept(path, key)
    trials = [AS_IT_IS, *((constant, factor) for constant in CONSTANTS for factor in FACTORS)]
    todo = [trial for trial in trials if list(trial) not in [kept["trial"] for kept in answers]]
    if not todo:
        return
    try:
        case = draw(item, seed)
    except FloatingPointError:  # a machine that diverges is no case
        nothing = [{"trial": list(trial), "answer": None} for trial in trials]
        write_text(path, json.dumps({"key": key, "truth": None, "answers": nothing}))
        return
    with tempfile.TemporaryDirectory(prefix="case-") as given:
        write(case, Path(given))
        for constant, factor in todo:
            with scaled(constant, factor) if constant in CONSTANTS else contextlib.nullcontext():
                verdict = blind.answer(Path(given), ENGINE)
            answers.append({"trial": [constant, factor], "answer": verdict})
            write_text(path, json.dumps({"key": key, "truth": case.truth, "answers": answers}))


_CODE = ("twinbench.proof.concealed.generate", ENGINE.partition(":")[0])


def _kept(path: Path, key: str) -> list[dict[str, Any]]:
    try:
        known = json.loads(path.read_text())
        return list(known["answers"]) if known["key"] == key else []
    except (OSError, ValueError, KeyError):
        return []


def rows_of(item: Item, seed: int, out: Path) -> list[dict[str, Any]]:
    """The rows of ``cases.csv`` that a case's answers come to; none where no machine could be drawn."""
    known = json.loads((out / "cases" / f"{item.case}.json").read_text())
    if known["truth"] is None:
        return []
    sealed = seal(known["truth"])
    return [
        {**score(sealed, sealed.digest, kept["answer"], seed=seed), **dict(zip(TRIAL, kept["trial"], strict=True))}
        for kept in known["answers"]
    ]


def table(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per constant and factor, beside the constants as they are.

    Columns: constant, factor, cases, differ (verdicts with other names or sets), gained and lost (right names or
    classes that the others do not have), right, wrong (verdicts with a wrong name).

    Args:
        rows: of ``cases.csv``, with ``constant`` and ``factor``.
    """
    marked = with_marks(rows).set_index("case")
    base, found = marked[marked["constant"] == AS_IT_IS[0]], []
    for (constant, factor), own in marked.groupby(list(TRIAL), sort=False):
        usual = base.loc[own.index]
        found.append(
            {
                "constant": constant,
                "factor": factor,
                "cases": len(own),
                "differ": int(((own["named"] != usual["named"]) | (own["set"] != usual["set"])).sum()),
                "gained": int((own["by_class"] & ~usual["by_class"]).sum()),
                "lost": int((~own["by_class"] & usual["by_class"]).sum()),
                "right": int(own["by_class"].sum()),
                "wrong": int(own["wrong_name"].sum()),
            }
        )
    return pd.DataFrame(found)


def as_markdown(found: pd.DataFrame) -> str:
    """The table to read, with what each constant is."""
    head = ["constant", "is", "times", "verdicts that differ", "right", "gained", "lost", "wrong"]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for _, row in found.iterrows():
        counts = [str(row[c]) for c in ("differ", "right", "gained", "lost", "wrong")]
        name, says = row["constant"].rpartition(".")[2], CONSTANTS.get(row["constant"], "")
        cells = [name, says, f"{row['factor']:g}", *counts]
        lines.append(f"| {' | '.join(cells)} |")
    return f"{found['cases'].max()} cases each.\n\n" + "\n".join(lines) + "\n"


@refusing("twinbench.proof.sensitivity")
def main(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m twinbench.proof.sensitivity", description=__doc__)
    parser.add_argument("--cases", type=int, default=60, help="development cases to draw")
    parser.add_argument("--seed", type=int, default=7, help="of the cases; never one that is reported on")
    parser.add_argument("--jobs", type=int, default=0, help="processes; as many as there are cores if 0")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "sensitivity", help="for rows and tables")
    asked = parser.parse_args(arguments)
    out = asked.out.absolute()
    if asked.cases < 1:
        raise BadInput(f"--cases is {asked.cases}, must be at least 1")
    check_writable(out)
    items = cases(asked.cases, asked.seed)
    several = {f"case {item.case}": (item, asked.seed, out) for item in items}
    each("cases", tried, several, out, asked.jobs)
    rows = [row for item in items for row in rows_of(item, asked.seed, out)]
    write_text(out / "cases.csv", pd.DataFrame(rows, columns=[*TRIAL, *COLUMNS]).to_csv(index=False))
    found = table(read_cases(out / "cases.csv"))
    write_text(out / "sensitivity.csv", found.to_csv(index=False))
    write_text(out / "sensitivity.md", as_markdown(found))
    command = f"python -m twinbench.proof.sensitivity --cases {asked.cases} --seed {asked.seed}"
    write_manifest(out, command, asked.seed)
    print(as_markdown(found), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
