"""``twinbench tune``: settings chosen on the validation sequences."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli.output import command_line, tell
from twinbench.bench.cli.parser import add_machine

SAYS = "choose an estimator's settings on the validation sequences"
EXAMPLE = "twinbench tune gru_kf --trials 20"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("estimators", nargs="+", metavar="NAME", help="estimators' names, or path/to/file.py[:Class]")
    add_machine(parser, default="")
    parser.add_argument("--profile", default="tuning", help="profile of the data and the training (default: tuning)")
    parser.add_argument(
        "--trials", type=int, default=20, metavar="N", help="trials in all, earlier ones included (default: 20)"
    )
    parser.add_argument("--online", action="store_true", help="tune only settings that need no new training")
    parser.add_argument(
        "--out", type=Path, default=Path("results/tuning"), metavar="DIR", help="folder (default: results/tuning)"
    )


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    import tomllib

    from rich.console import Console

    from twinbench.bench.profile import profile_on
    from twinbench.bench.tune import tune

    profile = profile_on(a.profile, a.machine)
    chosen = tune(a.estimators, profile, a.out, a.trials, Console(stderr=True), command_line(), a.online)
    if a.json:
        tell(a, [tomllib.loads(section)["settings"] for section in chosen])
    else:
        print("".join(chosen), end="")
    return 0
