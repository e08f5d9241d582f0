"""``twinbench run``: simulate, train, evaluate, compare, report."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli.output import command_line, failed_cells, rows_of, tell
from twinbench.bench.cli.parser import add_machine

SAYS = "run the benchmark: simulate, train, evaluate, compare, report"
EXAMPLE = "twinbench run --only oracle gru_kf"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--profile", default="quick", help="quick, paper, or the path of a .toml file (default: quick)")
    add_machine(parser, default="")
    parser.add_argument(
        "--only",
        nargs="+",
        default=(),
        metavar="NAME",
        help="run these estimators alone, by name or path/to/file.py; the rows of all others in --out stay",
    )
    parser.add_argument(
        "--ablations",
        action="store_true",
        help="also run each estimator without each of its parts; twinbench list ablations names them",
    )
    parser.add_argument(
        "--robustness",
        action="store_true",
        help="also test under more noise and dropout, faster wear, loads beyond the envelope and sensor faults",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for the results (default: results/<profile>, and the machine)"
    )
    parser.add_argument(
        "--resume",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="keep what an earlier run finished (default), or run it again",
    )


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from shutil import get_terminal_size

    from twinbench.bench.profile import folder_of, profile_on
    from twinbench.bench.report.table_formats import to_text
    from twinbench.bench.runner import Wanted, run

    profile = profile_on(a.profile, a.machine)
    out = a.out or folder_of(profile, a.machine)
    command = command_line()
    wanted = Wanted(tuple(a.only), a.ablations, a.robustness, a.resume)
    finished = run(profile, out, wanted, command)
    if a.json:
        page = str((out / "report.html").resolve())
        rows = rows_of(finished.comparison.frame)
        tell(a, {"comparison": rows, "failed": failed_cells(finished.failed), "report": page})
        return 1 if finished.failed else 0
    print(to_text(finished.comparison, get_terminal_size().columns))
    for outcome in finished.failed:
        print(f"failed: {outcome.cell.estimator}, seed {outcome.cell.seed}, {outcome.stage}: {outcome.reason}")
    print(f"report: {(out / 'report.html').resolve()}")
    return 1 if finished.failed else 0
