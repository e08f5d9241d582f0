"""The nominal reduced-order model: the plant's equations with its finer effects left out.

Valve losses four times too small, suction preheat three times too small and constant, no leak
re-heating, constant heat-transfer conductance, flat efficiency, no discharge-head metal, constant
probe lag, isothermal exhaust volume. ``MISMATCH`` scales all of it: 0 is the plant, 1 the model as
described. As described the model delivers too much everywhere, the more the higher speed and pressure ratio;
``baselines.nominal_ekf`` recalibrates ``RECALIBRATED`` on the training split.
"""

from __future__ import annotations

from dataclasses import replace

from twinbench.physics.compressor import PLANT
from twinbench.physics.simulator import Simulator

MISMATCH = 1.0
REDUCED = {
    "K_s": 0.012,
    "K_d": 0.015,
    "eps_0": 0.08,
    "eps_x": 0.0,
    "lam_L": 0.0,
    "UA_x": 0.0,
    "eta_2": 0.0,
    "eta_N": 0.0,
    "UA_h_W_K": 0.0,
    "tau_T_x": 0.0,
    "iso": 1.0,
}
"""What the reduced-order model sets each effect to."""
RECALIBRATED = ("V_d_m3", "eta_0", "UA_gw_W_K", "CdA_max_m2")
"""Constants that recalibration may move."""


def reduced(mismatch: float = MISMATCH) -> Simulator:
    """The model a fraction ``mismatch`` of the way from the plant to the reduced order."""
    theta = PLANT.theta()
    values = {}
    for name, value in REDUCED.items():
        full = theta[PLANT.index(name)]
        values[name] = float(full + mismatch * (value - full))
    return replace(
        PLANT.with_values(**values),
        name="nominal",
        says="reduced-order compressor model: valve loss, preheat and thermal coupling left out",
    )


NOMINAL = reduced()
