"""How good a model is where it counts: in the nominal EKF's machinery, on held-out recordings, against the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from twinbench.baselines.model_ekf import ModelEKF
from twinbench.baselines.nominal_ekf import recalibrate, rescaled
from twinbench.bench.evaluate import run
from twinbench.bench.profile import Evaluation
from twinbench.bench.statistics.scores import score
from twinbench.data.batch import Array, Batch
from twinbench.physics.compile import compiled
from twinbench.physics.nominal import NOMINAL, RECALIBRATED
from twinbench.physics.simulator import Simulator
from twinbench.physics.steady import DESIGN_POINT, steady_state, valve_for

EVALUATION = Evaluation(stride=20, origin_every_s=30.0, leads_s=(60.0,))
METRICS = {
    "parameter": "parameter_error_pct",
    "p": "p_open60_pct",
    "T": "T_open60_pct",
    "m": "m_open60_pct",
}
"""Columns of the results and the benchmark's metrics that they are; ``open60`` is the sum of the last three."""
CALIBRATION_MIN = 15.0


class TwinEKF(ModelEKF):
    """The benchmark's filter with a given model."""

    name = "twin"

    def __init__(self, simulator: Simulator) -> None:
        super().__init__()
        self._given = simulator

    def simulator(self) -> Simulator:
        """The model it was given."""
        return self._given


@dataclass(frozen=True)
class Errors:
    """Means over the held-out recordings, per cent: of the health parameters, and of the 60 s forecast of p, T, m."""

    parameter: float
    p: float
    T: float
    m: float

    @property
    def open60(self) -> float:
        """The forecast's errors of p, T and m together."""
        return self.p + self.T + self.m


def errors(simulator: Simulator, train: Batch, held_out: Batch) -> Errors:
    """Filter the held-out recordings with a model and score the estimates; NaN if the filter diverges."""
    ekf = TwinEKF(simulator)
    ekf.fit(train, train, 0)
    try:
        estimates = run(ekf, held_out.without_truth(), EVALUATION, 0)
    except FloatingPointError:
        return Errors(np.nan, np.nan, np.nan, np.nan)
    scores = score(estimates, held_out, since_s=0.0).groupby("metric")["value"].mean()
    return Errors(**{name: float(scores[metric]) for name, metric in METRICS.items()})


def at_design_point(plant: Simulator) -> Simulator:
    """The nominal model, exact where the healthy plant runs at its design point."""
    N_rpm, ratio = DESIGN_POINT
    u = np.array([0.95, 298.0, N_rpm, float(valve_for(np.array(N_rpm), np.array(ratio)))])
    sd = np.array([v.scale for v in plant.outputs])

    def factors(log: Array) -> Array:
        return np.exp([log[0], log[1], 0.0, log[2]])  # one point says nothing about the heat to the wall

    def gap(log: Array) -> Array:
        return (_readings(rescaled(NOMINAL, RECALIBRATED, factors(log)), u) - _readings(plant, u)) / sd

    return rescaled(NOMINAL, RECALIBRATED, factors(least_squares(gap, np.zeros(3), diff_step=1e-4).x))


def at_known_health(train: Batch) -> Simulator:
    """The nominal model calibrated to the training recordings with their true health, as the benchmark's row is."""
    return rescaled(NOMINAL, RECALIBRATED, recalibrate(NOMINAL, train, CALIBRATION_MIN))


def _readings(simulator: Simulator, u: Array) -> Array:
    return compiled(simulator).output(steady_state(simulator, u), u, simulator.theta())
