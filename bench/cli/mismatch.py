"""``twinbench mismatch``: what a simulator leaves out, and by which exit status a program reads it."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli import mismatch_status
from twinbench.bench.cli.parser import SIMULATOR_HELP, add_map, add_recordings, add_trust

SAYS = "find what a simulator leaves out, name it, model it, and prove it on held-out recordings"
EXAMPLE = (
    "twinbench mismatch tanks.py day1.csv day2.csv --hold-out day3.csv --out found --map 'LT1[cm]=level_m'\n\n"
    "DIR gets verdict.json, report.html, report.pdf of one page, model.toml, which is the mended simulator, and\n"
    "sizes.csv, which is how large each effect was over time.\n"
    "twinbench schema verdict says what verdict.json holds; --json prints the same to stdout.\n"
    "exit status:\n"
    + "\n".join(f"  {status:3}  {says}" for status, says in mismatch_status.SAYS.items())
    + "\n    2  bad input"
)
FILES = {
    "report.html": "report",
    "report.pdf": "on one page",
    "verdict.json": "for programs",
    "model.toml": "mended model",
    "sizes.csv": "sizes over time",
}
"""What is written, and what it is called where the terminal lists it."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("simulator", metavar="SIMULATOR", help=SIMULATOR_HELP)
    add_recordings(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for what was found")
    parser.add_argument(
        "--hold-out",
        nargs="+",
        default=(),
        type=Path,
        metavar="RECORDING",
        help="recordings for the proof, best of another operating regime; no parameter is learnt from them",
    )
    add_told(parser)
    add_trust(parser)
    add_map(parser)


def add_told(parser: argparse.ArgumentParser) -> None:
    """What is tried, and what the user knows beforehand."""
    parser.add_argument(
        "--catalogue",
        default="",
        metavar="FILE",
        help="also try mechanisms of your own: path/to/file.py[:NAME]",
    )
    parser.add_argument(
        "--inputs",
        choices=("auto", "held", "linear"),
        default="auto",
        help="what inputs do between samples: hold their value, or go in lines; auto (default) tries both",
    )
    for option, metavar, says in (
        ("--leave-out", "NAME", "do not try these candidates; NAME may hold *, as 'offset@*'"),
        ("--prior", "NAME=ODDS", "how likely a candidate is, as odds: 0.1 is one to ten"),
        (
            "--measured",
            "INPUT=SD UNIT",
            "an input is measured, with noise of this standard deviation: p_suc_bar=0.01bar",
        ),
    ):
        parser.add_argument(option, action="append", default=[], metavar=metavar, help=says)


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from shutil import get_terminal_size

    from twinbench.mismatch.report.explain import Request, explain

    asked = Request(
        a.simulator, a.recordings, a.hold_out, a.catalogue, a.map, a.trust, a.inputs, a.leave_out, a.prior, a.measured
    )
    verdict, document = explain(asked, a.out)
    # What was found is told before it is drawn: drawing takes a while, and may fail.
    from twinbench.common.documents import to_json
    from twinbench.mismatch.report.sheet import write_sheet
    from twinbench.mismatch.report.write import to_text, write_page

    told = to_json(document) if a.json else to_text(verdict, get_terminal_size().columns)
    print(told, file=a.stdout if a.json else None, flush=True)
    write_page(verdict, a.out)
    write_sheet(verdict, document["provenance"], a.out)
    if not a.json:
        for name, says in FILES.items():
            print(f"{says}: {(a.out / name).resolve()}")
    return mismatch_status.STATUS[verdict.verdict]
