"""What a simulator's equations depend on, found by trying them at many points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from twinbench.physics.compile import compiled
from twinbench.physics.simulator import Array, Equation, Simulator, Variable

TRIED_POINTS = 200
"""Points tried."""
NEAR_SCALES, FAR_SCALES = 1.0, 10.0
"""How far from its nominal value a variable is moved, within its bounds: half of the points are near, half are far."""


def dependences(simulator: Simulator) -> tuple[np.ndarray, np.ndarray]:
    """Which of the states and inputs each rate and each reading depends on: bool (nx, nx + nu) and (ny, nx + nu).

    Parameters are moved too: a mechanism that is off now may be switched on later.
    """
    equations = compiled(simulator)
    rates, readings = (
        np.zeros((len(group), len(simulator.states) + len(simulator.inputs)), dtype=bool)
        for group in (simulator.states, simulator.outputs)
    )
    for here, there, theta in _points(simulator):
        for function, found in ((equations.rhs, rates), (equations.output, readings)):
            before = _values(function, simulator, here, theta, len(found))
            for j, value in enumerate(there):
                moved = here.copy()
                moved[j] = value
                after = _values(function, simulator, moved, theta, len(found))
                found[:, j] |= (before != after) & ~(np.isnan(before) & np.isnan(after))
    return rates, readings


def _values(function: Equation, simulator: Simulator, point: Array, theta: Array, count: int) -> Array:
    """What an equation gives, (count,); NaN where it raises."""
    n = len(simulator.states)
    try:
        return np.asarray(function(point[:n].copy(), point[n:].copy(), theta.copy()))
    except Exception:
        return np.full(count, np.nan)


def _points(simulator: Simulator) -> Iterator[tuple[Array, Array, Array]]:
    """Two draws of states and inputs (nx + nu,), and parameters (np,): as often nominal as not."""
    rng = np.random.default_rng(0)
    variables = (*simulator.states, *simulator.inputs)
    for k in range(TRIED_POINTS):
        reach = (NEAR_SCALES, FAR_SCALES)[k % 2]
        theta = simulator.theta() if k % 4 < 2 else _drawn(simulator.parameters, reach, rng)
        yield _drawn(variables, reach, rng), _drawn(variables, reach, rng), theta


def _drawn(variables: Sequence[Variable], reach: float, rng: np.random.Generator) -> Array:
    low = np.array([max(v.low, v.nominal - reach * v.scale) for v in variables])
    high = np.array([min(v.high, v.nominal + reach * v.scale) for v in variables])
    return low + rng.random(len(variables)) * (high - low)
