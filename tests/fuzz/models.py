"""Mutators of ``model.toml``, the mended simulator."""

from __future__ import annotations

import numpy as np

from fuzz.cases import ORDERLY, REFUSED, SAME, SAME_OR_REFUSED, Shelf, pick

MODEL = """# A mended simulator: every command that takes a simulator takes this file.
base = "tank.py"

[[mechanisms]]
name = "linear_leak@level_m"
from = "generic"
# a leak in proportion to level_m takes from it

[values]
k = 0.055  # m**0.5/s
g = 0.012  # m/s/V
linear_leak_level_m = 0.001  # 1/s
"""
MODELS: Shelf[str] = Shelf()
mutator = MODELS


@mutator(SAME)
def nothing(text: str, rng: np.random.Generator) -> str:
    return text


@mutator(SAME)
def another_layout(text: str, rng: np.random.Generator) -> str:
    return pick(rng, (text.replace("\n", "\r\n"), text.replace('"', "'"), text + "\n# end\n", text.replace(" = ", "=")))


@mutator(ORDERLY)
def characters_put_in_or_taken_out(text: str, rng: np.random.Generator) -> str:
    for _ in range(int(rng.integers(1, 3))):
        at = int(rng.integers(len(text)))
        text = (
            text[:at]
            + pick(rng, ("", "[", "]", '"', "9", "=", "\n", "\x00", ".", "e", "-"))
            + text[at + int(rng.integers(0, 3)) :]
        )
    return text


@mutator(ORDERLY)
def a_line_lost(text: str, rng: np.random.Generator) -> str:
    lines = text.splitlines(keepends=True)
    del lines[int(rng.integers(len(lines)))]
    return "".join(lines)


@mutator(REFUSED)
def cut_short(text: str, rng: np.random.Generator) -> str:
    return text[: int(rng.integers(0, text.index("linear_leak@")))]


@mutator(REFUSED)
def no_toml(text: str, rng: np.random.Generator) -> str:
    return pick(
        rng,
        (
            "{",
            "a = " + "[" * 3000,
            "\x00",
            "base = ",
            "base",
            "x = 1e",
            "[" * 400 + "a" + "]" * 400,
            "base = '''",
            "\ufeffbase = 3",
        ),
    )


@mutator(REFUSED)
def nested_deep(text: str, rng: np.random.Generator) -> str:
    n = int(rng.integers(50, 5000))
    return text + pick(
        rng, (f"x = {'[' * n}{']' * n}\n", f"{'a.' * n}b = 1\n", f"x = {'{a=' * n}1{'}' * n}\n", f"[{'a.' * n}b]\n")
    )


@mutator(REFUSED)
def a_base_that_is_none(text: str, rng: np.random.Generator) -> str:
    bases = (
        "gone.py",
        "model.toml",
        "",
        "7",
        ".",
        "..",
        "/",
        "tank.py:NOTHING",
        "no.module:X",
        "os:system",
        "[red]",
        "tank.py:",
        ":",
        "\\u0000",
        "/dev/null",
        "/dev/zero.py",
        "day.csv",
        "tank.PY",
        "C:\\\\x\\\\tank.py",
        "https://example.org/tank.py",
        "tank.py:rhs",
        "x" * 5000,
    )
    return text.replace('"tank.py"', f'"{pick(rng, bases)}"')


@mutator(REFUSED)
def a_base_of_another_type(text: str, rng: np.random.Generator) -> str:
    return text.replace('"tank.py"', pick(rng, ("7", "[]", "true", "{}", "1979-05-27", '["tank.py"]', "nan")))


@mutator(REFUSED)
def a_shelf_that_is_none(text: str, rng: np.random.Generator) -> str:
    shelves = (
        "general",
        "",
        "gone.py",
        "tank.py",
        "/etc/passwd",
        "os",
        "builtin",
        "faults",
        "model.toml",
        "7",
        "[red]",
        "../x.py",
    )
    return text.replace('"generic"', f'"{pick(rng, shelves)}"')


@mutator(REFUSED)
def a_mechanism_that_is_none(text: str, rng: np.random.Generator) -> str:
    names = (
        "linear_leak",
        "linear_leak@gone",
        "",
        "[/]",
        "x" * 4000,
        "offset@pump_V",
        "LINEAR_LEAK@level_m",
        "linear_leak@level_m ",
        "$x$",
    )
    return text.replace('"linear_leak@level_m"', f'"{pick(rng, names)}"')


@mutator(REFUSED)
def mechanisms_of_another_type(text: str, rng: np.random.Generator) -> str:
    return text.replace(
        'name = "linear_leak@level_m"', pick(rng, ("name = 7", "name = []", "", "nome = 'x'", "name = 'a'\nmore = 'b'"))
    )


@mutator(REFUSED)
def a_mechanism_twice(text: str, rng: np.random.Generator) -> str:
    return text.replace("[values]", '[[mechanisms]]\nname = "linear_leak@level_m"\nfrom = "generic"\n\n[values]')


@mutator(REFUSED)
def a_value_that_is_none(text: str, rng: np.random.Generator) -> str:
    values = (
        "nan",
        "inf",
        "-inf",
        '"0.05"',
        "true",
        "[]",
        "{}",
        "1979-05-27",
        "9" * 400,
        "1e400",
        "'[red]'",
        "9" * 5000,
        "0x" + "f" * 400,
    )
    return text.replace(pick(rng, ("0.055", "0.012", "0.001")), pick(rng, values))


@mutator(REFUSED)
def a_value_out_of_bounds(text: str, rng: np.random.Generator) -> str:
    return text.replace(
        pick(rng, ("0.055", "0.012")), pick(rng, ("1e308", "-1e308", "-5.0", "1e30", "123456789.0", "7.5"))
    )


@mutator(REFUSED)
def a_value_of_nothing(text: str, rng: np.random.Generator) -> str:
    return text + pick(
        rng, ("gone = 1.0\n", '"[red]" = 1.0\n', '"" = 0.0\n', "k.x = 1.0\n", '"$x$" = 3\n', "level_m = 0.1\n")
    )


@mutator(REFUSED)
def a_key_that_it_does_not_know(text: str, rng: np.random.Generator) -> str:
    return (
        pick(rng, ("colour = 1\n", "run = 'rm -rf /'\n", "[[model]]\n", "exec = '1'\n")) + text
        if rng.random() < 0.5
        else text + "[more]\na = 1\n"
    )


@mutator(REFUSED)
def another_encoding(text: str, rng: np.random.Generator) -> str:
    return "\udcff\udcfe" + text


@mutator(SAME_OR_REFUSED)
def very_long(text: str, rng: np.random.Generator) -> str:
    return text + "# " + "x" * 3_000_000 + "\n"
