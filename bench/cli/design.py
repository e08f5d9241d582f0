"""``twinbench design``: which experiment would tell apart what the recordings cannot."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli.parser import SIMULATOR_HELP, add_trust

SAYS = "propose the experiment that would tell apart what the recordings cannot"
EXAMPLE = (
    "twinbench design tanks.py --verdict found/verdict.json --inputs limits.toml --out next\n\n"
    "limits.toml says what may be done to the machine:\n"
    "  [experiment]\n  duration_s = 1200\n  sampling_s = 0.5\n"
    "  [inputs.pump_V]\n  low = 2.0\n  high = 6.5\n  rate_per_s = 0.5\n\n"
    "DIR gets inputs.csv, the experiment's inputs, a figure of it, and design.json, which says what it promises."
)
FILES = {"inputs.csv": "inputs", "figures/experiment.png": "drawn", "design.json": "for programs"}


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("simulator", metavar="SIMULATOR", help=SIMULATOR_HELP)
    parser.add_argument(
        "--rivals",
        default="",
        metavar="A,B,...",
        help="effects to tell apart, by name (default: what the verdict could not tell apart)",
    )
    parser.add_argument(
        "--verdict", type=Path, metavar="FILE", help="verdict.json that mismatch wrote on the recordings at hand"
    )
    parser.add_argument(
        "--inputs",
        type=Path,
        required=True,
        metavar="LIMITS",
        help="TOML file of what the inputs and the experiment may be",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the proposal")
    parser.add_argument(
        "--catalogue", default="", metavar="FILE", help="mechanisms of your own: path/to/file.py[:NAME]"
    )
    add_trust(parser)


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from shutil import get_terminal_size

    from twinbench.common.documents import to_json
    from twinbench.common.progress import Progress
    from twinbench.common.store import check_writable
    from twinbench.mismatch.design.request import DesignRequest, design
    from twinbench.mismatch.design.write import document_of, to_text, write_design

    rivals = [name.strip() for name in a.rivals.split(",") if name.strip()]
    asked = DesignRequest(a.simulator, rivals, a.inputs, a.verdict, a.catalogue, a.trust)
    check_writable(a.out)
    with Progress() as progress:
        designed = design(asked, progress.report)
    document = document_of(designed, asked)
    write_design(designed, document, a.out)
    if a.json:
        print(to_json(document), file=a.stdout)
        return 0
    print(to_text(designed, get_terminal_size().columns))
    for name, told in FILES.items():
        print(f"{told}: {(a.out / name).resolve()}")
    return 0
