"""From the estimated quantities to what the sensors read, probe lag apart."""

from __future__ import annotations

import numpy as np

from twinbench.data.batch import Array
from twinbench.physics.compressor import M_REF_KG_S


def observe(mean: Array) -> Array:
    """Readings (..., 3), order OUTPUTS, of estimates (..., 10) with the probe settled.

    Args:
        mean: (..., 10) in the quantities' units, order ESTIMATED.
    """
    return np.stack([mean[..., 1], mean[..., 2] + mean[..., 9], M_REF_KG_S * mean[..., 4]], axis=-1)
