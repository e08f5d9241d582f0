"""Estimates of the test recordings, with the factors that make their intervals fit the validation recordings."""

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
"""Of the validation recordings: one tick a second says as much as all of them, and nothing is forecast."""


def run(estimator: Estimator, test: Batch, validation: Batch, evaluation: Evaluation, seed: int) -> Estimates:
    """Estimates of ``test``, which comes without its truth, and factors from ``validation``, which has it.

    The settings of an estimator were chosen on the validation recordings, too, by errors and by coverage: its
    intervals may fit them a little better than new ones.
    """
    estimates = evaluate(estimator, test, evaluation, seed)
    known = evaluate(estimator, validation.without_truth(), EVALUATION, seed)
    return replace(estimates, factors=factors(known, validation))
