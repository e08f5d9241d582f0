"""Colours and markers: whoever reads a figure, colour-blind or not, tells every estimator from every other."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from helpers.sample_run import LEVELS, make_estimates, make_truth

from twinbench.bench.report.evidence import gather
from twinbench.bench.report.figures.looks import looks
from twinbench.bench.report.figures.tracks import parameter_tracking, state_trajectories
from twinbench.bench.roster import LABELS, TRIVIAL, TRUE_START

READERS = {
    "everybody": np.eye(3),
    "protanopia": np.array([
        [0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998],
    ]),
    "deuteranopia": np.array([
        [0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881],
    ]),
}  # fmt: skip
"""Machado, Oliveira and Fernandes (2009), IEEE Transactions on Visualization and Computer Graphics 15(6), 1291-1298:
severity 1, on linear RGB."""
XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)
WHITE = np.array([0.95047, 1.0, 1.08883])
LEAST_LAB = 15.0
"""Euclid's distance in CIELAB; 2.3 is just noticed side by side, and markers of 5 pt are not side by side."""


def lab(colour: str, reader: str) -> np.ndarray:
    """CIELAB of an sRGB colour as a reader sees it."""
    srgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    ratio = XYZ @ np.clip(READERS[reader] @ linear, 0.0, 1.0) / WHITE
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def apart(one: str, other: str, reader: str) -> float:
    return float(np.linalg.norm(lab(one, reader) - lab(other, reader)))


@pytest.mark.parametrize("reader", READERS)
def test_every_two_estimators_differ_in_colour(reader):
    # The rows that cost nothing are all grey: their markers tell them apart.
    drawn = looks([name for name in LABELS if name not in (*TRIVIAL[1:], TRUE_START)])
    gaps = {(a, b): apart(drawn[a].colour, drawn[b].colour, reader) for a, b in combinations(drawn, 2)}
    near = {pair: round(gap, 1) for pair, gap in gaps.items() if gap < LEAST_LAB}
    assert near == {}
    assert gaps["nominal_ekf", "nominal_ekf_mended"] > 50.0


def test_the_mended_filters_earlier_colour_would_be_noticed():
    nominal = looks(["nominal_ekf"])["nominal_ekf"].colour
    assert apart(nominal, "#B8A900", "protanopia") < LEAST_LAB


def test_every_two_estimators_differ_in_marker():
    markers = [look.marker for look in looks(list(LABELS)).values()]
    assert len(set(markers)) == len(LABELS)


def test_every_estimators_line_has_its_marker():
    truth = make_truth(5, 200)
    evidence = gather((make_estimates(truth, e, 0, level) for e, level in LEVELS.items()), truth, {})
    assert evidence.trajectory is not None
    drawn = looks(list(LEVELS))
    for figure in (state_trajectories(evidence.trajectory), parameter_tracking(evidence.degradations)):
        seen = {
            (line.get_color(), line.get_marker())
            for axes in figure.axes
            for line in axes.lines
            if line.get_color() in {look.colour for look in drawn.values()} and len(line.get_xdata()) > 2
        }
        assert len(seen) >= len(LEVELS) - 1
        assert all(marker not in ("", "None", None) for _, marker in seen)


@pytest.mark.parametrize("alone", [("last_value",), ("training_mean", "last_value")])
def test_rows_that_cost_nothing_are_drawn_where_nobody_else_was_run(alone):
    truth = make_truth(5, 200)
    evidence = gather((make_estimates(truth, name, 0, 1.0) for name in alone), truth, {})
    assert evidence.trajectory is not None
    axes = state_trajectories(evidence.trajectory).axes
    assert any(line.get_color() == looks(alone[:1])[alone[0]].colour for line in axes[0].lines)
