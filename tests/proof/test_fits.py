"""The bound for whoever judges by the fit alone, by hand."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from twinbench.proof.concealed.fits import fits, fits_as_markdown, limit_sq


def rows(unknown: list[float], known: list[float], sound: int) -> pd.DataFrame:
    left = [*unknown, *known, *[np.nan] * sound]
    cells = [*["left_out"] * len(unknown), *["mechanism"] * len(known), *["clean"] * sound]
    return pd.DataFrame({"cell": cells, "left_sq": left, "detectable": np.isfinite(left)})


def test_as_little_may_be_left_as_keeps_the_promise() -> None:
    # Of 100 cases two may be wrong: the third stand-in is the first that has to be refused.
    table = rows([400.0, 9.0, 30.0, 50.0], [0.0, 1.0, 20.0, 49.0, 51.0], 91)
    assert limit_sq(table) == 50.0
    found = fits(table).set_index("cell")
    assert found.loc["mechanism", "fitted"] == pytest.approx(0.8)
    assert found.loc["left_out", "fitted"] == pytest.approx(0.5)
    assert found.loc["mechanism", "left_50"] == 20.0
    assert "clean" not in found.index


def test_where_nothing_stands_in_all_may_be_left() -> None:
    table = rows([], [3.0], 9)
    assert limit_sq(table) == np.inf
    assert fits(table)["fitted"].tolist() == [1.0]
    assert "| mechanism | 1 | 3 | 3 | 3 | 1.00 |" in fits_as_markdown(fits(table), np.inf)
