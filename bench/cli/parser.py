"""What the parsers of all commands share."""

from __future__ import annotations

import argparse
import sys
from typing import Any, NoReturn

SIMULATOR_HELP = "compressor, nominal, path/to/file.py[:NAME], package.module:NAME, or a model.toml"
TRUST_HELP = "run the Python that a model.toml names though it lies outside its folder and the one you are in"
VERBOSE_HELP = "say on stderr what is done, with times; twice: more"


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
