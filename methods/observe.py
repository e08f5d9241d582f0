"""From the estimated quantities to what the sensors read, probe lag apart."""

from __future__ import annotations

import numpy as np

from twinbench.data.batch import ESTIMATE, Array
from twinbench.physics.compressor import M_REF_KG_S


def observe(mean: Array) -> Array:
    """Readings (..., 3), order OUTPUTS, of estimates (..., 10) with the probe settled.

    Args:
        mean: (..., 10) in the quantities' units, order ESTIMATED.
    """
    T_dis = mean[..., ESTIMATE.T_gas_K] + mean[..., ESTIMATE.T_bias_K]
    return np.stack([mean[..., ESTIMATE.p_exh_bar], T_dis, M_REF_KG_S * mean[..., ESTIMATE.flow_memory]], axis=-1)
