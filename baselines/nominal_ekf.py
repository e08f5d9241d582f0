"""Extended Kalman filter with the recalibrated nominal reduced-order model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from scipy.optimize import least_squares

from twinbench.baselines.model_ekf import ModelEKF
from twinbench.data.batch import Array, Batch
from twinbench.methods.estimator import register
from twinbench.methods.frontend import FrontEnd
from twinbench.physics.integrate import Varying, simulate
from twinbench.physics.simulator import Simulator


@register
class NominalEKF(ModelEKF):
    """What an engineer would run who has the reduced-order model and calibration recordings.

    It knows how much the model errs for minutes, from the validation recordings, and the sensors' data sheet.
    """

    name = "nominal_ekf"
    says = "extended Kalman filter with the recalibrated reduced-order model"
    implementations: ClassVar[tuple[str, ...]] = ("compiled", "filterpy")
    settings: ClassVar[dict[str, Any]] = {
        **ModelEKF.settings,
        "substeps": 1,
        "calibration_minutes": 8.0,
        "health_walk": 0.6321,
        "state_walk": 10.22,
        "slow_error": 3.389,
    }

    search_space: ClassVar[dict[str, Sequence[float]]] = {**ModelEKF.search_space, "slow_error": (0.3, 10.0)}

    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Recalibrate the model's constants, then as the base class."""
        factors = recalibrate(self.machine.reduced, train, self.config["calibration_minutes"])
        self.arrays = {"recalibrated": factors}
        super().fit(train, validation, seed)

    def simulator(self) -> Simulator:
        """The nominal model with its recalibrated constants."""
        return rescaled(self.machine.reduced, self.machine.recalibrated, self.arrays["recalibrated"])


def rescaled(simulator: Simulator, constants: Sequence[str], factors: Array) -> Simulator:
    """The simulator with each of its constants times its factor.

    Args:
        simulator: whose they are.
        constants: k names.
        factors: (k,) dimensionless, in their order.
    """
    theta = simulator.theta()
    values = {n: float(theta[simulator.index(n)] * f) for n, f in zip(constants, factors, strict=True)}
    return simulator.with_values(**values)


def recalibrate(simulator: Simulator, train: Batch, minutes: float) -> Array:
    """Factors (k,) on the machine's ``recalibrated`` constants by least squares of simulated against measured outputs.

    The training sequences' inputs are simulated open loop at their known health, for the first
    ``minutes`` of each, and compared at 1 Hz with the readings, in units of the sensors' noise.
    """
    assert train.truth is not None
    machine, constants = train.machine, train.machine.recalibrated
    if not constants:
        return np.empty(0)
    second = max(1, round(1.0 / machine.sample_period_s))
    samples = min(round(60.0 * minutes / machine.sample_period_s), train.measured.shape[1])
    filled, accepted, _ = FrontEnd.fit(train).run(train.measured[:, :samples])
    inputs, outputs = np.split(filled, [len(machine.inputs)], axis=-1)
    known = accepted[..., len(machine.inputs) :]
    varying = Varying(machine.health_names, train.truth.health[:, :samples])
    start = train.truth.states[:, 0, : len(simulator.states)]
    sd = np.array([v.scale for v in simulator.outputs])
    every = slice(2 * second, None, second)

    def residuals(log_factors: Array) -> Array:
        model = rescaled(simulator, constants, np.exp(log_factors))
        _, y = simulate(model, inputs, start, dt_s=machine.sample_period_s, substeps=1, varying=varying)
        return np.where(known[:, every], (y - outputs)[:, every] / sd, 0.0).ravel()

    fit = least_squares(residuals, np.zeros(len(constants)), diff_step=1e-3, max_nfev=4)
    return np.exp(fit.x)
