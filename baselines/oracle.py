"""The oracle: an extended Kalman filter that knows the exact plant and the exact noise. The floor."""

from __future__ import annotations

from typing import Any, ClassVar

from baselines.model_ekf import ModelEKF
from methods.estimator import register
from physics.compressor import PLANT
from physics.simulator import Simulator


@register
class Oracle(ModelEKF):
    """How good a random-walk filter can be on this plant."""

    name = "oracle"
    says = "extended Kalman filter with the exact plant and noise (the floor)"

    settings: ClassVar[dict[str, Any]] = {**ModelEKF.settings, "health_walk": 1.351, "state_walk": 0.2363}

    def machine(self) -> Simulator:
        """The plant itself."""
        return PLANT
