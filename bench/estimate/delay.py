"""Estimates as they are known a stated while later."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twinbench.bench.estimates import Estimates
from twinbench.bench.registry import discover, find
from twinbench.bench.report.words import names_of
from twinbench.bench.roster import ordered
from twinbench.common.errors import BadInput
from twinbench.data.batch import Batch
from twinbench.methods.estimator import Estimator


def check_delay(name: str, delay_s: float) -> None:
    """Refuse a delay that is none, or that an estimator has no use for.

    Args:
        name: the estimator's name, or path/to/file.py[:Class].
        delay_s: seconds.

    Raises:
        BadInput: one line.
    """
    if not (np.isfinite(delay_s) and delay_s >= 0.0):
        raise BadInput(f"--delay is {delay_s:g} s; give the seconds to wait, 0 or more")
    if delay_s > 0.0 and not find(name).delayed:
        able = ordered(other for other, kind in discover().items() if kind.delayed)
        raise BadInput(f"{name} does not say what it knows later; leave out --delay, or estimate with {names_of(able)}")


def known_later(estimator: Estimator, estimates: Estimates, batch: Batch, every: int, delay_s: float) -> Estimates:
    """The same with means and intervals as they are known ``delay_s`` later.

    Args:
        batch: the recordings, without truth.
        every: ticks from one estimate to the next.
        delay_s: seconds.
    """
    shape = estimates.mean.shape
    later = estimator.smooth(batch.measured, np.arange(0, batch.measured.shape[1], every), delay_s)
    mean, low, high = (part.reshape(shape).astype(np.float32) for part in (later.mean, later.low, later.high))
    return replace(estimates, mean=mean, low=low, high=high)
