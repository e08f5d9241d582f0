"""What the parsers of all commands share."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, NoReturn

SIMULATOR_HELP = (
    "compressor, nominal, path/to/file.py[:NAME], package.module:NAME, path/to/machine.fmu, or a model.toml"
)
MACHINE_HELP = "compressor, two_tanks, motor, path/to/file.py[:NAME], or package.module:NAME (default: compressor)"
RECORDING_HELP = ".csv, .csv.gz, .parquet, .mat, .mf4, .tdms, .mcap, .bag or .db3"
VERBOSE_HELP = "report progress in detail on stderr; give it twice for more"


def add_training(parser: argparse.ArgumentParser) -> None:
    """Which trained estimators are meant: ``--profile`` and ``--results``."""
    parser.add_argument("--profile", default="quick", help="use what this profile trained (default: quick)")
    parser.add_argument(
        "--results",
        type=Path,
        metavar="DIR",
        help="use what the run in this folder trained (default: results/<profile>, and the machine)",
    )


def add_machine(parser: argparse.ArgumentParser, default: str = "compressor") -> None:
    """Of which machine: ``--machine``. With an empty default a profile may say it."""
    parser.add_argument("--machine", default=default, metavar="MACHINE", help=MACHINE_HELP)


def add_recordings(parser: argparse.ArgumentParser) -> None:
    """The recordings that a command reads."""
    parser.add_argument("recordings", nargs="+", type=Path, metavar="RECORDING", help=RECORDING_HELP)


def add_map(parser: argparse.ArgumentParser) -> None:
    """What the columns of recordings mean: ``--map``."""
    parser.add_argument(
        "--map",
        action="append",
        default=[],
        metavar="COLUMN[UNIT]=CHANNEL",
        help="read a channel from another column, in another unit",
    )


def add_trust(parser: argparse.ArgumentParser) -> None:
    """May a model.toml run Python from anywhere: ``--trust``."""
    says = "allow a model.toml to run Python files outside its own folder and the present one"
    parser.add_argument("--trust", action="store_true", help=says)


def add_draws(parser: argparse.ArgumentParser, count: str, default: int, says: str, out: str) -> None:
    """What a study of drawn machines takes: how many (``count`` is the option's name), ``--seed`` and ``--out``."""
    parser.add_argument(count, type=int, default=default, metavar="N", help=f"{says} (default: {default})")
    parser.add_argument(
        "--seed", type=int, default=1, metavar="S", help="seed of the draws (default: 1, the seed for development)"
    )
    parser.add_argument(
        "--out", type=Path, default=Path(out), metavar="DIR", help=f"folder for the results (default: {out})"
    )


def add_backend(parser: argparse.ArgumentParser) -> None:
    """Where the work is done: ``--backend`` and ``--scheduler``."""
    parser.add_argument(
        "--backend",
        choices=("joblib", "dask"),
        help="work in processes of this machine (joblib, the default) or on a Dask cluster (dask)",
    )
    parser.add_argument(
        "--scheduler",
        default="",
        metavar="ADDRESS",
        help="the cluster's scheduler, tcp://host:port or the path of its scheduler file; stands for --backend dask",
    )


class Parser(argparse.ArgumentParser):
    """Usage errors in one line, as all bad input."""

    def error(self, message: str) -> NoReturn:
        from twinbench.common.shown import printable

        print(f"{self.prog}: {printable(message)}; see {self.prog} --help", file=sys.stderr)
        raise SystemExit(2)


class Version(argparse.Action):
    """The version, and in a checkout the commit: asked for only when somebody asks."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        from twinbench.common.versions import version

        print(f"twinbench {version()}")
        parser.exit()
