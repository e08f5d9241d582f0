"""Whether an effect is the same everywhere, against the evidence of dense Gaussians."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from twinbench.mismatch.naming.ground import Products
from twinbench.mismatch.naming.steady import UNSTEADY, one_form, one_size, squares_beside
from twinbench.mismatch.naming.view import WANDERS
from twinbench.physics.simulator import Array

ROWS, PLACES, FUNCTIONS = 40, 3, 2
SIZE = 2.0
"""Where the hypothesis stands, in prior sds."""


class Made:
    """Two recordings, one effect of known column that may wander, a discrepancy."""

    def __init__(self, in_each: tuple[float, float], wandering: float = 0.0) -> None:
        rng = np.random.default_rng(3)
        self.x = [rng.normal(size=(ROWS, 1)) * 8.0 for _ in in_each]
        places = [rng.normal(size=(ROWS, PLACES)) for _ in in_each]
        self.w = [WANDERS * SIZE * x * p for x, p in zip(self.x, places, strict=True)]
        self.f = [rng.normal(size=(ROWS, FUNCTIONS)) for _ in in_each]
        off = wandering / WANDERS * np.ones(PLACES)
        self.r = [
            (a - SIZE) * x[:, 0] + w @ off + rng.normal(size=ROWS)
            for a, x, w in zip(in_each, self.x, self.w, strict=True)
        ]
        own = [np.column_stack((x, w, r)) for x, w, r in zip(self.x, self.w, self.r, strict=True)]
        products = Products(
            np.array([o.T @ o for o in own]),
            np.array([o.T @ f for o, f in zip(own, self.f, strict=True)]),
            np.array([f.T @ f for f in self.f]),
        )
        self.ground: Any = SimpleNamespace()
        self.chosen: Any = SimpleNamespace(
            products=products,
            mean=np.array([-SIZE, *np.zeros(PLACES)]),
            z=np.zeros(1),
            effects=(None,),
            share=WANDERS,
            entries=lambda i: np.array([0]),
            wandering=lambda i: 1 + np.arange(PLACES),
            prior=lambda ground: (np.array([-SIZE, *np.zeros(PLACES + FUNCTIONS)]), np.ones(1 + PLACES + FUNCTIONS)),
        )

    def explained(self) -> tuple[float, float]:
        """Squares of what the readings owe to the discrepancy and to places, by the mean of a dense Gaussian."""
        x, w, f, r = (np.concatenate(part) for part in (self.x, self.w, self.f, self.r))
        cov = np.eye(len(r)) + x @ x.T + w @ w.T + f @ f.T
        left = np.linalg.solve(cov, r + SIZE * x[:, 0])
        by_f, by_w = (float(np.sum((part @ (part.T @ left)) ** 2)) for part in (f, w))
        return by_f, by_w

    def log(self, wide: float = 1.0, apart: float = 0.0) -> float:
        """Evidence with places so much wider, and sizes that differ by a share from recording to recording."""
        x, r = np.concatenate(self.x), np.concatenate(self.r)
        w, f = np.concatenate(self.w), np.concatenate(self.f)
        cov = np.eye(len(r)) + x @ x.T + wide**2 * w @ w.T + f @ f.T
        for k in range(2):
            one = np.zeros(len(r))
            one[k * ROWS : (k + 1) * ROWS] = apart * SIZE * self.x[k][:, 0]
            cov += np.outer(one, one)
        return float(multivariate_normal.logpdf(r, -SIZE * x[:, 0], cov))


def slopes(values: Array) -> None:
    assert (np.diff(values) < 0.0).all()


@pytest.mark.parametrize("second", [2.0, 2.6, 5.0])
def test_one_size_is_the_evidence_against_a_size_in_each_recording(second: float) -> None:
    made = Made((2.0, second))
    assert one_size(made.chosen, 0, made.ground) == pytest.approx(made.log() - made.log(apart=UNSTEADY), rel=1e-5)


@pytest.mark.parametrize("wandering", [0.0, 0.1, 0.5])
def test_one_form_is_the_evidence_against_one_that_is_off_by_far_more(wandering: float) -> None:
    made = Made((2.0, 2.0), wandering)
    expected = made.log() - made.log(wide=UNSTEADY / WANDERS)
    assert one_form(made.chosen, 0, made.ground) == pytest.approx(expected, rel=1e-5)


def test_a_stand_in_is_told_by_either_and_the_same_everywhere_by_none() -> None:
    same = Made((2.0, 2.0))
    assert one_size(same.chosen, 0, same.ground) > 0.0
    assert one_form(same.chosen, 0, same.ground) > 0.0
    slopes(np.array([one_size(m.chosen, 0, m.ground) for m in (same, Made((2.0, 3.5)), Made((2.0, 6.0)))]))
    slopes(np.array([one_form(m.chosen, 0, m.ground) for m in (same, Made((2.0, 2.0), 0.2), Made((2.0, 2.0), 0.6))]))


@pytest.mark.parametrize("wandering", [0.0, 0.5])
def test_squares_beside_are_those_of_a_dense_gaussians_mean(wandering: float) -> None:
    made = Made((2.0, 2.6), wandering)
    beside, (by_place,) = squares_beside(made.chosen, made.ground)
    assert (beside, by_place) == pytest.approx(made.explained(), rel=1e-5)


def test_a_stand_in_needs_more_beside_it() -> None:
    _, (right,) = squares_beside((made := Made((2.0, 2.0))).chosen, made.ground)
    _, (wrong,) = squares_beside((made := Made((2.0, 2.0), 0.5)).chosen, made.ground)
    assert wrong > 10.0 * right


def test_a_fault_has_no_form() -> None:
    made = Made((2.0, 2.0))
    made.chosen.wandering = lambda i: np.empty(0, dtype=int)
    assert one_form(made.chosen, 0, made.ground) == 0.0
    assert squares_beside(made.chosen, made.ground)[1] == [0.0]
