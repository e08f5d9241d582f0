"""Mutators of a user's estimator: the text of a Python file."""

from __future__ import annotations

import numpy as np

from fuzz.cases import ORDERLY, REFUSED, SAME, TOLD, Shelf, pick

MINE = """
import numpy as np

from twinbench.methods.estimator import Estimator, gaussian_state, no_info, register


@register
class Mine(Estimator):
    name, says = "mine", "whatever the machines, their mean in training"
    settings = {"scale": 1.0}
    search_space = {"scale": (0.5, 2.0)}

    def fit(self, train, validation, seed):
        truth = train.truth.estimated.reshape(-1, 10)
        self.arrays = {"mean": self.config["scale"] * truth.mean(axis=0), "cov": np.cov(truth[::50].T)}

    def init(self, batch):
        return gaussian_state(np.tile(self.arrays["mean"], (batch, 1)), self.arrays["cov"])

    def step(self, state, sample):
        return gaussian_state(state.mean, self.arrays["cov"]), no_info(len(state.mean))
"""
ESTIMATORS: Shelf[str] = Shelf()
mutator = ESTIMATORS
METHODS = ("fit(self, train, validation, seed)", "init(self, batch)", "step(self, state, sample)")


def start_of(method: str, line: str, text: str) -> str:
    head = f"    def {method}:\n"
    return text.replace(head, f"{head}        {line}\n")


@mutator(SAME)
def another_layout(text: str, rng: np.random.Generator) -> str:
    return pick(rng, (text.replace("\n", "\r\n"), "# note\n" + text, "\ufeff" + text, text + "print('imported')\n"))


@mutator(ORDERLY)
def characters_put_in_or_taken_out(text: str, rng: np.random.Generator) -> str:
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(len(text)))
        text = (
            text[:at]
            + pick(rng, ("", "(", ")", "'", ",", "0", "x", "=", "\x00", "-"))
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
    return text[: int(rng.integers(0, text.index("return gaussian_state(state.mean")))]


@mutator(REFUSED)
def it_fails_to_import(text: str, rng: np.random.Generator) -> str:
    lines = (
        "1 / 0",
        "raise SystemExit(0)",
        "import no_such_package",
        "raise KeyboardInterrupt",
        "raise BaseException('x')",
        "def f(:",
        "raise Exception('a\\nb')",
        "undefined",
        "raise Exception('[red]x[/]')",
        "raise Exception('x' * 100000)",
        "def f(): f()\nf()",
        "raise GeneratorExit",
        "raise MemoryError",
        "\x00",
        "x = " + "(" * 300,
    )
    return text + pick(rng, lines) + "\n"


@mutator(REFUSED)
def the_import_never_returns(text: str, rng: np.random.Generator) -> str:
    return text + pick(rng, ("while True: pass\n", "import time\ntime.sleep(1e6)\n"))


@mutator(REFUSED)
def no_estimator(text: str, rng: np.random.Generator) -> str:
    return pick(
        rng,
        (
            "",
            "x = 1\n",
            text.replace("(Estimator)", "").replace("@register\n", ""),
            text.replace("def step", "def steps"),
            text.replace("def fit", "def fitt"),
            text.replace('name, says = "mine", ', "says = "),
            text + "del Mine\n",
            text + "class Other(Mine):\n    name = 'other'\n",
        ),
    )


@mutator(REFUSED, check=TOLD)
def a_name_that_is_none(text: str, rng: np.random.Generator) -> str:
    names = (
        '"oracle"',
        '"nominal_ekf"',
        '""',
        "7",
        "None",
        '"a/b"',
        '"../../x"',
        '"[red]x[/]"',
        '"a b"',
        '"x" * 5000',
        '"a:b"',
        '"$x$"',
        '"a\\nb"',
    )
    return text.replace('"mine"', pick(rng, names))


@mutator(ORDERLY)
def a_method_fails(text: str, rng: np.random.Generator) -> str:
    lines = (
        "raise ValueError('[/x]')",
        "1 / 0",
        "undefined()",
        "raise Exception('a\\nb')",
        "assert False",
        "raise RecursionError",
        "raise SystemExit(0)",
    )
    return start_of(pick(rng, METHODS), pick(rng, lines), text)


@mutator(ORDERLY)
def a_method_returns_nonsense(text: str, rng: np.random.Generator) -> str:
    lines = (
        "return None",
        "return 7",
        "return ()",
        "return 'x', 'y'",
        "return np.zeros(3), np.zeros(3)",
        "return self",
    )
    return start_of(pick(rng, METHODS[1:]), pick(rng, lines), text)


@mutator(ORDERLY)
def arrays_of_nonsense(text: str, rng: np.random.Generator) -> str:
    values = ("np.nan", "np.inf", "np.zeros(3)", "'x'", "None", "1e308", "truth", "[]", "object()")
    what = pick(rng, ('self.config["scale"] * truth.mean(axis=0)', "np.cov(truth[::50].T)"))
    value = pick(rng, values)
    return text.replace(what, f"{value} * {what}" if value in ("np.nan", "np.inf", "1e308") else value)


@mutator(ORDERLY)
def estimates_of_nonsense(text: str, rng: np.random.Generator) -> str:
    values = (
        "state.mean * np.nan",
        "state.mean * 1e308",
        "state.mean[:1]",
        "state.mean[:, :9]",
        "state.mean.T",
        "-state.mean",
        "state.mean.astype(object)",
    )
    return text.replace("gaussian_state(state.mean,", f"gaussian_state({pick(rng, values)},")


@mutator(ORDERLY)
def covariances_of_nonsense(text: str, rng: np.random.Generator) -> str:
    values = (
        "np.zeros((10, 10))",
        "-np.eye(10)",
        "np.full((10, 10), np.nan)",
        "np.eye(9)",
        "1e308 * np.eye(10)",
        "np.eye(10)[0]",
        "1j * np.eye(10)",
    )
    before, head, after = text.partition("def step")
    return before + head + after.replace('self.arrays["cov"]', pick(rng, values))


@mutator(ORDERLY)
def it_changes_what_it_is_given(text: str, rng: np.random.Generator) -> str:
    return pick(
        rng,
        (
            start_of(METHODS[2], "state.mean[:] = 0.0", text),
            start_of(METHODS[2], "sample.measured[:] = 0.0", text),
            start_of(METHODS[0], "train.measured[:] = 0.0", text),
            start_of(METHODS[2], "np.seterr(all='raise')", text),
        ),
    )


@mutator(ORDERLY)
def never_twice_the_same(text: str, rng: np.random.Generator) -> str:
    return text.replace("gaussian_state(state.mean,", "gaussian_state(state.mean + np.random.normal(),")


@mutator(ORDERLY)
def settings_of_nonsense(text: str, rng: np.random.Generator) -> str:
    values = (
        "{}",
        "None",
        "3",
        '{"scale": None}',
        '{"scale": object()}',
        "{7: 1.0}",
        '{"scale": "x"}',
        "[('scale', 1.0)]",
    )
    return text.replace('{"scale": 1.0}', pick(rng, values))
