"""Completion of the command line in bash, zsh and fish: a script made from the parser itself."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

from twinbench.bench.roster import LABELS

_NAMED = {
    "estimator": " ".join(LABELS),
    "profile": " ".join(sorted(p.stem for p in (Path(__file__).parents[1] / "profiles").glob("*.toml"))),
}
"""What may stand after an option, or for an argument, that says which estimator or profile."""
_ALIASES = {"only": "estimator", "estimators": "estimator"}

_BASH = """_twinbench() {{
    local word="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" command="" words="" i
    for ((i = 1; i < COMP_CWORD; i++)); do
        [[ "${{COMP_WORDS[i]}}" != -* ]] && {{ command="${{COMP_WORDS[i]}}"; break; }}
    done
    case "$command $before" in
{values}
    *) case "$command" in
{commands}
        esac ;;
    esac
    COMPREPLY=($(compgen -W "$words" -- "$word"))
    [[ -n "$command" && "$word" != -* ]] && COMPREPLY+=($(compgen -f -- "$word"))
}}
complete -o filenames -F _twinbench twinbench
"""


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """What a shell must read to complete ``twinbench``."""
    commands = _commands(parser)
    if shell == "fish":
        return "\n".join(_fish(commands)) + "\n"
    bash = _bash(commands)
    return bash if shell == "bash" else f"autoload -U +X bashcompinit && bashcompinit\n{bash}"


def _commands(parser: argparse.ArgumentParser) -> dict[str, tuple[str, argparse.ArgumentParser]]:
    """What each command says of itself, and its parser."""
    (subparsers,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    says = {choice.dest: choice.help or "" for choice in subparsers._choices_actions}
    return {name: (says[name], sub) for name, sub in subparsers.choices.items()}


def _words(action: argparse.Action) -> str:
    """What may stand for an option's value or an argument; empty: anything, or a file."""
    return " ".join(map(str, action.choices or ())) or _NAMED.get(_ALIASES.get(action.dest, action.dest), "")


def _bash(commands: dict[str, tuple[str, argparse.ArgumentParser]]) -> str:
    values, words = [], [f'        "") words="{" ".join(commands)} --help --version" ;;']
    for name, (_, sub) in commands.items():
        options = [o for action in sub._actions for o in action.option_strings]
        arguments = [_words(action) for action in sub._actions if not action.option_strings]
        words.append(f'        {name}) words="{" ".join(filter(None, [*options, *arguments]))}" ;;')
        for action in sub._actions:
            if action.option_strings and _words(action):
                patterns = "|".join(f'"{name} {option}"' for option in action.option_strings)
                values.append(f'    {patterns}) words="{_words(action)}" ;;')
    return _BASH.format(values="\n".join(values), commands="\n".join(words))


def _fish(commands: dict[str, tuple[str, argparse.ArgumentParser]]) -> list[str]:
    lines = []
    for name, (says, sub) in commands.items():
        lines.append(f"complete -c twinbench -f -n __fish_use_subcommand -a {name} -d {shlex.quote(says)}")
        here = f"complete -c twinbench -n '__fish_seen_subcommand_from {name}'"
        for action in sub._actions:
            offers = f" -a {shlex.quote(_words(action))}" if _words(action) else ""
            if not action.option_strings:
                lines += [here + offers] if offers else []
                continue
            long = action.option_strings[-1].removeprefix("--")
            takes = " -r" if action.nargs != 0 else ""
            lines.append(f"{here} -l {long}{takes}{offers} -d {shlex.quote((action.help or '').replace('%%', '%'))}")
    return lines
