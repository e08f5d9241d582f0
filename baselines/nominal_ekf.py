"""Extended Kalman filter with the recalibrated nominal reduced-order model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from scipy.optimize import least_squares

from twinbench.baselines.model_ekf import ModelEKF
from twinbench.data.batch import HEALTH, OUTPUTS, Array, Batch
from twinbench.methods.estimator import register
from twinbench.methods.frontend import FrontEnd
from twinbench.physics.integrate import Varying, simulate
from twinbench.physics.nominal import NOMINAL, RECALIBRATED
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
        factors = recalibrate(NOMINAL, train, self.config["calibration_minutes"])
        self.arrays = {"recalibrated": factors}
        super().fit(train, validation, seed)

    def machine(self) -> Simulator:
        """The nominal model with its recalibrated constants."""
        return rescaled(NOMINAL, self.arrays["recalibrated"])


def rescaled(simulator: Simulator, factors: Array) -> Simulator:
    """The simulator with each constant of RECALIBRATED times its factor.

    Args:
        factors: (4,) dimensionless, order RECALIBRATED.
    """
    theta = simulator.theta()
    values = {n: float(theta[simulator.index(n)] * f) for n, f in zip(RECALIBRATED, factors, strict=True)}
    return simulator.with_values(**values)


def recalibrate(simulator: Simulator, train: Batch, minutes: float) -> Array:
    """Factors (4,) on RECALIBRATED by least squares of simulated against measured outputs.

    The training sequences' inputs are simulated open loop at their known health, for the first
    ``minutes`` of each, and compared at 1 Hz with the readings, in units of the sensors' noise.
    """
    assert train.truth is not None
    samples = min(int(minutes * 1200), train.measured.shape[1])
    filled, accepted, _ = FrontEnd.fit(train).run(train.measured[:, :samples])
    inputs, health = filled[..., :4], train.truth.health[:, :samples]
    start = train.truth.states[:, 0, : len(simulator.states)]
    sd = np.array([v.scale for v in simulator.outputs])
    every = slice(40, None, 20)

    def residuals(log_factors: Array) -> Array:
        machine = rescaled(simulator, np.exp(log_factors))
        _, y = simulate(machine, inputs, start, substeps=1, varying=Varying(HEALTH, health))
        gap = (y - filled[..., 4:])[:, every] / sd
        return np.where(accepted[:, every, 4:], gap, 0.0).reshape(-1, len(OUTPUTS)).ravel()

    fit = least_squares(residuals, np.zeros(len(RECALIBRATED)), diff_step=1e-3, max_nfev=4)
    return np.exp(fit.x)
