"""``twinbench completion``: a script for the shell."""

from __future__ import annotations

import argparse

SAYS = "print a script that completes commands, options and names in your shell"
EXAMPLE = (
    'eval "$(twinbench completion bash)"\n\n'
    "Put this line into ~/.bashrc, or with zsh into ~/.zshrc. For fish: twinbench completion fish | source"
)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=("bash", "zsh", "fish"))


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from twinbench.bench.cli.completion import script

    print(script(a.parser, a.shell), end="")
    return 0
