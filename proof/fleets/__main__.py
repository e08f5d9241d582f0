"""Judge what is said of fleets: ``python -m twinbench.proof.fleets --fleets 10 --machines 20 --odd 3 --seed 7``.

All machines of a fleet share an effect, and a few have one of their own. ``twinbench fleet`` is asked. The tables hold
how often the shared effect is named, how many odd machines are found, and how many sound ones are accused.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from twinbench.common.errors import BadInput
from twinbench.common.jobs import at_most
from twinbench.common.store import check_writable, write_text
from twinbench.common.versions import write_manifest
from twinbench.mismatch.fleet.asking import requests
from twinbench.mismatch.fleet.examine import examined
from twinbench.mismatch.report.explain import Request
from twinbench.proof.command import refusing
from twinbench.proof.fleets.drawn import draw

ROOT = Path(__file__).resolve().parents[2]


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
    with at_most(asked.jobs):
        rows = [judged(fleet, asked.seed, asked.machines, asked.odd) for fleet in range(asked.fleets)]
    table = pd.DataFrame(rows)
    told = summary(table)
    write_text(out / "fleets.csv", table.to_csv(index=False, float_format="%.4g"))
    write_text(out / "summary.csv", told.to_csv(index=False, float_format="%.3g"))
    command = (
        f"python -m twinbench.proof.fleets --fleets {asked.fleets} --machines {asked.machines} --odd {asked.odd} "
        f"--seed {asked.seed}"
    )
    write_manifest(out, command, asked.seed)
    print(told.to_string(index=False, float_format="%.3g"))
    return 0


def judged(fleet: int, seed: int, machines: int, odd: int) -> dict[str, Any]:
    """One fleet drawn, asked and scored."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="fleet-") as given:
        drawn = draw(fleet, seed, machines, odd, Path(given) / "machines")
        folders = sorted((Path(given) / "machines").iterdir())
        like = Request(str(ROOT / drawn.simulator), (), ())
        found = examined(requests(folders, like), Path(given) / "found").fleet
    named = [c.name for c in found.common if c.named]
    accused = {o.machine for o in found.odd}
    own = {o.machine: o.effects[0][0] if o.effects else "" for o in found.odd}
    return {
        "fleet": fleet,
        "shared": drawn.shared,
        "own": drawn.own,
        "named": " + ".join(named),
        "shared named": float(drawn.shared in named),
        "wrongly named": float(bool(set(named) - {drawn.shared})),
        "odd machines": len(drawn.odd),
        "odd found": len(accused & set(drawn.odd)),
        "odd named right": sum(own.get(name) == drawn.own for name in drawn.odd),
        "sound machines": machines - len(drawn.odd),
        "sound accused": len(accused - set(drawn.odd)),
        "seconds": time.monotonic() - began,
    }


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Rates over all fleets."""
    odd, sound = max(rows["odd machines"].sum(), 1), rows["sound machines"].sum()
    return pd.DataFrame(
        [
            {
                "fleets": len(rows),
                "shared named": rows["shared named"].mean(),
                "wrongly named": rows["wrongly named"].mean(),
                "odd found": rows["odd found"].sum() / odd,
                "odd named right": rows["odd named right"].sum() / odd,
                "sound accused": rows["sound accused"].sum() / sound,
            }
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
