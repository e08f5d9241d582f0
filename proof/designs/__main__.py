"""Does the proposed experiment settle a set? ``python -m twinbench.proof.designs --draws 1300 --seed 1`` tries it.

Concealed machines with one effect are recorded too narrowly. Where the verdict is a set that holds the right name, and
the ideal observer could tell it by an ordinary recording within the limits, up to three experiments are made on the
machine, each by itself: the proposed one, one by chance of those that it was chosen from, and the old inputs once more.
The engine is asked again after each, and so is the ideal observer. The same command goes on where it stopped.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from twinbench.common.threads import pin

pin()

import pandas as pd  # noqa: E402  threads are pinned before NumPy is there

from twinbench.common.errors import BadInput  # noqa: E402
from twinbench.common.store import check_writable, write_text  # noqa: E402
from twinbench.common.versions import write_manifest  # noqa: E402
from twinbench.proof.command import each, refusing  # noqa: E402
from twinbench.proof.designs.plan import drawn_items  # noqa: E402
from twinbench.proof.designs.tables import as_markdown, rows_of, summary  # noqa: E402
from twinbench.proof.designs.trial import tried  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]


@refusing("twinbench.proof.designs")
def main(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m twinbench.proof.designs", description=__doc__)
    parser.add_argument("--draws", type=int, default=1300, help="machines to draw; some verdicts on them are sets")
    parser.add_argument("--seed", type=int, default=1, help="of the draws")
    parser.add_argument("--jobs", type=int, default=0, help="processes; as many as there are cores if 0")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "designs", help="for cases and tables")
    asked = parser.parse_args(arguments)
    out = asked.out.absolute()
    if asked.draws < 1:
        raise BadInput(f"--draws is {asked.draws}, must be at least 1")
    check_writable(out)
    items = drawn_items(asked.draws, asked.seed)
    several = {f"case {item.case}": (item, asked.seed, out) for item in items}
    each("machines", tried, several, out, asked.jobs)
    rows = pd.DataFrame([rows_of(item, out) for item in items])
    write_text(out / "cases.csv", rows.to_csv(index=False))
    table = summary(rows)
    write_text(out / "designs.csv", table.to_csv(index=False, float_format="%.4g"))
    write_text(out / "designs.md", as_markdown(table, rows))
    write_manifest(out, f"python -m twinbench.proof.designs --draws {asked.draws} --seed {asked.seed}", asked.seed)
    print(as_markdown(table, rows), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
