"""Mutators of a user's simulator: the text of a Python file."""

from __future__ import annotations

import re

import numpy as np

from fuzz.cases import ORDERLY, REFUSED, SAME, SAME_OR_REFUSED, Shelf, pick

TANK = """
import math

import numpy as np

from twinbench.physics.simulator import Simulator, Variable


def rhs(x, u, theta):
    return np.array([theta[1] * u[0] - theta[0] * math.sqrt(max(x[0], 0.0))])


def output(x, u, theta):
    return np.array([x[0]])


def initial(u0, y0, theta):
    return np.array([y0[0]])


TANK = Simulator(
    "tank",
    states=(Variable("level_m", "m", 0.0, 2.0, 0.5),),
    inputs=(Variable("pump_V", "V", 0.0, 10.0, 3.0),),
    outputs=(Variable("h_m", "m", 0.0, 2.0, 0.5),),
    parameters=(Variable("k", "m**0.5/s", 0.0, 1.0, 0.05), Variable("g", "m/s/V", 0.0, 1.0, 0.01)),
    rhs=rhs, output=output, initial=initial,
)
"""
RHS, OUTPUT, INITIAL = (
    f"def {name}:\n" for name in ("rhs(x, u, theta)", "output(x, u, theta)", "initial(u0, y0, theta)")
)
FUNCTIONS = {"rhs": RHS, "output": OUTPUT, "initial": INITIAL}
AWKWARD = (
    "[red]x[/]", "[/]", "$x^2$", "$\\\\frac{", "<b>x</b>", "a,b", "say 'x'", "a b", "{0}", "%s", "../../x", "", " ",
    "x" * 400,
    "time_s", "µ", "level@m", "a\\nb", "a=b", "[m]", "\\x1b[31m", "#x", "lambda", "a;b", "h_m.x",
)  # fmt: skip

SIMULATORS: Shelf[str] = Shelf()
mutator = SIMULATORS


def start_of(function: str, line: str, text: str = TANK) -> str:
    """The text with a line put in where a function begins."""
    return text.replace(FUNCTIONS[function], f"{FUNCTIONS[function]}    {line}\n")


def result_of(function: str, value: str, text: str = TANK) -> str:
    """The text with another result of a function."""
    before, head, after = text.partition(FUNCTIONS[function])
    return before + head + re.sub(r"return .*", lambda _: f"return {value}", after, count=1)


def some(rng: np.random.Generator) -> str:
    return str(pick(rng, FUNCTIONS))


@mutator(SAME)
def nothing(text: str, rng: np.random.Generator) -> str:
    return text


@mutator(SAME)
def comments_and_line_ends(text: str, rng: np.random.Generator) -> str:
    return pick(
        rng, (text.replace("\n", "\r\n"), "# note\n" + text, '"""Tank."""\n' + text, "\ufeff" + text, text + "\n" * 50)
    )


@mutator(SAME)
def it_prints_when_imported(text: str, rng: np.random.Generator) -> str:
    return text + pick(
        rng, ("print('hello')\n", "import sys\nsys.stdout.write('{}')\n", "import warnings\nwarnings.warn('old')\n")
    )


@mutator(SAME)
def it_prints_when_called(text: str, rng: np.random.Generator) -> str:
    return start_of("initial", "print('called')", text)


@mutator(ORDERLY)
def characters_put_in_or_taken_out(text: str, rng: np.random.Generator) -> str:
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(len(text)))
        put = pick(rng, ("", "(", ")", "'", "\t", ",", "0", "x", "=", "\x00", "é", "-", "1e9"))
        text = text[:at] + put + text[at + int(rng.integers(0, 3)) :]
    return text


@mutator(ORDERLY)
def a_line_lost(text: str, rng: np.random.Generator) -> str:
    lines = text.splitlines(keepends=True)
    del lines[int(rng.integers(len(lines)))]
    return "".join(lines)


@mutator(REFUSED)
def cut_short(text: str, rng: np.random.Generator) -> str:
    return text[: int(rng.integers(0, len(text) - 10))]


