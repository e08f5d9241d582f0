"""The integrators of a machine's runs against scipy and against their own theory."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from twinbench.mismatch.march import RUNGE_KUTTA, advance_stretch, legendre, march

END_S, SLOW = 4.0, 0.5
MILD, STIFF = 20.0, 200.0


def rhs(x, u, theta):  # type: ignore[no-untyped-def]
    """A fast state that follows the input and a slow one, and a slow one that follows it, not linearly."""
    return np.array([-theta[0] * (x[0] - u[0] - 0.5 * x[1]), -SLOW * np.sin(x[1]) + x[0] * np.cos(x[1])])


def read(x, u, theta):  # type: ignore[no-untyped-def]
    return x.copy()


def run(scheme: np.ndarray, step_s: float, fast: float) -> np.ndarray:
    """States (N, 2) at the ends of N steps under a constant input."""
    n = round(END_S / step_s)
    y = np.full((n + 1, 2), np.nan)
    march.py_func(
        rhs,
        read,
        np.full((n + 1, 1), 0.3),
        np.full(n + 1, step_s),
        np.ones(n + 1, dtype=np.int64),
        np.zeros(2),
        np.array([fast]),
        np.empty(0, dtype=np.int64),
        np.empty((n + 1, 0)),
        step_s,
        scheme,
        np.full(2, 1e9),
        y,
    )
    return y[1:]


def exact(fast: float) -> np.ndarray:
    found = solve_ivp(lambda t, x: rhs(x, [0.3], [fast]), (0.0, END_S), np.zeros(2), "Radau", rtol=1e-10, atol=1e-12)
    return np.asarray(found.y[:, -1])


@pytest.mark.parametrize(("scheme", "order"), [(RUNGE_KUTTA, 4), (legendre(5), 2), (legendre(8), 2)])
def test_halving_the_step_shrinks_the_error_by_the_order(scheme, order):
    errors = [np.abs(run(scheme, h, MILD)[-1] - exact(MILD)).max() for h in (0.02, 0.01)]
    assert errors[0] / errors[1] > 0.8 * 2**order or errors[0] < 1e-10


@pytest.mark.parametrize("stages", [4, 5, 7, 8])
def test_stages_step_over_what_is_fast_as_far_as_theory_says(stages):
    longest = (stages**2 + stages - 2.0) / 2.0 / STIFF
    steps = int(np.ceil(END_S / (0.9 * longest)))
    assert run(legendre(stages), END_S / steps, STIFF)[-1] == pytest.approx(exact(STIFF), rel=0.02)
    too_long = END_S / int(END_S / (1.5 * longest))
    assert not run(legendre(stages), too_long, STIFF)[-1] == pytest.approx(exact(STIFF), rel=0.5)


def test_runge_kutta_does_not_step_over_it():
    assert not run(RUNGE_KUTTA, 0.05, STIFF)[-1] == pytest.approx(exact(STIFF), rel=0.5)
    assert run(legendre(5), 0.05, STIFF)[-1] == pytest.approx(exact(STIFF), rel=0.02)


@pytest.mark.parametrize("scheme", [RUNGE_KUTTA, legendre(4), legendre(7)], ids=["classical", "4 stages", "7 stages"])
@pytest.mark.parametrize("fast", [0.5, 30.0])
def test_linear_rates_at_the_mean_state_move_a_stretch_as_its_steps_do(scheme, fast):
    A, u, seconds = np.array([[-fast, 0.3 * fast], [0.2, -0.4]]), np.array([fast, -0.1]), 0.24
    began = np.array([3.0, -1.0])  # far from where the fast state is going
    x, mean = began.copy(), np.empty(2)
    limit, work = np.full(2, 1e9), np.empty((4, 2))
    assert advance_stretch(lambda x, u, theta: A @ x + u, x, u, np.empty(0), seconds, 0.08, scheme, limit, work, mean)
    np.testing.assert_allclose(A @ mean + u, (x - began) / seconds, rtol=1e-9)
