"""``twinbench prove``: concealed effects."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli.output import command_line, rows_of, tell

SAYS = "hide effects in simulated machines and see whether mismatch finds them"
EXAMPLE = (
    "twinbench prove --cases 40 --out results/prove\n\n"
    "draws each case from the seed, seals the truth, asks the engine blindly and judges; resumes where it stopped"
)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--cases", type=int, default=40, metavar="N", help="how many (default: 40)")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="1 is for development (default)")
    parser.add_argument("--out", type=Path, default=Path("results/prove"), metavar="DIR")
    parser.add_argument(
        "--engines",
        default="twinbench",
        metavar="NAME,...",
        help="whom to ask: twinbench (default), oracle, opponents, ablations, or all; an unknown name lists them",
    )
    parser.add_argument(
        "--opponent-cases",
        type=int,
        metavar="N",
        help="so many cases, spread over all, for all but twinbench and oracle (default: all)",
    )


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    import pandas as pd
    from rich.console import Console

    from twinbench.proof.concealed.engines import chosen
    from twinbench.proof.concealed.gates import as_markdown
    from twinbench.proof.concealed.suite import run

    engines = chosen(a.engines)
    command = command_line()
    console = Console(stderr=True)
    gates = run(a.cases, a.seed, a.out, console, engines, opponent_cases=a.opponent_cases, command=command)
    if a.json:
        compared = rows_of(pd.read_csv(a.out / "engines.csv"))
        tell(a, {"gates": rows_of(gates), "engines": compared, "out": str(a.out.resolve())})
        return 0
    print(as_markdown(gates))
    if len(engines) > 1:
        print((a.out / "engines.md").read_text())
    return 0
