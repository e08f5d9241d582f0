"""What a data sheet says of a channel's noise. A probe that lags is a state of the machine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Growth:
    """Noise that grows along a line with a channel's true value: ``at`` at ``reference``, ``rise`` more at twice that.

    Attributes:
        channel: an input.
        reference: in its unit.
        at: dimensionless factor there.
        rise: dimensionless.
    """

    channel: str
    reference: float
    at: float
    rise: float

    def factor(self, values: Array) -> Array:
        """The factor at values of the channel, of the same shape.

        Args:
            values: of any shape, in the channel's unit.
        """
        return self.at + self.rise * (values - self.reference) / self.reference


@dataclass(frozen=True)
class Noise:
    """Noise of one channel. A channel without white noise is a command, which is known exactly.

    Attributes:
        channel: its name.
        white: sd of what is independent from sample to sample, as a share of the reading or in the channel's unit.
        coloured: sd of an AR(1), likewise; outputs only.
        tau_s: time constant of that.
        relative: both are shares of the reading.
        grows: with what both grow.
    """

    channel: str
    white: float
    coloured: float = 0.0
    tau_s: float = 1.0
    relative: bool = False
    grows: Growth | None = None


@dataclass(frozen=True)
class Drift:
    """A slow AR(1) error that several channels share (common electronics), as a share of what each reads.

    Attributes:
        channels: inputs and outputs that have it.
        share: its sd, dimensionless.
        tau_s: its time constant.
    """

    channels: tuple[str, ...] = ()
    share: float = 0.0
    tau_s: float = 300.0


APART = Drift()
"""Sensors that err each by itself."""
