"""The oracle: interacting multiple models with the exact plant and the data sheet. The reference."""

from __future__ import annotations

from typing import Any, ClassVar

from twinbench.baselines.modes_ekf import ModesEKF
from twinbench.methods.estimator import register
from twinbench.physics.simulator import Simulator


@register
class Oracle(ModesEKF):
    """How good a causal filter is that is told the plant's own equations.

    It knows the noise of every sensor, the drift that sensors share, the population that machines start
    from, and in what ways health moves. It does not know when health changes, nor that a ramp is straight: a filter
    that does may be better.
    """

    name = "oracle"
    says = "interacting multiple models with the exact plant and the data sheet's noise (the reference)"

    settings: ClassVar[dict[str, Any]] = {**ModesEKF.settings, "health_walk": 2.0, "state_walk": 0.15, "still": 0.04}
    search_space = ModesEKF.search_space | {"state_walk": (0.03, 3.0)}

    def simulator(self) -> Simulator:
        """The plant itself."""
        return self.machine.plant
