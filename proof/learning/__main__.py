"""Learn the decision: ``python -m twinbench.proof.learning --cases 400 --seed 3001`` draws cases and writes the rule.

Cases that are finished are kept in ``results/learning`` and serve again while engine and generator are as they were.
``--rough`` draws cases whose simulator is as rough as those of real rigs. ``--rows FOLDER`` learns from rows that are
there and draws none. ``tradeoff.csv`` and ``tradeoff.svg`` show what stricter and laxer rules would say.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twinbench.common.errors import BadInput
from twinbench.common.store import check_writable, write_text
from twinbench.common.style import svg
from twinbench.common.versions import provenance
from twinbench.mismatch.naming.decision import RULE
from twinbench.proof.command import each, refusing
from twinbench.proof.concealed.plan import cases
from twinbench.proof.learning.collect import collected, roughened
from twinbench.proof.learning.fit import learnt
from twinbench.proof.learning.tradeoff import tradeoff, tradeoff_figure

ROOT = Path(__file__).resolve().parents[2]
FEWEST = 50
"""Cases from which a rule can be learnt at all."""


@refusing("twinbench.proof.learning")
def main(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m twinbench.proof.learning", description=__doc__)
    parser.add_argument("--cases", type=int, default=1080, help="development cases to draw")
    parser.add_argument("--seed", type=int, default=3001, help="of the cases; never one that is reported on")
    parser.add_argument("--rough", action="store_true", help="let simulators be as rough as those of real rigs")
    parser.add_argument("--jobs", type=int, default=0, help="processes; as many as there are cores if 0")
    parser.add_argument("--rows", type=Path, help="a folder with rows that were collected, in place of drawing cases")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "learning", help="for rows, table and figure")
    asked = parser.parse_args(arguments)
    rows = _read(asked.rows) if asked.rows else _collected(asked)
    if len(rows) < FEWEST:
        raise BadInput(f"{len(rows)} cases are too few to learn from; collect at least {FEWEST}")
    rule = learnt(rows)
    seeds = sorted({int(row["seed"]) for row in rows})
    curve = tradeoff(rows)
    asked.out.mkdir(parents=True, exist_ok=True)
    write_text(asked.out / "tradeoff.csv", curve.to_csv(index=False, float_format="%.4g"))
    write_text(asked.out / "tradeoff.svg", svg(tradeoff_figure(curve, rule["say_name"])))
    facts = {"command": _command(asked.rows), "seeds": seeds, **provenance()}
    write_text(RULE, json.dumps({**rule, "provenance": facts}, indent=1) + "\n")
    print(json.dumps(rule["left_out"], indent=1))
    return 0


def _command(rows: Path | None) -> str:
    return "python -m twinbench.proof.learning" + (f" --rows {rows}" if rows else "")


def _read(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))]


def _collected(asked: argparse.Namespace) -> list[dict[str, Any]]:
    out, seed = asked.out.absolute(), asked.seed
    check_writable(out)
    items = cases(asked.cases, seed)
    items = roughened(items, seed) if asked.rough else items
    several = {f"case {item.case}": (item, seed, out) for item in items}
    each("cases", collected, several, out, asked.jobs)
    return [json.loads((out / f"{seed}-{item.case}.json").read_text()) for item in items]


if __name__ == "__main__":
    sys.exit(main())
