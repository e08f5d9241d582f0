"""How each estimator is drawn: one colour, marker and line."""

from __future__ import annotations

from typing import Any, NamedTuple

from matplotlib.lines import Line2D

from twinbench.bench.roster import LABELS, PRIOR, REFERENCE, label, ordered
from twinbench.common.style import INK, PAPER

MARKERS = 8
"""Along each line: enough to follow it where lines cross, few enough to see it."""


class Look(NamedTuple):
    """How one estimator is drawn."""

    colour: str
    marker: str


# Okabe and Ito's colour-blind-safe palette; the oracle in ink and the prior in grey because they are there to compare
# with; the mended filter as far as can be from all of them, the nominal one above all. The others were searched for: as
# far as can be from these and one another, in CIELAB, for every reader.
_LOOKS = {
    "oracle": Look(INK, "D"),
    "oracle_smoother": Look("#3C1E5A", "d"),
    "always_prior": Look("#5C5C5C", "*"),
    "training_mean": Look("#694B78", "1"),
    "last_value": Look("#871E0F", "2"),
    "true_start_held": Look("#F0A5B4", "3"),
    "nominal_ekf": Look("#E69F00", "s"),
    "nominal_ekf_mended": Look("#5A3CE0", "P"),
    "nominal_ukf": Look("#5AD278", "<"),
    "nominal_iekf": Look("#0096FF", ">"),
    "nominal_enkf": Look("#0F1E87", "h"),
    "nominal_pf": Look("#2D5AC3", "8"),
    "nominal_imm": Look("#D24B3C", "+"),
    "nominal_mhe": Look("#0000F0", "H"),
    "residual_ukf": Look("#5A0000", "4"),
    "recursive_kalmannet": Look("#00002D", "."),
    "gru_kf": Look("#56B4E9", "^"),
    "s5_kf": Look("#0000A5", "x"),
    "lstm_rls": Look("#009E73", "v"),
    "deeponet": Look("#CC79A7", "X"),
    "pinn_ukf": Look("#0072B2", "p"),
    "deeponet_kalman": Look("#D55E00", "o"),
}
_SPARE = (Look("#8C6D31", "<"), Look("#7F7F7F", ">"), Look("#882255", "h"), Look("#44AA99", "d"))


def looks(names: list[str]) -> dict[str, Look]:
    """One look per estimator: fixed for the benchmark's own, spare ones in turn for any others."""
    others = [n for n in ordered(names) if n not in LABELS]
    spare = {n: _SPARE[i % len(_SPARE)] for i, n in enumerate(others)}
    return {n: _LOOKS[n] if n in LABELS else spare[n] for n in ordered(names)}


def legend_handles(names: list[str], line: bool = False) -> list[Line2D]:
    """Legend entries in the fixed order: markers, or lines for trajectories."""
    handles = []
    for name, look in looks(names).items():
        style: dict[str, Any] = (
            {"linewidth": 1.6, "linestyle": line_style(name), "markersize": 4}
            if line
            else {"linestyle": "none", "markersize": 5}
        )
        style |= {"marker": look.marker, "markerfacecolor": face(name, look)}
        handles.append(Line2D([], [], color=look.colour, label=label(name), **style))
    return handles


def face(name: str, look: Look) -> str:
    """Marker fill: the reference's is hollow wherever estimators are drawn as markers."""
    return PAPER if name == REFERENCE else look.colour


def line_style(name: str) -> str:
    """Dashed for the reference and dotted for the prior, wherever estimators are drawn as lines."""
    return {REFERENCE: "--", PRIOR: ":"}.get(name, "-")


def line_of(name: str, look: Look, place: int, several: int, points: int) -> dict[str, Any]:
    """How an estimator's line is drawn: a marker now and then, each line's elsewhere, so that none needs colour."""
    every = max(points // MARKERS, 1)
    return {
        "color": look.colour,
        "linestyle": line_style(name),
        "marker": look.marker,
        "markersize": 3.6,
        "markerfacecolor": face(name, look),
        "markevery": (place * every // max(several, 1), every),
    }
