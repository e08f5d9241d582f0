"""Mutators of a run's profile."""

from __future__ import annotations

import numpy as np
from helpers.tiny_profile import PROFILE

from fuzz.cases import ORDERLY, REFUSED, SAME, Shelf, pick

TRAINED = (
    PROFILE.replace("n_train = 2", "n_train = 6")
    .replace("n_validation = 1", "n_validation = 6")
    .replace("minutes = 2.5", "minutes = 4.0")
    + """
[settings.deeponet_kalman]
iterations = 20
windows = 64
copies = 1
transitions = 3000
audited = false
"""
)
"""Of the run that estimate, report, export and latency read: from fewer recordings none could be called usable."""
PROFILES: Shelf[str] = Shelf()
mutator = PROFILES
NUMBERS = (
    "n_train = 2",
    "n_validation = 1",
    "n_test = 2",
    "minutes = 2.5",
    "warmup_minutes = 0.5",
    "origin_every_s = 20.0",
    "updates = 0",
)


def key(line: str) -> str:
    return line.partition(" = ")[0]


@mutator(SAME)
def another_layout(text: str, rng: np.random.Generator) -> str:
    return pick(
        rng, (text.replace("\n", "\r\n"), text + "# end\n", text.replace(" = ", "="), text.replace("[0]", "[\n 0,\n]"))
    )


@mutator(REFUSED)
def another_type(text: str, rng: np.random.Generator) -> str:
    line = pick(rng, (*NUMBERS, "seeds = [0]", "scenes = false"))
    values = ("'two'", "['1']", "{}", "1979-05-27", "[[0]]", "''", "nan")
    return text.replace(line, f"{key(line)} = {pick(rng, values)}", 1)


@mutator(REFUSED)
def out_of_range(text: str, rng: np.random.Generator) -> str:
    line = pick(rng, NUMBERS)
    values = (
        "-1",
        "-0.5",
        "1e308",
        "inf",
        "-inf",
        "nan",
        "9" * 300,
        "9" * 5000,
        "99999999999",
        "1e400",
        "0x" + "f" * 40,
    )
    return text.replace(line, f"{key(line)} = {pick(rng, values)}", 1)


@mutator(REFUSED)
def seeds_that_are_none(text: str, rng: np.random.Generator) -> str:
    values = (
        "[]",
        "[0, 0]",
        "[-1]",
        "[0.5]",
        "['a']",
        "0",
        "[true]",
        "[99999999999999]",
        "[[0]]",
        "[nan]",
        "'0'",
        "{a = 1}",
    )
    return text.replace("[0]", pick(rng, values), 1)


@mutator(REFUSED)
def an_unknown_key(text: str, rng: np.random.Generator) -> str:
    return pick(
        rng,
        (
            "colour = 1\n" + text,
            text + "colour = 1\n",
            text + "[more]\n",
            text.replace("n_train", "n_trains"),
            text.replace("[data]", "[dato]"),
            '"[red]" = 1\n' + text,
            '"$x$" = 1\n' + text,
            '"" = 1\n' + text,
            "data.x = 1\n" + text,
            text + "[[settings]]\n",
        ),
    )


@mutator(REFUSED)
def settings_that_are_none(text: str, rng: np.random.Generator) -> str:
    return text + pick(
        rng,
        (
            "[settings]\nmine = 3\n",
            "[settings.gone]\nx = 1\n",
            "[settings.mine]\nscale = 'x'\n",
            "[settings.mine]\nscale = true\n",
            "[settings.mine]\ncolour = 1\n",
            "[settings.mine]\nscale = []\n",
            "[settings.mine]\nimplementation = 3\n",
            "[settings.mine.scale]\nx = 1\n",
            "[settings]\n'[red]' = {}\n",
            "[settings.mine]\nscale = {}\n",
        ),
    )


@mutator(ORDERLY)
def settings_that_are_odd(text: str, rng: np.random.Generator) -> str:
    values = ("scale = nan", "scale = 1e308", "scale = inf", "scale = 0", "implementation = 'gone'", "scale = -1.0")
    return text + f"[settings.mine]\n{pick(rng, values)}\n"


@mutator(REFUSED)
def corruption_that_is_none(text: str, rng: np.random.Generator) -> str:
    return text + pick(
        rng,
        (
            "[corruption]\ndropout = 1.0\n",
            "[corruption]\ndropout = -0.1\n",
            "[corruption]\nnoise = nan\n",
            "[corruption]\nspikes = 7\n",
            "[corruption]\ndropout = inf\n",
            "[corruption]\nnoise = '1'\n",
            "[corruption]\nx = 1\n",
            "corruption = 3\n",
        ),
    )


@mutator(ORDERLY)
def characters_put_in_or_taken_out(text: str, rng: np.random.Generator) -> str:
    at = int(rng.integers(len(text)))
    return (
        text[:at]
        + pick(rng, ("[", "]", '"', "=", "\x00", "e", "-", "\x7f", "x", "{"))
        + text[at + int(rng.integers(0, 3)) :]
    )


@mutator(REFUSED)
def no_toml(text: str, rng: np.random.Generator) -> str:
    return pick(
        rng,
        (
            "{",
            "a = " + "[" * 3000,
            "\x00",
            "seeds = ",
            "x",
            "\udcff\udcfe" + text,
            "<xml/>",
            "seeds = '''",
            "a." * 4000 + "b = 1",
        ),
    )


@mutator(REFUSED)
def keys_twice(text: str, rng: np.random.Generator) -> str:
    return pick(rng, ("seeds = [0]\n" + text, text + "[data]\n", text.replace("n_test = 2", "n_test = 2\nn_test = 2")))


@mutator(ORDERLY)
def a_line_lost(text: str, rng: np.random.Generator) -> str:
    """Not those that keep the run small."""
    return text.replace(
        pick(rng, ("seeds = [0]\n", "warmup_minutes = 0.5\n", "origin_every_s = 20.0\n", "[evaluation]\n", "[data]\n")),
        "",
        1,
    )


@mutator(ORDERLY)
def odd_but_lawful(text: str, rng: np.random.Generator) -> str:
    line = pick(
        rng,
        (
            "n_train = 1",
            "n_test = 1",
            "minutes = 1.0",
            "origin_every_s = 3600.0",
            "warmup_minutes = 0",
            "updates = 1",
            "minutes = 2",
        ),
    )
    old = next(n for n in NUMBERS if key(n) == key(line))
    return text.replace(old, line)
