"""``twinbench report``: tables, figures and page again."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli.output import rows_of, tell

SAYS = "make tables, figures and the report again from what is stored"
EXAMPLE = "twinbench report results/quick"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("results", type=Path, metavar="DIR", help="folder of a run")


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from twinbench.bench.report.write import write_report
    from twinbench.common.errors import BadInput

    if not (a.results / "manifest.json").is_file():
        raise BadInput(f"{a.results} holds no run (no manifest.json); make one with: twinbench run --out {a.results}")
    comparison = write_report(a.results)
    page = (a.results / "report.html").resolve()
    if a.json:
        tell(a, {"comparison": rows_of(comparison.frame), "report": str(page)})
    else:
        print(f"report: {page}")
    return 0
