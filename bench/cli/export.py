"""``twinbench export``: the trained operator for a controller."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli.output import tell_files
from twinbench.bench.cli.parser import add_training

SAYS = "write a trained DeepONet-Kalman as an ONNX graph and arrays, for machines without this package"
EXAMPLE = (
    "twinbench export --results results/quick --out controller\n\n"
    "DIR gets operator.onnx and filter.npz. docs/controller.md has the thirty lines that run them."
)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the two files")
    parser.add_argument(
        "--estimator",
        default="deeponet_kalman",
        metavar="NAME",
        help="deeponet_kalman (default) or one of its ablations",
    )
    add_training(parser)


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from twinbench.bench.export import export

    tell_files(a, export(a.estimator, a.out, a.profile, a.results))
    return 0
