"""What was taken for noise of a sensor: does it go with the states and inputs? Against series of a known kind."""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.mismatch.unread import goes_with
from twinbench.physics.simulator import Array

FLOOR = 0.1


def drawn(seed: int, share: float) -> tuple[list[Array], list[Array]]:
    """Columns of two recordings, and series of which a share of the squares are a function of them."""
    rng = np.random.default_rng(seed)
    weights, columns, series = rng.normal(size=6), [], []
    for length in (300, 200):
        columns.append(rng.normal(size=(length, 6)) / np.sqrt(6.0))
        law, noise = columns[-1] @ weights, rng.normal(size=length)
        law, noise = (part / np.sqrt(np.mean(part**2)) for part in (law, noise))
        series.append(np.sqrt(share) * law + np.sqrt(1.0 - share) * noise)
    return columns, series


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_as_much_goes_with_the_functions_as_they_made(share: float) -> None:
    squares, gone = goes_with(*drawn(1, share), FLOOR)
    assert squares == pytest.approx(1.0, abs=0.1)
    assert share - 0.15 < gone < share, "the 5 % quantile, on pieces that were not learnt from"


def test_noise_that_lasts_goes_with_nothing() -> None:
    columns, _ = drawn(2, 0.0)
    rng = np.random.default_rng(3)
    slow = [np.convolve(rng.normal(size=len(X) + 19), np.ones(20), "valid") for X in columns]
    assert goes_with(columns, slow, FLOOR)[1] < 0.0


def test_what_was_not_read_says_nothing() -> None:
    columns, series = drawn(4, 0.9)
    squares, gone = goes_with([*columns, columns[0]], [*series, np.full(300, np.nan)], FLOOR)
    assert (squares, gone) == pytest.approx(goes_with(columns, series, FLOOR), abs=0.02)
    assert goes_with(columns[:1], [np.full(300, np.nan)], FLOOR) == (0.0, 0.0)
