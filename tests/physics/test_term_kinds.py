"""Terms that see what their port has without them, and terms that go from one balance into another."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twinbench.physics.check import check_mechanism
from twinbench.physics.compile import compiled
from twinbench.physics.compose import compose
from twinbench.physics.simulator import Port, Simulator, Term, Variable

SIZE = Variable("size", "1", 0.0, 5.0, 0.5)


def flux(x, u, theta):
    return np.array([u[0], theta[0] * math.sqrt(max(x[0], 0.0))])


def balance(x, u, theta, f):
    return np.array([f[0] - f[1], f[1]])


def halves(x, u, theta, own):
    return -theta[-1] * own


def moves_over(x, u, theta):
    return -theta[-1] * x[0]


def twice(x, u, theta):
    return 2.0


TANKS = Simulator(
    name="tanks",
    states=(Variable("a", "1", 0.0, 9.0, 4.0), Variable("b", "1", 0.0, 9.0, 1.0)),
    inputs=(Variable("q", "1", 0.0, 9.0, 3.0),),
    outputs=(Variable("level", "1", 0.0, 9.0, 4.0),),
    parameters=(Variable("k", "1", 0.0, 2.0, 0.5),),
    fluxes=(Variable("inflow", "1", 0.0, 9.0, 3.0), Variable("between", "1", 0.0, 9.0, 1.0)),
    flux=flux,
    balance=balance,
    output=lambda x, u, theta: x[:1] + 0.0,
    initial=lambda u0, y0, theta: np.array([y0[0], 1.0]),
)
X, U = np.array([4.0, 1.0]), np.array([3.0])
PLAIN = np.array([3.0 - 0.5 * 2.0, 1.0])


@pytest.mark.parametrize(
    ("port", "rates"),
    [
        ("flux:between", [3.0 - 0.5, 0.5]),
        ("balance:a", [0.5 * PLAIN[0], 1.0]),
        ("input:q", [1.5 - 1.0, 1.0]),
        ("output:level", PLAIN),
    ],
)
def test_a_term_sees_what_its_port_has_without_it(port, rates):
    term = Term("halved", "half of it is lost", Port.parse(port), (SIZE,), term=halves, sees_own=True)
    check_mechanism(TANKS, term)
    whole = compose(TANKS, (term,))
    made = compiled(whole)
    assert made.native
    theta = whole.theta()
    assert made.rhs(X, U, theta) == pytest.approx(rates)
    assert made.output(X, U, theta) == pytest.approx([2.0 if port.startswith("output") else 4.0])
    assert whole.rhs(X, U, theta) == pytest.approx(rates)
    theta[-1] = 0.0
    assert np.array_equal(made.rhs(X, U, theta), PLAIN)


def test_what_several_see_is_without_any_of_them():
    terms = tuple(
        Term(name, "half is lost", Port("flux", "between"), (SIZE,), term=halves, sees_own=True) for name in "ab"
    )
    whole = compose(TANKS, terms)
    assert compiled(whole).rhs(X, U, whole.theta()) == pytest.approx([3.0, 0.0])


def test_what_leaves_one_balance_enters_the_other():
    at, into = Port("balance", "a"), Port("balance", "b")
    term = Term("moved", "it goes over", at, (SIZE,), term=moves_over, into=into, ratio=twice)
    check_mechanism(TANKS, term)
    whole = compose(TANKS, (term,))
    assert compiled(whole).rhs(X, U, whole.theta()) == pytest.approx([PLAIN[0] - 2.0, PLAIN[1] + 4.0])


def test_a_second_balance_needs_a_ratio_and_has_to_exist():
    at = Port("balance", "a")
    with pytest.raises(ValueError, match="into and ratio go together"):
        Term("moved", "", at, (SIZE,), term=moves_over, into=Port("balance", "b"))
    with pytest.raises(ValueError, match="goes from one balance into another"):
        Term("moved", "", at, (SIZE,), term=moves_over, into=Port("flux", "between"), ratio=twice)
    stray = Term("moved", "", at, (SIZE,), term=moves_over, into=Port("balance", "c"), ratio=twice)
    with pytest.raises(ValueError, match="into: simulator 'tanks' has no balance 'c'"):
        check_mechanism(TANKS, stray)
