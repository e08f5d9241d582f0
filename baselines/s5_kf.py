"""S5 + Kalman: a diagonal state-space model in the place of GRU + KF's recurrent network, all else the same.

The memory is that of ``baselines.state_space`` (Smith et al., 2023: S5; Gu and Dao, 2023: Mamba). What it reads, its
head, the training, and the Kalman filter of its error are GRU + KF's, and so is its number of weights: what the two
differ by is the memory.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from twinbench.baselines.gru_kf import GRUKalman
from twinbench.baselines.recurrent import ReadoutTwin, TwoRates
from twinbench.baselines.state_space import StateSpace
from twinbench.baselines.state_space_twin import StateSpaceTwin
from twinbench.methods.estimator import register


@register
class S5Kalman(GRUKalman):
    """Linear recurrences, gated between the layers, in the place of a gated recurrence."""

    name = "s5_kf"
    says = "diagonal state-space network, its error estimated by a Kalman filter"
    settings: ClassVar[dict[str, Any]] = {
        **GRUKalman.settings,
        "hidden": 80,
        "states": 96,
        "layers": 2,
        "readout": 250,
        "noise_inflation": 2.346,
        "error_memory": 15.46,
    }

    def network(self, features: int) -> TwoRates:
        """Of so many features, a mean and a standard deviation of each entry of z."""
        c = self.config
        step_s = self._ticks * self.machine.sample_period_s
        widths = c["hidden"], c["states"], c["layers"]
        return StateSpace(features, widths, c["readout"], 2 * self._layout.size, step_s)

    def twin(self, arrays: dict[str, np.ndarray]) -> ReadoutTwin:
        """The compiled recurrence.

        Args:
            arrays: by name, what was learnt, of any shape, dimensionless.
        """
        return StateSpaceTwin(arrays)
