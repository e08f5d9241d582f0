"""The lag of the discharge temperature's probe, which every filter of the compressor has to know."""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.machines.compressor import SAMPLE_PERIOD_S
from twinbench.physics.compressor import PLANT, P

TAU_PROBE_S = float(PLANT.theta()[P.tau_T_s])
TAU_PROBE_X = float(PLANT.theta()[P.tau_T_x])


@njit(cache=True, error_model="numpy")
def probe_lag(mu):  # type: ignore[no-untyped-def]
    """Share of the gap to the gas that the probe closes in a tick, and its slope to the flow."""
    mu = max(mu, 0.05)
    tau = TAU_PROBE_S * mu**-TAU_PROBE_X
    keep = np.exp(-SAMPLE_PERIOD_S / tau)
    return 1.0 - keep, keep * SAMPLE_PERIOD_S / tau * TAU_PROBE_X / mu
