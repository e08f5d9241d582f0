"""Mutators of a command line whose files are all good."""

from __future__ import annotations

import numpy as np

from fuzz.cases import ORDERLY, REFUSED, SAME_OR_REFUSED, Shelf, pick

ARGUMENTS: Shelf[list[str]] = Shelf()
mutator = ARGUMENTS
WORDS = (
    "", " ", "-", "--", "x", "[red]", "$x^2$", ".", "/dev/null", "gone.csv", "a" * 5000, "µ",
    "\x1b[31m", "--map", "nan", "-1",
    "C:\\x\\my.py", "https://example.org/x.py", "os:system", "mine.py:", ":", "a:b:c", "*", "%s", "{}",
    "day.csv/x", "1e308", "9" * 400, "\n",
)  # fmt: skip


def _options(arguments: list[str]) -> list[int]:
    """Where options with a value stand."""
    return [i for i, a in enumerate(arguments[:-1]) if a.startswith("--") and not arguments[i + 1].startswith("--")]


@mutator(REFUSED)
def an_option_that_is_none(arguments: list[str], rng: np.random.Generator) -> list[str]:
    return [*arguments, pick(rng, ("--colour", "--out2", "-x", "--no-such=3", "--[red]", "--µ"))]


@mutator(REFUSED)
def the_command_misspelt(arguments: list[str], rng: np.random.Generator) -> list[str]:
    return [
        pick(rng, (arguments[0].upper(), arguments[0][:-1], "", "[red]", "help", "../x", "a" * 3000)),
        *arguments[1:],
    ]


@mutator(REFUSED)
def a_file_that_is_not_there(arguments: list[str], rng: np.random.Generator) -> list[str]:
    files = [i for i, a in enumerate(arguments) if a.endswith((".csv", ".py", ".toml", ".npz")) or a == "run"]
    at = pick(rng, files)
    return [
        *arguments[:at],
        pick(rng, ("gone.csv", "gone.py", "gone.toml", "gone/day.csv", "", "a" * 300 + ".csv", "gone")),
        *arguments[at + 1 :],
    ]


@mutator(ORDERLY)
def a_word_replaced(arguments: list[str], rng: np.random.Generator) -> list[str]:
    at = int(rng.integers(len(arguments)))
    return [*arguments[:at], pick(rng, WORDS), *arguments[at + 1 :]]


@mutator(ORDERLY)
def a_word_lost(arguments: list[str], rng: np.random.Generator) -> list[str]:
    """But the command: what follows may be another."""
    at = int(rng.integers(1, len(arguments)))
    return arguments[:at] + arguments[at + 1 :]


@mutator(ORDERLY)
def a_word_more(arguments: list[str], rng: np.random.Generator) -> list[str]:
    at = int(rng.integers(1, len(arguments) + 1))
    return [*arguments[:at], pick(rng, WORDS), *arguments[at:]]


@mutator(ORDERLY)
def the_value_of_an_option_replaced(arguments: list[str], rng: np.random.Generator) -> list[str]:
    at = pick(rng, _options(arguments) or [0])
    return [*arguments[: at + 1], pick(rng, WORDS), *arguments[at + 2 :]]


@mutator(SAME_OR_REFUSED)
def an_option_twice(arguments: list[str], rng: np.random.Generator) -> list[str]:
    at = pick(rng, [i for i in _options(arguments) if arguments[i] != "--map"] or [0])
    return [*arguments, *arguments[at : at + 2]] if at else [*arguments, "--help-me"]


@mutator(ORDERLY)
def words_in_another_order(arguments: list[str], rng: np.random.Generator) -> list[str]:
    return [arguments[0], *map(str, rng.permutation(arguments[1:]))]


@mutator(REFUSED, record=ORDERLY, replay=ORDERLY)
def a_folder_that_cannot_be(arguments: list[str], rng: np.random.Generator) -> list[str]:
    """Where results should go stands a file, or nothing can stand. What is one file replaces a file."""
    folder = pick(rng, ("a_file", "a_file/x", "/proc/x", "/dev/null/x", "a" * 300, "/sys/x"))
    if "--out" in arguments:
        at = arguments.index("--out")
        return [*arguments[: at + 1], folder, *arguments[at + 2 :]]
    if arguments[0] == "report":
        return ["report", folder]
    return [*arguments, "--out", folder]


@mutator(ORDERLY)
def a_number_of_jobs(arguments: list[str], rng: np.random.Generator) -> list[str]:
    return [*arguments, "--jobs", pick(rng, ("0", "-1", "1", "2", "1.5", "x", "99999999", "", "nan", "1e3"))]
