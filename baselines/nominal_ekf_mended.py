"""The nominal EKF with a model that the mismatch engine has mended from the training recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from twinbench.baselines.model_ekf import ModelEKF
from twinbench.baselines.nominal_ekf import NominalEKF, recalibrate, rescaled
from twinbench.data.batch import CHANNELS, INPUTS, Array, Batch
from twinbench.data.recording import Recording
from twinbench.methods.estimator import register
from twinbench.mismatch import diagnose
from twinbench.physics.nominal import NOMINAL
from twinbench.physics.simulator import Simulator


@register
class NominalEKFMended(ModelEKF):
    """What the same engineer would run who has asked the recordings what the model leaves out.

    The engine sees the sensor columns of some training recordings. What it finds is switched on in the
    nominal model; then all goes on as in ``NominalEKF``, recalibration included.
    """

    name = "nominal_ekf_mended"
    says = "the nominal EKF after the mismatch engine has mended its model"
    settings: ClassVar[dict[str, Any]] = {
        **NominalEKF.settings,
        "recordings": 6,
        "hold_out": 2,
        "recording_minutes": 10.0,
        "health_walk": 1.275,
        "state_walk": 9.445,
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {**ModelEKF.search_space, "recording_minutes": [10.0, 25.0]}
    contract_settings: ClassVar[dict[str, Any]] = {"recordings": 1, "hold_out": 1, "recording_minutes": 1.0}

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Mend the model, recalibrate it as the nominal one, then as the base class."""
        self.arrays = {
            "mended": mend(train, *(self.config[k] for k in ("recordings", "hold_out", "recording_minutes")))
        }
        self.arrays["recalibrated"] = recalibrate(self._mended(), train, self.config["calibration_minutes"])
        super().fit(train, validation, seed)

    def machine(self) -> Simulator:
        """The mended model with its recalibrated constants."""
        return rescaled(self._mended(), self.arrays["recalibrated"])

    def _mended(self) -> Simulator:
        names = (v.name for v in NOMINAL.parameters)
        return NOMINAL.with_values(**dict(zip(names, map(float, self.arrays["mended"]), strict=True)))


def mend(train: Batch, recordings: int, hold_out: int, minutes: float) -> Array:
    """Parameters (np,) of the nominal model after the engine has added what it found.

    The proof needs another regime than the fit: held out are the recordings of the fastest runs on
    average; learnt from are as many as wanted of the others, spread evenly over their speeds.

    Args:
        minutes: of each recording, from its start.
    """
    speed = np.nanmean(train.measured[..., INPUTS.index("N_rpm")], axis=1)
    order = np.argsort(speed, kind="stable")
    others, fastest = order[: len(order) - hold_out], order[len(order) - hold_out :]
    chosen = others[np.unique(np.linspace(0, len(others) - 1, recordings).round().astype(int))]
    ticks = train.time_s - train.time_s[0] < 60.0 * minutes

    def sensors(b: int) -> Recording:
        return Recording(train.names[b], train.time_s[ticks], CHANNELS, train.measured[b, ticks])

    verdict = diagnose(NOMINAL, [sensors(b) for b in chosen], hold_out=[sensors(b) for b in fastest])
    own = {v.name for v in NOMINAL.parameters}  # a sensor's fault is not the model's
    return NOMINAL.with_values(**{n: v for n, v in verdict.values.items() if n in own}).theta()
