"""Operating points: where the machine settles, and the valve command that holds a pressure ratio."""

from __future__ import annotations

import functools

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import root

from twinbench.physics.compile import compiled
from twinbench.physics.compressor import PLANT
from twinbench.physics.integrate import simulate
from twinbench.physics.simulator import Array, Simulator

DESIGN_POINT = (1350.0, 3.3)  # N_rpm, pressure ratio
_GRID_N_RPM = np.linspace(800.0, 1900.0, 9)
_GRID_RATIO = np.linspace(1.8, 5.4, 13)
_P_SUC_BAR, _T_SUC_K = 0.95, 298.0


def steady_state(simulator: Simulator, u: Array, theta: Array | None = None) -> Array:
    """The state (nx,) at which every balance closes under constant inputs u (nu,).

    Args:
        u: (nu,) inputs in their units, constant.
        theta: (np,), each in its parameter's unit; the simulator's nominal values if left out.

    Raises:
        ValueError: the machine does not settle there.
    """
    theta = simulator.theta() if theta is None else theta
    rhs = compiled(simulator).rhs
    u = np.ascontiguousarray(u, dtype=np.float64)
    guess = simulator.initial(u, np.array([v.nominal for v in simulator.outputs]), theta)
    settled, _ = simulate(simulator, np.tile(u, (1, 2400, 1)), guess, theta)
    scale = np.array([v.scale for v in simulator.states])
    solution = root(lambda z: rhs(z * scale, u, theta) / scale, settled[0, -1] / scale, tol=1e-12)
    residual = np.abs(rhs(solution.x * scale, u, theta) / scale).max()
    if not residual < 1e-8:
        raise ValueError(f"simulator {simulator.name!r} does not settle at u = {u.tolist()}")
    return solution.x * scale


def valve_for(N_rpm: Array, pressure_ratio: Array) -> Array:
    """Valve command that holds a pressure ratio on the healthy plant at 0.95 bar, by interpolation.

    Args:
        N_rpm: speeds of any shape, in rpm.
        pressure_ratio: of any shape that goes with it, dimensionless.
    """
    points = np.stack(np.broadcast_arrays(N_rpm, pressure_ratio), axis=-1)
    return _valve_table()(points).reshape(points.shape[:-1])


@functools.cache
def _valve_table() -> RegularGridInterpolator:
    table = np.array([[_valve_at(n, ratio) for ratio in _GRID_RATIO] for n in _GRID_N_RPM])
    return RegularGridInterpolator((_GRID_N_RPM, _GRID_RATIO), table, bounds_error=False, fill_value=None)


def _valve_at(N_rpm: float, pressure_ratio: float) -> float:
    """Solve the steady balances for the valve position with the exhaust pressure given."""
    theta = PLANT.theta()
    rhs = compiled(PLANT).rhs
    scale = np.array([v.scale for v in PLANT.states])
    p_exh = pressure_ratio * _P_SUC_BAR
    u = np.array([_P_SUC_BAR, _T_SUC_K, N_rpm, 0.6])
    guess = PLANT.initial(u, np.array([p_exh, 300.0 + 45.0 * pressure_ratio, 0.12 * N_rpm / 1350.0]), theta)

    def balances(z: Array) -> Array:
        x = z * scale
        inputs = np.array([u[0], u[1], u[2], x[6]])  # the valve stands where it is told
        x[1] = p_exh
        dx = rhs(x, inputs, theta) / scale
        dx[6] = z[1] - p_exh / scale[1]  # the freed row keeps the unused unknown in place
        return dx

    solution = root(balances, guess / scale, tol=1e-10)
    if not solution.success:
        raise ValueError(f"no valve position gives ratio {pressure_ratio} at {N_rpm} rpm")
    return float(solution.x[6] * scale[6])
