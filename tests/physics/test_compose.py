"""Composed simulators: equal to terms added by hand, fluxes kept, compiled once for all processes."""

from __future__ import annotations

import importlib.util
import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from twinbench.physics.compile import compiled
from twinbench.physics.compose import compose, plain_rhs
from twinbench.physics.fingerprint import Untold, fingerprint
from twinbench.physics.integrate import simulate
from twinbench.physics.jit import USER_FILE
from twinbench.physics.simulator import Array, Simulator, Term, Variable


def variable(name: str, nominal: float = 0.0) -> Variable:
    return Variable(name, "1", -1e6, 1e6, nominal)


def tank_flux(x, u, theta):
    return np.array([u[0], theta[0] * math.sqrt(max(x[0], 0.0)), theta[1] * math.sqrt(max(x[-1], 0.0))])


def tank_balance(x, u, theta, f):
    return np.array([f[0] - f[1], f[1] - f[2] + 0.1 * u[1]])


def levels(x, u, theta):
    return x  # an argument handed back: terms must not be added to it


TANKS = Simulator(
    name="tanks",
    states=(variable("h1", 1.0), variable("h2", 0.7)),
    inputs=(variable("q", 0.3), variable("rain", 0.1)),
    outputs=(variable("level1"), variable("level2")),
    parameters=(variable("k1", 0.5), variable("k2", 0.4)),
    flux=tank_flux,
    balance=tank_balance,
    fluxes=(variable("inflow"), variable("between"), variable("outflow")),
    output=levels,
    initial=lambda u0, y0, theta: np.array([y0[0], y0[1]]),
)


def offset(x, u, theta):
    return theta[-1]


def spill(x, u, theta):
    return -theta[-2] * max(x[1] - theta[-1], 0.0) * u[0]


def lagged(x, u, theta):
    return -theta[-2] * (x[0] - x[-1])


def lag(x, u, theta):
    return np.array([(x[0] - x[-1]) / theta[-1]])


def at_first_level(x0, u0, theta):
    return np.array([x0[0] + theta[-2]])


BIAS = Term("bias", "", "output:level1", (variable("bias", 0.2),), term=offset)
SPILL = Term("spill", "", "balance:h2", (variable("c", 0.6), variable("rim", 0.5)), term=spill)
SLOW = Term("slow", "", "output:level2", (variable("share", 0.3), variable("tau_s", 4.0)), states=(variable("z"),),
                 term=lagged, derivative=lag, initial=at_first_level)  # fmt: skip
LEAK = Term("leak", "", "flux:between", (variable("leak", 0.05),), (-math.inf,), term=offset)
MASS = Term("mass", "", "balance:h1", (variable("a", 0.7), variable("tau2_s", 9.0)), states=(variable("m"),),
                 term=lagged, derivative=lag)  # fmt: skip
EXTRA = Term("extra", "", "input:q", (variable("dq", 0.15),), term=offset)
ALL = (BIAS, SPILL, SLOW, LEAK, MASS, EXTRA)


def by_hand(x: Array, u: Array, theta: Array) -> tuple[Array, Array]:
    """Rates and readings of TANKS with ALL, as one would write them; absent is a size of 0, of the leak -inf."""
    bias, c, rim, share, tau, leak, a, tau2, dq = theta[2:]
    h1, h2, z, m = x
    q = u[0] + dq
    f = tank_flux(x[:2], np.array([q, u[1]]), theta) + np.array([0.0, leak if leak > -np.inf else 0.0, 0.0])
    dh1, dh2 = tank_balance(x[:2], u, theta, f)
    dz = (h1 - z) / tau if share else 0.0
    dm = (h1 - m) / tau2 if a else 0.0
    rates = np.array([dh1 - a * (h1 - m), dh2 - c * max(h2 - rim, 0.0) * q, dz, dm])
    return rates, np.array([h1 + bias, h2 - share * (h1 - z)])


SIZES = {"bias": 2, "c": 3, "share": 5, "leak": 7, "a": 8, "dq": 10}


