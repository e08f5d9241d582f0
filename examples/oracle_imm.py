"""An estimator built on ours: the reference in another form, with modes of wear in the place of the jump test.

``twinbench tune examples/oracle_imm.py --profile two_tanks --online --trials 12 --out results/tuning/reference``
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

from twinbench.baselines.model_ekf import ModelEKF
from twinbench.baselines.nominal_imm import NominalIMM
from twinbench.data.batch import Batch
from twinbench.methods.estimator import register
from twinbench.physics.simulator import Simulator


@register
class OracleIMM(NominalIMM):
    """Interacting multiple models of wear, still, ramping and leaping, with the plant's own equations."""

    name = "oracle_imm"
    says = "interacting multiple models of wear with the exact plant and the data sheet's noise"
    settings: ClassVar[dict[str, Any]] = {
        **NominalIMM.settings,
        "health_walk": 0.5,
        "state_walk": 0.3,
        "slow_error": 0.0,
        "still": 0.1,
        "leap": 3.0,
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {
        name: ends for name, ends in NominalIMM.search_space.items() if name != "slow_error"
    }

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Nothing is recalibrated: the plant is known."""
        self.arrays = {}
        ModelEKF.fit(self, train, validation, seed)

    def simulator(self) -> Simulator:
        """The plant itself."""
        return self.machine.plant
