"""How the sensors err: white and coloured noise, heteroscedastic in speed. Probe lag is a plant state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SensorNoise:
    """Noise of one channel: ``white`` and ``coloured`` sd, as a share of reading or in the unit.

    The coloured part is AR(1) with time constant ``tau_s``; ``with_speed``: both grow with speed.
    """

    channel: str
    white: float
    coloured: float
    tau_s: float
    relative: bool
    with_speed: bool = False


OUTPUT_NOISE = (
    SensorNoise("p_dis_bar", 0.0040, 0.0025, 0.4, relative=True, with_speed=True),
    SensorNoise("T_dis_K", 0.6, 0.4, 3.0, relative=False),
    SensorNoise("m_flow_kg_s", 0.008, 0.005, 0.6, relative=True, with_speed=True),
)
INPUT_NOISE = (
    SensorNoise("p_suc_bar", 0.0015, 0.0, 1.0, relative=True),
    SensorNoise("T_suc_K", 0.2, 0.0, 1.0, relative=False),
    SensorNoise("N_rpm", 1.5, 0.0, 1.0, relative=False),
    SensorNoise("valve", 0.0, 0.0, 1.0, relative=False),
)
PRESSURE_DRIFT_SHARE = 0.0008
"""sd of the slow drift that suction and discharge pressure share (common electronics)."""
PRESSURE_DRIFT_TAU_S = 300.0


def speed_factor(N_rpm: Array) -> Array:
    """h(N): noise at 1800 rpm is 1.3/0.7 of that at 900.

    Args:
        N_rpm: (N,) or of any shape, in rpm.
    """
    return 0.7 + 0.6 * (N_rpm - 900.0) / 900.0