@mutator(REFUSED)
def no_python(text: str, rng: np.random.Generator) -> str:
    return pick(
        rng,
        (
            "def (:\n",
            "{",
            "\x00\x01",
            "PK\x03\x04",
            "[" * 300,
            "x = " + "(" * 150 + ")" * 150,
            "\udcff",
            "x = '",
            "<html>",
        ),
    )


@mutator(REFUSED)
def it_fails_to_import(text: str, rng: np.random.Generator) -> str:
    lines = (
        "1 / 0",
        "raise SystemExit(0)",
        "raise SystemExit('bye')",
        "import no_such_package",
        "raise KeyboardInterrupt",
        "raise BaseException('x')",
        "raise Exception('a\\nb')",
        "raise Exception",
        "def f(): f()\nf()",
        "import sys; sys.exit()",
        "raise GeneratorExit",
        "assert False",
        "from twinbench.physics.simulator import Nothing",
        "raise MemoryError",
        "undefined",
        "raise Exception('[red]x[/]')",
        "raise Exception('x' * 100000)",
        "raise UnicodeDecodeError('utf-8', b'x', 0, 1, 'y')",
    )
    return text + pick(rng, lines) + "\n"


@mutator(REFUSED)
def a_function_fails(text: str, rng: np.random.Generator) -> str:
    lines = (
        "raise ValueError('[/x] no')",
        "1 / 0",
        "raise SystemExit(0)",
        "raise KeyboardInterrupt",
        "undefined()",
        "theta[99]",
        "raise Exception('a\\n' * 9)",
        "raise BaseException",
        "return f()",
        "assert False, {}",
        "raise RecursionError",
    )
    return start_of(some(rng), pick(rng, lines), text)


@mutator(REFUSED)
def a_function_never_returns(text: str, rng: np.random.Generator) -> str:
    lines = (
        "while True: pass",
        "import time; time.sleep(1e6)",
        "while max(0.0, 1.0): theta = theta + 0",
        "sum(1 for _ in iter(int, 1))",
    )
    return start_of(some(rng), pick(rng, lines), text)


@mutator(REFUSED)
def the_import_never_returns(text: str, rng: np.random.Generator) -> str:
    return text + pick(
        rng, ("while True: pass\n", "import time\ntime.sleep(1e6)\n", "import threading\nthreading.Event().wait()\n")
    )


@mutator(REFUSED)
def another_shape(text: str, rng: np.random.Generator) -> str:
    values = (
        "np.zeros(2)",
        "np.zeros(0)",
        "np.zeros((1, 1))",
        "1.0",
        "None",
        "'x'",
        "np.zeros(())",
        "[[1.0]]",
        "{}",
        "np.array(['a'])",
        "[None]",
        "(1.0, 2.0)",
        "np.ones((1, 2))",
        "object()",
        "np.array([1j])",
        "lambda: 0",
        "iter([1.0])",
        "np.zeros((3, 1))",
    )
    return result_of(some(rng), pick(rng, values), text)


@mutator(SAME_OR_REFUSED)
def another_type_of_the_same_numbers(text: str, rng: np.random.Generator) -> str:
    return result_of(
        "output", pick(rng, ("[x[0]]", "(x[0],)", "x", "x[:1]", "x.tolist()", "x.copy()", "np.array(x)", "x * 1")), text
    )


@mutator(REFUSED)
def no_finite_number(text: str, rng: np.random.Generator) -> str:
    return result_of(
        some(rng), f"np.array([{pick(rng, ('np.nan', 'np.inf', '-np.inf', '1e308 * 1e308', 'math.nan'))}])", text
    )


@mutator(ORDERLY)
def not_finite_later(text: str, rng: np.random.Generator) -> str:
    """Where it was tried it was good."""
    name, value = pick(rng, ("rhs", "output")), pick(rng, ("np.nan", "1e300", "np.inf"))
    return start_of(name, f"if x[0] > {rng.uniform(0.5, 0.8):.3f}: return np.array([{value}])", text)


@mutator(ORDERLY)
def it_fails_later(text: str, rng: np.random.Generator) -> str:
    what = pick(
        rng,
        (
            "raise ValueError('too full')",
            "return np.zeros(2)",
            "return None",
            "while True: pass",
            "raise SystemExit(0)",
        ),
    )
    return start_of(pick(rng, ("rhs", "output")), f"if x[0] > {rng.uniform(0.55, 0.8):.3f}: {what}", text)


