"""``twinbench fleet``: many machines of one kind; what all of them lack, and which of them are unlike the others."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli import mismatch_status
from twinbench.bench.cli.mismatch import add_told
from twinbench.bench.cli.parser import SIMULATOR_HELP, add_map, add_trust

SAYS = "find what a simulator leaves out in all machines of a fleet, and which machines are unlike the others"
EXAMPLE = (
    "twinbench fleet tanks.py plant1/ plant2/ plant3/ --out found\n\n"
    "Each folder holds one machine's recordings; of several the last by name is held out.\n"
    "DIR gets fleet.json, report.html and machines/, where each machine has its own verdict.json.\n"
    "exit status:\n"
    "    0  nothing is missing in all machines, and none is unlike the others\n"
    "   10  something is named that all lack, or that one has\n"
    "   11  something is there that has no name\n"
    "    2  bad input"
)
STATUS = {
    "consistent": mismatch_status.AGREES,
    "named": mismatch_status.NAMED,
    "unnamed": mismatch_status.UNNAMED,
}


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("simulator", metavar="SIMULATOR", help=SIMULATOR_HELP)
    parser.add_argument(
        "machines", nargs="+", type=Path, metavar="MACHINE", help="a folder with one machine's recordings"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for what was found")
    add_told(parser)
    add_trust(parser)
    add_map(parser)


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from shutil import get_terminal_size
    from textwrap import fill

    from twinbench.mismatch.fleet.asking import requests
    from twinbench.mismatch.fleet.examine import examined
    from twinbench.mismatch.fleet.write import write_fleet_page
    from twinbench.mismatch.report.explain import Request

    like = Request(a.simulator, (), (), a.catalogue, a.map, a.trust, a.inputs, a.leave_out, a.prior, a.measured)
    fleet, told = examined(requests(a.machines, like), a.out)
    if a.json:
        print(told, file=a.stdout, flush=True)
    else:
        width = get_terminal_size().columns
        points = [fill(p, width, initial_indent="- ", subsequent_indent="  ") for p in fleet.points]
        print("\n".join([fill(fleet.says, width), "", *points, ""]), flush=True)
    write_fleet_page(fleet, a.simulator, a.out)
    if not a.json:
        print(f"report: {(a.out / 'report.html').resolve()}\nfor programs: {(a.out / 'fleet.json').resolve()}")
    return STATUS[fleet.verdict]
