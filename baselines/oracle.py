"""The oracle: a jump-aware extended Kalman filter that knows the exact plant and the data sheet. The reference."""

from __future__ import annotations

from typing import Any, ClassVar

from twinbench.baselines.jump_aware import JumpAwareEKF
from twinbench.methods.estimator import register
from twinbench.physics.simulator import Simulator


@register
class Oracle(JumpAwareEKF):
    """How good a causal filter is that is told the plant's own equations.

    It knows the noise of every sensor, the drift that sensors share, the population that machines start
    from, and that health wanders and may leap. It does not know when health changes, nor that a slow change is a ramp:
    a filter that does may be better.
    """

    name = "oracle"
    says = "jump-aware extended Kalman filter with the exact plant and the data sheet's noise (the reference)"

    settings: ClassVar[dict[str, Any]] = {
        **JumpAwareEKF.settings,
        "health_walk": 0.925,
        "state_walk": 2.666,
        "leap": 1.05,
    }

    def simulator(self) -> Simulator:
        """The plant itself."""
        return self.machine.plant