@pytest.mark.parametrize("on", [(), *((name,) for name in SIZES), ("c", "dq"), ("leak", "share", "a"), tuple(SIZES)])
def test_terms_are_added_as_by_hand_whichever_are_on(on):
    whole = compose(TANKS, ALL)
    theta = whole.theta()
    for name, at in SIZES.items():
        assert whole.parameters[at].name == name
        if name not in on:
            theta[at] = -np.inf if name == "leak" else 0.0
    rng = np.random.default_rng(0)
    native, plain = compiled(whole), (plain_rhs(whole), whole.output)
    assert native.native
    for _ in range(20):
        x, u = rng.uniform(0.1, 2.0, 4), rng.uniform(0.1, 1.0, 2)
        given = x.copy(), u.copy(), theta.copy()
        rates, readings = by_hand(x, u, theta)
        for rhs, output in (native[:2], plain):
            assert rhs(x, u, theta) == pytest.approx(rates, abs=1e-14)
            assert output(x, u, theta)[:2] == pytest.approx(readings, abs=1e-14)
        assert all(np.array_equal(a, b) for a, b in zip((x, u, theta), given, strict=True))


def test_nothing_on_is_the_simulator_itself_to_the_last_bit():
    whole = compose(TANKS, (BIAS, SPILL, EXTRA))
    theta = whole.theta()
    theta[[2, 3, 5]] = 0.0
    u = np.random.default_rng(1).uniform(0.0, 0.5, (1, 300, 2))
    start = np.array([1.0, 0.7])
    for ours, base in zip(simulate(whole, u, start, theta), simulate(TANKS, u, start), strict=True):
        assert np.array_equal(ours, base)


def test_a_mended_simulator_still_has_its_fluxes_and_takes_terms_there():
    mended = compose(TANKS, (SPILL, LEAK, EXTRA))
    assert mended.fluxes == TANKS.fluxes
    choke = Term("choke", "", "flux:outflow", (variable("choke", -0.07),), term=offset)
    twice, once = compose(mended, (choke, MASS)), compose(TANKS, (SPILL, LEAK, EXTRA, choke, MASS))
    assert twice.fluxes == TANKS.fluxes
    assert [v.name for v in twice.parameters] == [v.name for v in once.parameters]
    x, u, theta = np.array([1.2, 0.9, 0.4]), np.array([0.3, 0.2]), once.theta()
    expected = plain_rhs(once)(x, u, theta)
    assert compiled(twice).rhs(x, u, theta) == pytest.approx(expected, abs=1e-14)
    assert twice.flux is not None
    assert twice.balance is not None
    assert twice.balance(x, u, theta, twice.flux(x, u, theta)) == pytest.approx(expected, abs=1e-14)
    assert not np.allclose(expected, compose(mended, (MASS,)).rhs(x, u, np.delete(theta, 6)))


def test_own_states_start_where_their_mechanism_says_else_at_their_nominal_value():
    whole = compose(TANKS, ALL)
    theta = whole.theta()
    theta[whole.index("share")] = 0.5
    assert whole.initial(np.zeros(2), np.array([3.0, 2.0]), theta) == pytest.approx([3.0, 2.0, 3.5, 0.0])


def grows(x, u, theta):
    return x


def test_an_rhs_may_hand_back_its_argument():
    machine = replace(TANKS, rhs=grows, flux=None, balance=None, fluxes=())
    x, _ = simulate(machine, np.zeros((1, 21, 2)), np.array([1.0, 2.0]))
    assert x[0, -1] == pytest.approx([math.e, 2.0 * math.e], rel=1e-6)


def made(k, table: Array | None = None):
    def term(x, u, theta):
        return k * x[0] if table is None else table[0]

    return term


def test_a_fingerprint_tells_functions_apart_by_all_that_they_use():
    assert fingerprint(made(1.0)) == fingerprint(made(1.0))
    alike = [made(1.0), made(2.0), made(-0.0), made(0.0), made(1), made(1.0, np.ones(2)), made(1.0, np.ones(3)), offset]
    assert len({fingerprint(f) for f in alike}) == len(alike)
    sources = ["G = 1.0\n", "G = 2.0\n", "def g(x):\n    return 1.0\nG = g\n", "def g(x):\n    return 2.0\nG = g\n"]
    bodies = []
    for source in sources:
        names = {"__name__": __name__}
        exec(f"{source}def f(x, u, theta):\n    return G\n", names)
        bodies.append(fingerprint(names["f"]))
    assert len(set(bodies)) == len(sources)


