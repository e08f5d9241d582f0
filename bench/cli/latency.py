"""``twinbench latency``: the time of one online update."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli.output import command_line, failed_cells, rows_of, tell
from twinbench.bench.cli.parser import add_machine, add_training

SAYS = "time one online update of trained estimators and of their peers, on one core"
EXAMPLE = (
    "twinbench latency --results results/quick\n\n"
    "Updates are timed back to back and at the machine's pace (the compressor's is 20 Hz), beside filterpy's EKF and\n"
    "UKF in the same run. Nothing else should run meanwhile."
)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--estimator", nargs="+", default=(), metavar="NAME", help="estimators to time (default: all that are trained)"
    )
    add_machine(parser, default="")
    add_training(parser)
    parser.add_argument(
        "--updates", type=int, default=2000, metavar="N", help="updates of each, back to back (default: 2000)"
    )
    parser.add_argument(
        "--ticks",
        type=int,
        default=200,
        metavar="N",
        help="updates of each at the machine's pace; 0 for none (default: 200, ten seconds at 20 Hz)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for tables and figures (default: results/latency)"
    )


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from shutil import get_terminal_size

    from rich.console import Console

    from twinbench.bench.estimate.apply import Training
    from twinbench.bench.latency.suite import Counts, run
    from twinbench.bench.report.table_formats import to_text
    from twinbench.common.errors import BadInput

    for name, value, least in (("--updates", a.updates, 10), ("--ticks", a.ticks, 0)):
        if not least <= value <= 10_000_000:
            raise BadInput(f"{name} is {value:,}, must lie in [{least}, 10,000,000]")
    command = command_line()
    out = a.out or Path("results/latency")
    console = Console(stderr=True)
    counts = Counts(a.updates, a.ticks)
    table, failed = run(Training(a.profile, a.results, a.machine), list(a.estimator), counts, out, command, console)
    if a.json:
        tell(a, {"latency": rows_of(table.frame), "failed": failed_cells(failed), "out": str(out.resolve())})
        return 1 if failed else 0
    print(to_text(table, get_terminal_size().columns))
    for outcome in failed:
        print(f"failed: {outcome.cell.estimator}: {outcome.reason}")
    print(f"tables and figures: {out.resolve()}")
    return 1 if failed else 0
