"""Two tanks as an FMU that can only be stepped, and days of them: sound, or with something wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.integrate import solve_ivp

from helpers.small_fmu import SmallFMU
from twinbench.data.recording import Recording

TOLD = SmallFMU(
    states={"h1": "(q - k1 * sqrt(fabs(h1))) / A", "h2": "(k1 * sqrt(fabs(h1)) - k2 * sqrt(fabs(h2))) / A"},
    inputs={"q": 1.0},
    outputs={"l1": "h1", "l2": "h2"},
    parameters={"A": 2.0, "k1": 0.8, "k2": 0.9},
    more={
        "q": 'min="0" max="2"', "A": 'min="0.5" max="5"', "k1": 'min="0.2" max="2"', "k2": 'min="0.2" max="2"',
        "h1": 'min="0" max="6"', "h2": 'min="0" max="6"',
    },
)  # fmt: skip
"""For model exchange: it tells its rates."""
STEPPED = replace(TOLD, exchange="CoSimulation", tells=False, starts=("h1", "h2"))
SAMPLES, PERIOD_S, NOISE = 600, 0.2, 0.01


def days(
    seed: int = 5, gain_q: float = 0.0, lag_l2_s: float = 0.0, k2: float = 0.9, hole: float = 0.0
) -> list[Recording]:
    """Three days.

    Args:
        gain_q: what the tanks get beyond the inflow that is recorded, as a share of it.
        lag_l2_s: of the second level's sensor.
        hole: what a hole at the height of 1 in the second tank lets out, per height above it.
    """
    rng, found = np.random.default_rng(seed), []
    time_s = PERIOD_S * np.arange(SAMPLES)
    for k in range(3):
        q = np.clip(1.0 + 0.5 * np.repeat(rng.standard_normal(SAMPLES // 25), 25), 0.1, 1.9)
        h = _levels(q * (1.0 + gain_q), np.array([1.3, 1.1]) * rng.uniform(0.8, 1.2, 2), k2, hole)
        for i in range(1, SAMPLES if lag_l2_s else 0):
            h[i, 1] = h[i - 1, 1] + (1.0 - np.exp(-PERIOD_S / lag_l2_s)) * (h[i, 1] - h[i - 1, 1])
        read = h + NOISE * rng.standard_normal(h.shape)
        found.append(Recording(f"day{k}", time_s, ("q", "l1", "l2"), np.column_stack((q, read))))
    return found


def _levels(q: np.ndarray, start: np.ndarray, k2: float, hole: float) -> np.ndarray:
    """(N, 2) at the samples; the inflow holds from one to the next."""

    def rates(t: float, h: np.ndarray) -> list[float]:
        through = 0.8 * np.sqrt(abs(h[0]))
        out = k2 * np.sqrt(abs(h[1])) + hole * max(0.0, h[1] - 1.0)
        return [(q[int(t / PERIOD_S + 1e-9)] - through) / 2.0, (through - out) / 2.0]

    levels, begin = [start], 0
    for end in [*(np.flatnonzero(np.diff(q)) + 1), SAMPLES - 1]:
        at = PERIOD_S * np.arange(begin, end + 1)
        inside = at[0], at[-1] - 1e-6 * PERIOD_S  # where the inflow steps, the old one holds
        there = solve_ivp(rates, inside, levels[-1], t_eval=np.minimum(at, inside[1]), rtol=1e-9, atol=1e-9)
        levels += list(there.y.T[1:])
        begin = end
    return np.array(levels)