def test_a_renamed_file_of_the_users_is_compiled_anew(tmp_path, monkeypatch):
    # What another process kept looks for the module by its old name, and there is none.
    told = []
    for name in ("brake.py", "eddy_brake.py"):
        (tmp_path / name).write_text("def f(x, u, theta):\n    return x[0]\n")
        spec = importlib.util.spec_from_file_location(f"{USER_FILE}{name[:-3]}", tmp_path / name)
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, module.__name__, module)
        spec.loader.exec_module(module)
        told.append(fingerprint(module.f))
    assert told[0] != told[1]


class Settings:
    k = 1.0


def test_what_cannot_be_told_is_not_kept_but_runs():
    settings, names = Settings(), {"json": json}
    exec("def f(x, u, theta):\n    return json.k\n", names)
    closure = njit(made(1.0))  # which cannot be given a name of its own
    for function in (lambda x, u, theta: settings.k, names["f"], closure, made(closure)):
        with pytest.raises(Untold):
            fingerprint(function)
    # A module of the user's own: its constants are not ours to follow.
    names = {"__name__": __name__, "os": os}
    exec("def f(x, u, theta):\n    return theta[-1] + 0.0 * len(os.sep)\n", names)
    whole = compose(TANKS, (replace(BIAS, term=names["f"]),))
    assert compiled(whole).native
    assert compiled(whole).output(np.ones(2), np.ones(2), whole.theta()) == pytest.approx([1.2, 1.0])


MACHINE = """
import math
import numpy as np
from twinbench.physics.simulator import Term, Simulator, Variable

def variable(name, nominal):
    return Variable(name, "1", -10.0, 10.0, nominal)

def rhs(x, u, theta):
    return np.array([-theta[0] * x[0] + u[0]])

def output(x, u, theta):
    return np.array([x[0]])

M = Simulator(name="m", states=(variable("x", 1.0),), inputs=(variable("u", 0.0),), outputs=(variable("y", 1.0),),
              parameters=(variable("k", 0.5),), rhs=rhs, output=output, initial=lambda u0, y0, theta: y0)

def series(n):
    def term(x, u, theta):
        s = 0.0
        for i in range(1, n):
LINES
        return theta[-1] * s
    return term

CATALOGUE = tuple(
    Term(f"series{n}", "", "balance:x", (variable(f"size{n}", 1.0),), term=series(n)) for n in (SIZES)
)
"""
LINES = "\n".join(f"            s += math.sin(i * x[0] + {k}.0) / i - math.tanh(s * i) % 0.{k}" for k in range(1, 40))
"""Too long for the compiler to copy a term into the function that calls it."""
RUN = """
import json, sys
import numpy as np
from twinbench.physics.compile import compiled
from twinbench.physics.jit import USER_FILE
from twinbench.physics.compose import compose
from twinbench.physics.load import load_catalogue, load_simulator
found = []
simulator = load_simulator(sys.argv[1])
for mechanism in load_catalogue(sys.argv[1], simulator):
    whole = compose(simulator, (mechanism,))
    equations = compiled(whole)
    given = np.array([0.8]), np.array([0.1]), whole.theta()
    hits = sum(equations.rhs.stats.cache_hits.values()) + sum(equations.output.stats.cache_hits.values())
    found.append([equations.rhs(*given)[0], whole.rhs(*given)[0], hits])
print(json.dumps(found))
"""


def test_a_later_process_finds_the_machine_code_and_never_that_of_another_term(tmp_path):
    """Closures of one name are one symbol to the linker, and symbols' numbers repeat from process to process."""
    root = Path(__file__).parents[2]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kept"), "PYTHONPATH": str(root)}

    def run(sizes: str) -> tuple[list[int], int]:
        """How much each composed simulator found on the disk, and how many are kept in all; results are checked."""
        file = tmp_path / "machine.py"
        file.write_text(MACHINE.replace("LINES", LINES).replace("SIZES", sizes))
        done = subprocess.run(
            [sys.executable, "-c", RUN, str(file)], env=environment, capture_output=True, text=True, check=True
        )
        found = json.loads(done.stdout)
        for native, plain, _ in found:
            assert native == pytest.approx(plain, rel=1e-12)
        return [hits for _, _, hits in found], len(list((tmp_path / "kept").glob("*.py")))

    assert run("12,") == ([0], 1)
    assert run("12,") == ([2], 1)
    # The first to be compiled here is numbered as the one on the disk was.
    assert run("13, 12") == ([0, 2], 2)
    assert run("12, 13") == ([2, 2], 2)
