"""``twinbench record``: an online run with all that went in and came out."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli.output import tell_files
from twinbench.bench.cli.parser import RECORDING_HELP, add_machine, add_map, add_training

SAYS = "run a trained estimator over a recording as it would run online, and keep all that goes in and comes out"
EXAMPLE = """twinbench record deeponet_kalman plant.csv --out run.npz

run.npz holds the estimator with its weights, every reading, and of every tick what came out and a checksum of that
with all that is carried to the next tick. twinbench replay run.npz does it again. docs/replay.md has the rest."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("estimator", metavar="NAME", help="a trained estimator")
    parser.add_argument("recording", type=Path, metavar="RECORDING", help=RECORDING_HELP)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="the record, by custom a .npz")
    parser.add_argument(
        "--every",
        type=int,
        default=1,
        metavar="N",
        help="keep what came out of one tick in N, and the checksum of each: a smaller file (default: 1)",
    )
    add_machine(parser, default="")
    add_training(parser)
    add_map(parser)


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from twinbench.bench.estimate.apply import Training
    from twinbench.bench.replay.loaded import with_loaded_code
    from twinbench.bench.replay.recorder import record_run

    where = Training(a.profile, a.results, a.machine)
    with_loaded_code(record_run, a.estimator, a.recording, where, a.map, a.every).save(a.out)
    tell_files(a, [a.out])
    return 0
