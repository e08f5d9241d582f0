"""The oracle: an extended Kalman filter that knows the exact plant and the data sheet's noise. The reference.

It is no bound: it does not know the slow drift that the pressure sensors share.
"""

from __future__ import annotations

from typing import Any, ClassVar

from twinbench.baselines.model_ekf import ModelEKF
from twinbench.methods.estimator import register
from twinbench.physics.compressor import PLANT
from twinbench.physics.simulator import Simulator


@register
class Oracle(ModelEKF):
    """How good this random-walk filter is with the plant's own equations."""

    name = "oracle"
    says = "extended Kalman filter with the exact plant and the data sheet's noise (the reference)"

    settings: ClassVar[dict[str, Any]] = {**ModelEKF.settings, "health_walk": 1.351, "state_walk": 0.2363}

    def machine(self) -> Simulator:
        """The plant itself."""
        return PLANT
