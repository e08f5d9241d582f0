"""What the augmented filter knows: the entries of z, its model as a record, and the room that a tick takes.

z = [five states, probe temperature, five health coordinates zeta, three coloured-noise states,
five slow errors of the operator].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinbench.data.batch import STATE, Array
from twinbench.methods.deeponet_kalman.layout import scratch_type
from twinbench.methods.deeponet_kalman.records import record
from twinbench.methods.deeponet_kalman.safeguards import N_HEALTH, N_MOVED, N_OUTPUTS, SAFETY, Envelope, Settings
from twinbench.methods.operator import N_STATES
from twinbench.methods.weighing import N_CAUSES

PROBE = N_STATES
ZETA = PROBE + 1
NOISE = ZETA + N_HEALTH
ERROR = NOISE + N_OUTPUTS
SIZE = ERROR + N_STATES
"""Where the parts of z begin, and how many entries it has."""
GAS, FLOW, BIAS = STATE.T_gas_K, STATE.flow_memory, NOISE - 1


class Model(NamedTuple):
    """What the filter needs besides the operator's weights; ``MODEL`` is the same as a record.

    Attributes:
        state_mean: (5,) means of the training states in their units, order STATES.
        state_scale: (5,) their spreads in the same units.
        increment: (5,) spread of the states' change in a tick, in the same units.
        Q: (19, 19) process noise of one tick, in the units of z squared.
        noise_keep: (3,) dimensionless AR(1) factors of the coloured sensor noise.
        error_keep: AR(1) factor of the operator's slow errors.
        zeta_low: (5,) dimensionless lower bounds of the coordinates, far outside a machine's life.
        zeta_high: (5,) dimensionless upper bounds.
        settings: of the safeguards.
        envelope: where the operator was trained.
        prior_sd: (5,) dimensionless sd of health's coordinates before the first reading.
    """

    state_mean: Array
    state_scale: Array
    increment: Array
    Q: Array
    noise_keep: Array
    error_keep: float
    zeta_low: Array
    zeta_high: Array
    settings: Settings
    envelope: Envelope
    prior_sd: Array


MODEL = record({
    "state_mean": ("f8", (N_STATES,)), "state_scale": ("f8", (N_STATES,)), "increment": ("f8", (N_STATES,)),
    "Q": ("f8", (SIZE, SIZE)), "noise_keep": ("f8", (N_OUTPUTS,)), "error_keep": ("f8", ()),
    "zeta_low": ("f8", (N_HEALTH,)), "zeta_high": ("f8", (N_HEALTH,)),
    "settings": (record(dict.fromkeys(Settings._fields, ("f8", ()))), ()),
    "envelope": (record(dict.fromkeys(Envelope._fields, ("f8", (N_HEALTH,)))), ()),
    "prior_sd": ("f8", (N_HEALTH,)),
})  # fmt: skip

RIVALS = record({
    "left": ("i8", ()), "score": ("f8", (N_CAUSES,)),
    "z": ("f8", (N_CAUSES, SIZE)), "P": ("f8", (N_CAUSES, SIZE, SIZE)), "safety": (SAFETY, (N_CAUSES,)),
})  # fmt: skip
"""Copies of the filter, one for each cause that is weighed: ticks left, log scores, and what a filter carries."""


def room_type(weights: np.ndarray) -> np.dtype[np.void]:
    """Room for what one tick reckons in between.

    Args:
        weights: (1,) of ``layout.pack``, a record of dimensionless weights.
    """
    square, wide, narrow = (SIZE, SIZE), (N_OUTPUTS, SIZE), (N_OUTPUTS, N_OUTPUTS)
    return record(
        {
            "operator": (scratch_type(weights), ()),
            "F": ("f8", square),
            "M": ("f8", square),
            "H": ("f8", wide),
            "HP": ("f8", wide),
            "X": ("f8", wide),
            "K": ("f8", (SIZE, N_OUTPUTS)),
            "R": ("f8", narrow),
            "S": ("f8", narrow),
            "L": ("f8", narrow),
            **dict.fromkeys(("innovation", "used", "r", "now", "read", "whitened"), ("f8", (N_OUTPUTS,))),
            **dict.fromkeys(("accuracy", "surprise"), ("f8", (N_OUTPUTS,))),
            "probability": ("f8", (N_CAUSES,)),
            "column": ("f8", (SIZE,)),
            "rows": ("f8", (N_HEALTH, N_OUTPUTS)),
            "push": ("f8", (N_HEALTH,)),
            "variance": ("f8", (N_HEALTH,)),
            "after": ("f8", (N_MOVED, N_HEALTH)),
            "complex": ("c16", (N_HEALTH, 2 * N_HEALTH)),
        }
    )
