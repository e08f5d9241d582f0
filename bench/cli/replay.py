"""``twinbench replay``: a recorded run again, compared bit by bit."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli.output import tell

REPLAY = """One different bit fails. The first tick and quantity that differ are named, with by how much.
On another processor, or with other versions of the libraries, bits may differ: --within 0.01 then counts as equal what
is off by less than a hundredth of the recorded standard deviation, in the ticks that are kept in full.
exit status:
    0  equal
    1  different
    2  bad input"""

SAYS = "feed a record's readings to its estimator again, and say whether every bit that comes out is as it was"
EXAMPLE = "twinbench replay run.npz\n\n" + REPLAY


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("record", type=Path, metavar="RECORD", help="a file that twinbench record wrote")
    parser.add_argument("--estimator", default="", metavar="FILE", help="where an estimator of your own is (.py)")
    parser.add_argument("--machine", default="", metavar="FILE", help="where a machine of your own is (.py)")
    parser.add_argument(
        "--within",
        type=float,
        default=0.0,
        metavar="SD",
        help="count as equal what is off by so many recorded standard deviations (default: 0, not a bit)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="write the run as it is now, to put in the place of the record"
    )


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from twinbench.bench.replay.again import replay
    from twinbench.bench.replay.loaded import with_loaded_code
    from twinbench.common.documents import strict

    replayed = with_loaded_code(replay, a.record, a.estimator, a.machine, a.within)
    if a.out:
        replayed.now.save(a.out)
    if a.json:
        tell(a, strict(replayed.to_json()))
    else:
        print("\n".join(replayed.told()))
    return 0 if replayed.passed else 1
