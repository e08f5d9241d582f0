"""``twinbench flagship``: the nominal model against plants that differ from it in eleven ways."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli.output import command_line, rows_of, tell

SAYS = "let mismatch mend the nominal model on drawn plants that differ from it in eleven ways"
EXAMPLE = (
    "twinbench flagship --draws 10 --out results/flagship\n\n"
    "draws each plant from the seed, seals the truth, asks the engine blindly, filters with what it mended"
)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--draws", type=int, default=2, metavar="N", help="how many plants (default: 2)")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="1 is for development (default)")
    parser.add_argument("--out", type=Path, default=Path("results/flagship"), metavar="DIR")
    parser.add_argument("--told", action="store_true", help="also ask an engine that is told the effects' names")


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from rich.console import Console

    from twinbench.proof.concealed.gates import as_markdown
    from twinbench.proof.flagship.suite import ENGINES, run

    command = command_line()
    engines = ENGINES if a.told else ENGINES[:1]
    gates = run(a.draws, a.seed, a.out, Console(stderr=True), engines, command=command)
    if a.json:
        tell(a, {"gates": rows_of(gates), "out": str(a.out.resolve())})
    else:
        print(as_markdown(gates))
    return 0
