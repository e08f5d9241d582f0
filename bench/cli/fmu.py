"""``twinbench fmu``: a simulator for other tools."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli.output import tell_files
from twinbench.bench.cli.parser import SIMULATOR_HELP, add_trust

SAYS = "write a simulator, mended or not, as an FMU for model exchange and co-simulation, with nothing of Python in it"
EXAMPLE = "twinbench fmu found/model.toml --out mended.fmu"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("simulator", metavar="SIMULATOR", help=SIMULATOR_HELP)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="the FMU, a name that ends in .fmu")
    add_trust(parser)


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from twinbench.mismatch.as_fmu import write_as_fmu

    write_as_fmu(a.simulator, a.out, a.trust)
    tell_files(a, [a.out])
    return 0
