"""``twinbench check``: the contract battery."""

from __future__ import annotations

import argparse

from twinbench.bench.cli.output import tell
from twinbench.bench.cli.parser import add_machine

SAYS = "test whether an estimator keeps the contract"
EXAMPLE = "twinbench check my_baseline.py\n  twinbench check oracle --machine my_machine.py"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("estimator", metavar="NAME", help="an estimator's name, or path/to/file.py[:Class]")
    add_machine(parser)


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from twinbench.bench.contract import run_battery
    from twinbench.bench.registry import find
    from twinbench.machines.load import load_machine

    results = run_battery(find(a.estimator), load_machine(a.machine))
    failed = sum(r.status == "fail" for r in results)
    if a.json:
        tell(a, [{"name": r.name, "status": r.status, "detail": r.detail} for r in results])
        return 1 if failed else 0
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table("check", "status", "detail", box=None)
    colours = {"pass": "green", "fail": "red", "skip": "yellow"}
    for r in results:
        table.add_row(r.name, f"[{colours[r.status]}]{r.status}[/]", escape(r.detail))
    Console().print(table, f"{len(results)} checks, {failed} failed")
    return 1 if failed else 0
