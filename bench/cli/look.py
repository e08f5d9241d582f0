"""``twinbench look``: what a recording holds."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from twinbench.bench.cli.output import tell
from twinbench.bench.cli.parser import RECORDING_HELP, add_map

if TYPE_CHECKING:
    from twinbench.data.look.whole import Look

SAYS = "say what a recording holds: channels, units, rates, gaps, stretches that stand still, noise"
EXAMPLE = """twinbench look day.mf4 --out looked --map 'PT101[psig]=p_dis_bar'

Nothing is converted: each channel is shown in the unit in which the file has it. --map gives names and units."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="RECORDING", help=RECORDING_HELP)
    add_map(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the figure (default: none is drawn)")


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from twinbench.data.look.whole import look
    from twinbench.data.look.words import told

    seen = look(a.recording, a.map)
    files = [] if a.out is None else [_draw(seen, a.out)]
    if a.json:
        tell(a, {**seen.to_json(), "files": [str(file) for file in files]})
    else:
        print("\n".join([*told(seen), *map(str, files)]))
    return 0


def _draw(seen: Look, out: Path) -> Path:
    from twinbench.common.store import write_atomically
    from twinbench.common.style import png
    from twinbench.data.look.figure import look_figure

    path = out / f"{seen.name}.look.png"
    write_atomically(path, lambda beside: beside.write_bytes(png(look_figure(seen))))
    return path
