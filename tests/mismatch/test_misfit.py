"""How well a hypothesis fits, with the discrepancy and what wanders integrated out, against dense algebra."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from twinbench.mismatch.naming.ground import Products
from twinbench.mismatch.naming.misfit import Wandering, squared
from twinbench.mismatch.naming.view import HARDLY, WANDERS

S_PCT = np.array([0.4, 1.5, 0.4])


@pytest.mark.parametrize("share", [WANDERS, HARDLY])
def test_squares_are_those_of_the_readings_marginal_covariance(share: float) -> None:
    """Two recordings of 15 readings in sds, three functions of the discrepancy, two columns that wander."""
    rng = np.random.default_rng(5)
    white = [rng.normal(size=(15, 3)) for _ in range(2)]
    wander = [3.0 * rng.normal(size=(15, 2)) for _ in range(2)]
    left = [2.0 * rng.normal(size=(15, 1)) for _ in range(2)]
    ground = SimpleNamespace(
        white=white,
        FF=np.array([w.T @ w for w in white]),
        precision=lambda s: s**-2.0,
        whitened=lambda r, columns, difference: difference,
    )
    own = [np.concatenate((rng.normal(size=(15, 1)), w, e), axis=1) for w, e in zip(wander, left, strict=True)]
    whole = Products(
        np.array([o.T @ o for o in own]),
        np.array([o.T @ w for o, w in zip(own, white, strict=True)]),
        ground.FF,
    )
    wandering = Wandering.of(whole.scaled(np.array([1, 2]), share / WANDERS), wander, share)

    F, W, r = np.concatenate(white), np.concatenate(wander) * share / WANDERS, np.concatenate(left)
    covariance = np.eye(30) + W @ W.T + F @ np.diag(S_PCT**2) @ F.T
    assert squared(ground, S_PCT, wandering)(left) == pytest.approx((r.T @ np.linalg.solve(covariance, r)).item())
    covariance -= W @ W.T
    assert squared(ground, S_PCT)(left) == pytest.approx((r.T @ np.linalg.solve(covariance, r)).item())
