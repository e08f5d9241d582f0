"""Estimates of the test recordings, with the factors that make their intervals fit the calibration recordings."""

from __future__ import annotations

import math
from dataclasses import replace

from twinbench.bench.estimates import Estimates
from twinbench.bench.evaluate import run as evaluate
from twinbench.bench.profile import Evaluation
from twinbench.bench.statistics.conformal import factors
from twinbench.data.batch import Batch
from twinbench.methods.estimator import Estimator

EVALUATION = Evaluation(stride=20, origin_every_s=math.inf)
"""Of the calibration recordings: one tick a second says as much as all of them, and nothing is forecast."""


def run(estimator: Estimator, test: Batch, calibration: Batch, evaluation: Evaluation, seed: int) -> Estimates:
    """Estimates of ``test``, which comes without its truth, and factors from ``calibration``, which has it.

    Nothing else looks at the calibration recordings: settings were chosen on others, which intervals may fit a little
    better than new ones.
    """
    estimates = evaluate(estimator, test, evaluation, seed)
    known = evaluate(estimator, calibration.without_truth(), EVALUATION, seed)
    return replace(estimates, factors=factors(known, calibration))
