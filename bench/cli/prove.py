"""``twinbench prove``: concealed effects."""

from __future__ import annotations

import argparse

from twinbench.bench.cli.output import command_line, rows_of, tell
from twinbench.bench.cli.parser import add_draws

SAYS = "hide effects in simulated machines and see whether mismatch finds them"
EXAMPLE = (
    "twinbench prove --cases 40 --out results/prove\n\n"
    "Each case is drawn from the seed. Its truth is sealed, the engine is asked without it, and the answer is judged.\n"
    "The same command goes on where it stopped."
)


def add_options(parser: argparse.ArgumentParser) -> None:
    add_draws(parser, "--cases", 40, "how many", "results/prove")
    parser.add_argument(
        "--engines",
        default="twinbench",
        metavar="NAME,...",
        help="engines to ask: twinbench (default), oracle, opponents, ablations or all; a wrong name lists them; "
        "before=FOLDER is that of another checkout of Twinbench",
    )
    parser.add_argument(
        "--opponent-cases",
        type=int,
        metavar="N",
        help="cases for each engine but twinbench and the oracle, spread over all (default: all)",
    )


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    import pandas as pd
    from rich.console import Console

    from twinbench.proof.concealed.engines import chosen
    from twinbench.proof.concealed.gates import as_markdown
    from twinbench.proof.concealed.suite import Study, run

    engines = chosen(a.engines)
    command = command_line()
    console = Console(stderr=True)
    study = Study(a.cases, a.seed, engines, a.opponent_cases)
    gates = run(study, a.out, console, command=command)
    if a.json:
        compared = rows_of(pd.read_csv(a.out / "engines.csv"))
        tell(a, {"gates": rows_of(gates), "engines": compared, "out": str(a.out.resolve())})
        return 0
    print(as_markdown(gates))
    if len(engines) > 1:
        print((a.out / "engines.md").read_text())
    return 0
