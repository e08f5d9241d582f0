"""``twinbench compare``: which trained estimator foretells a user's own recordings best."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli.output import command_line, tell
from twinbench.bench.cli.parser import add_machine, add_map, add_recordings, add_training

SAYS = "hold trained estimators against your own recordings, where nobody knows the truth"
EXAMPLE = """twinbench run --machine mine.py --profile quick
  twinbench compare --machine mine.py day1.csv day2.csv --out compared

Each estimator runs over each recording and foretells its readings 1, 10 and 60 s ahead, with the inputs that
followed. What it foretells is held against what was read. The recording is the unit: six or more are needed
before estimators are told apart."""


def add_options(parser: argparse.ArgumentParser) -> None:
    add_recordings(parser)
    add_machine(parser, default="")
    add_training(parser)
    add_map(parser)
    parser.add_argument(
        "--only", nargs="+", default=(), metavar="NAME", help="these estimators alone (default: all that are trained)"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the table and the scores")


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from shutil import get_terminal_size

    from twinbench.bench.cli.output import rows_of
    from twinbench.bench.compare.run import compare, write
    from twinbench.bench.estimate.apply import Training
    from twinbench.bench.report.table_formats import to_text

    found = compare(Training(a.profile, a.results, a.machine), a.only, a.recordings, a.map, a.out)
    write(a.out, found, command_line())
    if a.json:
        tell(a, {"comparison": rows_of(found.table.frame), "says": found.sentences, "failed": found.failed})
        return 1 if found.failed else 0
    print(to_text(found.table, get_terminal_size().columns))
    print("\n".join(found.sentences))
    for name, why in found.failed.items():
        print(f"failed: {name}: {why}")
    return 1 if found.failed else 0
