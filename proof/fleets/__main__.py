"""Judge what is said of fleets: ``python -m twinbench.proof.fleets --fleets 10 --machines 20 --odd 3 --seed 7``.

All machines of a fleet share an effect, and a few have one of their own. ``twinbench fleet`` is asked. The tables hold
how often the shared effect is named, how many odd machines are found, and how many sound ones are accused. The same
command goes on where it stopped.
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
from twinbench.common.jobs import at_most  # noqa: E402
from twinbench.common.store import check_writable, write_text  # noqa: E402
from twinbench.common.versions import write_manifest  # noqa: E402
from twinbench.proof.command import refusing  # noqa: E402
from twinbench.proof.fleets.tables import as_markdown, rows_of, summary  # noqa: E402
from twinbench.proof.fleets.trial import ROOT, Plan, judged, place  # noqa: E402
from twinbench.proof.kept import kept  # noqa: E402


@refusing("twinbench.proof.fleets")
def main(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m twinbench.proof.fleets", description=__doc__)
    parser.add_argument("--fleets", type=int, default=10, help="fleets to draw (default: 10)")
    parser.add_argument("--machines", type=int, default=20, help="machines of a fleet (default: 20)")
    parser.add_argument("--odd", type=int, default=3, help="machines with a fault of their own (default: 3)")
    parser.add_argument("--seed", type=int, default=1, help="of the draws (default: 1, the seed for development)")
    parser.add_argument("--jobs", type=int, help="processes at once (default: one per core)")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "fleets", help="for the tables")
    asked = parser.parse_args(arguments)
    if asked.fleets < 1 or not 2 <= asked.machines or not 0 <= asked.odd < asked.machines:
        raise BadInput("--fleets must be 1 or more, --machines 2 or more, and --odd less than --machines")
    out = asked.out.absolute()
    check_writable(out)
    plan = Plan(asked.seed, asked.machines, asked.odd)
    with at_most(asked.jobs):
        for fleet in range(asked.fleets):
            print(f"fleet {fleet + 1} of {asked.fleets}", file=sys.stderr, flush=True)
            judged(fleet, plan, out)
    every = [found for fleet in range(asked.fleets) if (found := kept(place(fleet, out)))]
    rows = pd.DataFrame([row for found in every for row in rows_of(found)])
    table = summary(rows)
    write_text(out / "fleets.csv", rows.to_csv(index=False, float_format="%.4g"))
    write_text(out / "summary.csv", table.to_csv(index=False, float_format="%.3g"))
    write_text(out / "fleets.md", as_markdown(table, every))
    command = (
        f"python -m twinbench.proof.fleets --fleets {asked.fleets} --machines {asked.machines} --odd {asked.odd} "
        f"--seed {asked.seed}"
    )
    write_manifest(out, command, asked.seed)
    print(as_markdown(table, every), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
