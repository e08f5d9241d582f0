"""``twinbench flagship``: the nominal model against plants that differ from it in eleven ways."""

from __future__ import annotations

import argparse

from twinbench.bench.cli.output import command_line, rows_of, tell
from twinbench.bench.cli.parser import add_draws

SAYS = "let mismatch mend the nominal model on drawn plants that differ from it in eleven ways"
EXAMPLE = (
    "twinbench flagship --draws 10 --out results/flagship\n\n"
    "Each plant is drawn from the seed. Its truth is sealed, the engine is asked without it, and a Kalman filter runs\n"
    "with the model that it mended."
)


def add_options(parser: argparse.ArgumentParser) -> None:
    add_draws(parser, "--draws", 2, "how many plants", "results/flagship")
    parser.add_argument(
        "--engines",
        default="known_health",
        metavar="NAME,...",
        help="engines to ask: known_health (default; it reads the health beside the sensors), sensors_alone, or told "
        "(it reads the health, and knows the effects' names)",
    )


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from rich.console import Console

    from twinbench.proof.concealed.gates import as_markdown
    from twinbench.proof.flagship.suite import run

    command = command_line()
    engines = [name.strip() for name in a.engines.split(",")]
    gates = run(a.draws, a.seed, a.out, Console(stderr=True), engines, command=command)
    if a.json:
        tell(a, {"gates": rows_of(gates), "out": str(a.out.resolve())})
    else:
        print(as_markdown(gates))
    return 0