@mutator(ORDERLY)
def it_runs_away(text: str, rng: np.random.Generator) -> str:
    values = (
        "np.array([1e3 * x[0] ** 2])",
        "np.array([x[0] * 1e6])",
        "np.array([1e300 * x[0]])",
        "np.array([-1e9 * x[0]])",
    )
    return result_of("rhs", pick(rng, values), text)


@mutator(REFUSED)
def never_twice_the_same(text: str, rng: np.random.Generator) -> str:
    """Numbers drawn at random, the clock, a counter: no simulator of that machine."""
    more = (
        "np.random.normal()",
        "np.random.rand()",
        "time.perf_counter()",
        "count()",
        "random.random()",
    )
    head = "import random, time\nCALLS = []\n\n\ndef count():\n    CALLS.append(1)\n    return 0.01 * len(CALLS)\n\n\n"
    value = {"rhs": "theta[1] * u[0] - theta[0] * math.sqrt(max(x[0], 0.0))", "output": "x[0]"}
    name = pick(rng, value)
    return head + result_of(name, f"np.array([{value[name]} + 0.01 * {pick(rng, more)}])", text)


@mutator(SAME_OR_REFUSED)
def it_remembers_harmlessly(text: str, rng: np.random.Generator) -> str:
    """Global state that no result depends on; numba cannot compile it."""
    return start_of(pick(rng, ("rhs", "output")), "SEEN.append(1); SEEN.clear()", "SEEN = []\n" + text)


@mutator(REFUSED)
def it_changes_its_arguments(text: str, rng: np.random.Generator) -> str:
    name = some(rng)
    line = "y0[0] = 7.0" if name == "initial" else pick(rng, ("x[0] = 7.0", "u[:] = 0.0", "theta[0] += 1.0"))
    return start_of(name, line, text)


@mutator(REFUSED)
def bounds_reversed(text: str, rng: np.random.Generator) -> str:
    for_bounds = ("2.0, 0.0", "nan, nan", "0.6, 2.0", "5.0, -5.0", "'0', '2'", "None, None", "0.0, nan")
    number = pick(rng, for_bounds).replace("nan", "math.nan")
    return text.replace(pick(rng, ('"level_m", "m", 0.0, 2.0', '"h_m", "m", 0.0, 2.0')), '"v", "m", ' + number, 1)


@mutator(REFUSED)
def a_variable_of_wrong_fields(text: str, rng: np.random.Generator) -> str:
    wrong = (
        'Variable("h_m", "m", 0.0, 2.0)',
        'Variable("h_m", "m", 0.0, 2.0, "x")',
        "Variable()",
        '"h_m"',
        "None",
        "Variable",
        'Variable(7, "m", 0.0, 2.0, 0.5)',
        'Variable("h_m", 3, 0.0, 2.0, 0.5)',
        'Variable("h_m", "m", 0.0, 2.0, math.nan)',
        'Variable("h_m", "m", 0.0, 2.0, 0.5, -1.0)',
        'Variable("h_m", "m", 0.0, 2.0, 0.5, math.nan)',
        'Variable("h_m", "m", 0.0, 2.0, None)',
        'Variable("h_m", "m", 0.0, 2.0, 0.5j)',
        'Variable("h_m", "m", 0.0, 2.0, [0.5])',
        'Variable("h_m", "m", 0.0, 2.0, 0.5, colour=1)',
        'Variable("h_m", None, 0.0, 2.0, 0.5)',
    )
    return text.replace('Variable("h_m", "m", 0.0, 2.0, 0.5)', pick(rng, wrong))


@mutator(ORDERLY)
def a_unit_nobody_knows(text: str, rng: np.random.Generator) -> str:
    units = ("flurb", "10**10**10", "m**m", "(", "[red]", "$x$", "m/0", "", "µm", "m" * 3000)
    return text.replace('"h_m", "m"', f'"h_m", "{pick(rng, units)}"')


