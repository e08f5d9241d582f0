"""``twinbench machines``: finished runs on several machines side by side."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli.output import command_line, rows_of, tell

SAYS = "compare the estimators over finished runs on several machines"
EXAMPLE = (
    "twinbench machines results/paper results/two_tanks results/motor --out results/machines\n\n"
    "One run for each machine. DIR gets machines.md, machines.csv and a manifest that says where each run is from."
)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folders of finished runs")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("results/machines"),
        metavar="DIR",
        help="folder for the table (default: results/machines)",
    )


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from shutil import get_terminal_size

    from twinbench.bench.report.across import write_across
    from twinbench.bench.report.table_formats import to_text

    table = write_across(a.runs, a.out, command_line())
    if a.json:
        tell(a, {"machines": rows_of(table.frame), "out": str(a.out.resolve())})
    else:
        print(to_text(table, get_terminal_size().columns))
    return 0
