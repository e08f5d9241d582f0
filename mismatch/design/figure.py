"""The proposed experiment drawn: its inputs, and what each rival foretells."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twinbench.common.style import BLUE, INK, MOST_POINTS, MUTED, PAGE_MM, VERMILION, canvas, styled, thin
from twinbench.mismatch.design.request import Designed
from twinbench.mismatch.design.trials import Foretold, foretold
from twinbench.mismatch.mixture import Z90
from twinbench.mismatch.words import labelled
from twinbench.physics.simulator import Array

LOOKS = ((BLUE, "-"), (VERMILION, (0, (3.5, 1.2))), ("#009E73", (0, (1.2, 1.2))))
"""Colour and line of each rival."""
PANEL_MM = 34.0


@styled
def experiment(d: Designed) -> Figure:
    """Inputs that move, then the output that tells most: what rivals foretell, and how far that is from the first's."""
    candidate, simulator = d.proposal.trial.candidate, d.hand.rivals[0].problem.machine.simulator
    moving = [k for k in range(len(simulator.inputs)) if np.ptp(candidate.u[:, k]) > 0.0]
    figure = canvas(PAGE_MM, PANEL_MM * (len(moving) + 2))
    rows = figure.subplots(len(moving) + 2, 1, sharex=True, squeeze=False)[:, 0]
    some = thin(len(candidate.time_s), MOST_POINTS)
    for axes, k in zip(rows, moving, strict=False):
        axes.step(candidate.time_s[some], candidate.u[some, k], where="post", color=INK, linewidth=1.0)
        axes.set_ylabel(labelled(simulator.inputs[k].name, simulator.inputs[k].unit))
    found, clock = foretold(candidate, d.hand, d.clock), d.clock
    noise = np.sqrt(clock.noise.variance)
    c = _telling(found, noise, d.hand.measured)
    v, time_s = simulator.outputs[c], d.proposal.trial.track.block_time_s - clock.begin_s
    _responses(rows[-2], time_s, found, c, d.hand.names)
    rows[-2].set_ylabel(labelled(v.name, v.unit))
    _apart(rows[-1], time_s, found, c, float(noise[c]))
    rows[-1].set_ylabel(labelled("difference", v.unit))
    rows[-1].set_xlabel("time, s")
    return figure


def _telling(found: list[Foretold], noise: Array, measured: np.ndarray) -> int:
    """The output in which rivals are furthest apart, in sds of its noise; without rivals that which moves most."""
    apart = [f.means - found[0].means for f in found[1:]] or [found[0].means - found[0].means.mean(axis=0)]
    rms = np.sqrt(np.mean(np.square(apart), axis=(0, 1))) / noise
    return int(np.argmax(np.where(measured, np.nan_to_num(rms), -1.0)))


def _responses(axes: Axes, time_s: Array, found: list[Foretold], c: int, names: tuple[str, ...]) -> None:
    for f, name, (colour, line) in zip(found, names, LOOKS, strict=False):
        axes.plot(time_s, f.means[:, c], color=colour, linestyle=line, label=name or "foretold", linewidth=1.0)
    axes.legend(loc="best")


def _apart(axes: Axes, time_s: Array, found: list[Foretold], c: int, noise: float) -> None:
    """Differences from the first rival, each with the 90 % band of what its rival leaves open; and the noise."""
    axes.axhspan(-noise, noise, color=MUTED, alpha=0.15, linewidth=0)
    for f, (colour, line) in zip(found, LOOKS, strict=False):
        middle, half = f.means[:, c] - found[0].means[:, c], Z90 * f.sds[:, c]
        axes.plot(time_s, middle, color=colour, linestyle=line, linewidth=1.0)
        axes.fill_between(time_s, middle - half, middle + half, color=colour, alpha=0.18, linewidth=0)
