"""The nominal EKF with a model that the mismatch engine has mended from the training recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from twinbench.baselines.model_ekf import ModelEKF
from twinbench.baselines.nominal_ekf import NominalEKF, recalibrate, rescaled
from twinbench.common.errors import BadInput
from twinbench.data.batch import Array, Batch
from twinbench.data.recording import Recording
from twinbench.methods.estimator import register
from twinbench.mismatch import diagnose
from twinbench.physics.known_health import with_known_health
from twinbench.physics.load import builtin_catalogue
from twinbench.physics.simulator import Simulator


@register
class NominalEKFMended(ModelEKF):
    """What the same engineer would run who has asked the recordings what the model leaves out.

    The engine sees the sensor columns of some training recordings and their known health, from which the nominal model
    is recalibrated too. What it finds is switched on in the nominal model. Then all goes on as in ``NominalEKF``,
    recalibration included.
    """

    name = "nominal_ekf_mended"
    says = "the nominal EKF after the mismatch engine has mended its model"
    settings: ClassVar[dict[str, Any]] = {
        **NominalEKF.settings,
        "recordings": 6,
        "hold_out": 2,
        "recording_minutes": 10.0,
        "health_walk": 1.2,
        "state_walk": 1.077,
        "slow_error": 1.0,
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {**NominalEKF.search_space, "recording_minutes": [10.0, 25.0]}
    contract_settings: ClassVar[dict[str, Any]] = {"recordings": 1, "hold_out": 1, "recording_minutes": 1.0}

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Mend the model, recalibrate it as the nominal one, then as the base class.

        Raises:
            BadInput: nothing is known of what such a machine's model may lack.
        """
        if not builtin_catalogue(self.machine.reduced):
            raise BadInput(f"{self.name}: there is no catalogue to mend the model of {self.machine.name!r} from")
        self.arrays = {
            "mended": mend(train, *(self.config[k] for k in ("recordings", "hold_out", "recording_minutes")))
        }
        self.arrays["recalibrated"] = recalibrate(self._mended(), train, self.config["calibration_minutes"])
        super().fit(train, validation, seed)

    def simulator(self) -> Simulator:
        """The mended model with its recalibrated constants."""
        return rescaled(self._mended(), self.machine.recalibrated, self.arrays["recalibrated"])

    def _mended(self) -> Simulator:
        names = (v.name for v in self.machine.reduced.parameters)
        return self.machine.reduced.with_values(**dict(zip(names, map(float, self.arrays["mended"]), strict=True)))


def mend(train: Batch, recordings: int, hold_out: int, minutes: float) -> Array:
    """Parameters (np,) of the nominal model after the engine has added what it found.

    The proof needs another regime than the fit: held out are the recordings that are highest, on average, in the
    machine's first regime (its speed); learnt from are as many as wanted of the others, spread evenly over it.

    The health is among the inputs. If the engine had to follow it too, it would take lasting wear for missing physics:
    what it finds then follows the sensors as well, but puts the health wrong.

    Args:
        minutes: of each recording, from its start.
    """
    assert train.truth is not None
    machine, health = train.machine, train.truth.health
    regime = next(iter(machine.regimes.values()), machine.inputs[0])
    order = np.argsort(np.nanmean(machine.along(regime, train.measured), axis=1), kind="stable")
    others, highest = order[: len(order) - hold_out], order[len(order) - hold_out :]
    chosen = others[np.unique(np.linspace(0, len(others) - 1, recordings).round().astype(int))]
    ticks = train.time_s - train.time_s[0] < 60.0 * minutes

    def seen(b: int) -> Recording:
        inputs, outputs = np.split(train.measured[b, ticks], [len(machine.inputs)], axis=1)
        values = np.hstack((inputs, health[b, ticks], outputs))
        channels = (*machine.inputs, *machine.health_names, *machine.outputs)
        return Recording(train.names[b], train.time_s[ticks], channels, values)

    verdict = diagnose(
        with_known_health(machine.reduced),
        [seen(b) for b in chosen],
        hold_out=[seen(b) for b in highest],
        leave_out=tuple(f"*@{name}" for name in machine.health_names),  # no sensor reads them, so none is at fault
    )
    own = {v.name for v in machine.reduced.parameters}  # a sensor's fault is not the model's
    return machine.reduced.with_values(**{n: v for n, v in verdict.values.items() if n in own}).theta()