@mutator(REFUSED)
def a_simulator_of_wrong_fields(text: str, rng: np.random.Generator) -> str:
    changes = (
        ("rhs=rhs, ", ""),
        ("output=output, ", ""),
        ("rhs=rhs", "rhs=3"),
        ("initial=initial", "initial=None"),
        ('"tank",', "7,"),
        ("rhs=rhs", "rhs=rhs, flux=rhs"),
        ("rhs=rhs", "rhs=rhs, fluxes=3"),
        ("rhs=rhs", "rhs=rhs, colour=3"),
        ("states=(", "states=list("),
        ('states=(Variable("level_m", "m", 0.0, 2.0, 0.5),)', "states=()"),
        ("rhs=rhs", "rhs=rhs, calibrate=('gone',)"),
        ('outputs=(Variable("h_m", "m", 0.0, 2.0, 0.5),)', "outputs=()"),
        ("rhs=rhs", "rhs=rhs, drifts=3"),
        ("0.01)),", "0.01)), says=3,"),
        ('states=(Variable("level_m", "m", 0.0, 2.0, 0.5),)', "states=None"),
        ("rhs=rhs", "rhs=rhs, calibrate='k'"),
        ("output=output", "output='output'"),
        ("TANK = Simulator(", "TANK = dict("),
        ("rhs=rhs", "rhs=lambda x: x"),
    )
    return text.replace(*pick(rng, changes))


@mutator(REFUSED)
def names_twice(text: str, rng: np.random.Generator) -> str:
    return text.replace(*pick(rng, (('"g",', '"k",'), ('"h_m",', '"pump_V",'), ('"k",', '"level_m",'))))


@mutator(ORDERLY)
def an_awkward_name(text: str, rng: np.random.Generator) -> str:
    return text.replace(pick(rng, ('"level_m"', '"k"', '"tank"', '"g"', '"m"', '"V"')), f'"{pick(rng, AWKWARD)}"')


@mutator(REFUSED, list=ORDERLY, fmu=ORDERLY)
def a_channel_of_awkward_name(text: str, rng: np.random.Generator) -> str:
    """The recording has no such column."""
    return text.replace(pick(rng, ('"pump_V"',)), f'"{pick(rng, AWKWARD)}"')


@mutator(REFUSED)
def no_simulator_in_it(text: str, rng: np.random.Generator) -> str:
    return pick(
        rng,
        (
            "x = 1\n",
            "",
            text.replace("TANK = ", "TANKS = [") + "]\n",
            text + "del TANK\n",
            text + "TANK = TANK.__dict__\n",
        ),
    )


@mutator(REFUSED)
def two_simulators(text: str, rng: np.random.Generator) -> str:
    return text + "import dataclasses\nOTHER = dataclasses.replace(TANK, says='other')\n"


@mutator(ORDERLY)
def the_import_meddles(text: str, rng: np.random.Generator) -> str:
    return text + pick(
        rng,
        (
            "np.seterr(all='raise')\n",
            "import warnings\nwarnings.simplefilter('error')\n",
            "import os\nos.chdir('/')\n",
            "import sys\nsys.setrecursionlimit(200)\n",
            "import locale\n",
            "np.float64 = None\n",
            "import sys\nsys.stdout.close()\n",
            "import builtins\nbuiltins.print = None\n",
            "import sys\nsys.argv = []\n",
            "import sys\nsys.path.clear()\n",
            "import os\nos.environ.clear()\n",
            "np.random.seed(0)\n",
            "import signal\nsignal.alarm(0)\n",
            "import gc\ngc.disable()\n",
        ),
    )


@mutator(ORDERLY)
def stiff_or_slow(text: str, rng: np.random.Generator) -> str:
    return result_of("rhs", f"np.array([{10.0 ** rng.uniform(1, 7):.3g} * (theta[1] * u[0] - x[0])])", text)


@mutator(ORDERLY)
def numbers_of_absurd_size(text: str, rng: np.random.Generator) -> str:
    big = pick(rng, ("1e308", "1e-308", "5e-324", "1e30", "math.inf", "10**400", "-1e308"))
    return text.replace(
        "0.0, 1.0, 0.05", pick(rng, (f"0.0, {big}, 0.05", f"-{big}, {big}, 0.05", f"{big}, {big}, {big}"))
    ).replace("--", "")
