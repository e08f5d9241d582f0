"""One machine's twin in place: every buffer is made once, and an update is one call of compiled code."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twinbench.methods.deeponet_kalman.cycle import said_type, scratch, update
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.estimator import Info, State


class Online:
    """A trained DeepONet-Kalman on one machine, from the first sample on.

    Attributes:
        state: what ``DeepONetKalman.step`` returns, leading axis 1. It is a view, which every update fills anew: copy
            what is to be kept.
        info: the same, of what is diagnostic.
    """

    def __init__(self, twin: DeepONetKalman) -> None:
        memory = twin.init(1).memory[0].copy()
        said = np.zeros(1, said_type(twin.parts))
        channels = twin.parts.channels
        self._measured, self._lag_s = np.empty((1, channels)), np.zeros((1, channels))
        self._arguments = (
            twin.weights,
            twin.twin,
            memory,
            self._measured,
            self._lag_s,
            said,
            scratch(twin.weights, twin.parts),
        )
        self.state = State(said["mean"], said["cov"], said["low"], said["high"], (memory,))
        accepted = said["accepted"].view(np.bool_)
        self.info = Info(said["innovation"], said["S"], said["nis"], accepted, said["flags"], said["age_s"])

    def update(self, measured: ArrayLike, lag_s: ArrayLike = 0.0) -> None:
        """Take in readings (C,), inputs first, NaN where missing, and how long ago each was read.

        Args:
            measured: (C,) readings in the channels' units, inputs first; NaN means missing.
            lag_s: (C,) seconds, how long ago each was read, or one number for all.
        """
        self._measured[0] = measured
        self._lag_s[0] = lag_s
        update(*self._arguments)

    @property
    def nbytes(self) -> int:
        """Weights, settings and buffers together."""
        return sum(array.nbytes for array in self._arguments)
