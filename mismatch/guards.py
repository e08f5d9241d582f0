"""What keeps the engine from naming what is not there; each can be left out to see what it is for."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Guards:
    """Which guards are in force; all of them unless an ablation says otherwise.

    Attributes:
        projection: what parameters, start states and drifts can imitate counts for no candidate. Without it a
            parameter that is off is taken for missing physics.
        whitening: the colour of the sensors' noise is learnt. Without it slow noise is taken for missing physics.
        held_out_gate: an explanation must also predict recordings that it has not learnt from. Without it one that
            merely fits is named.
        pairs: two effects are tried at once, and two for one. Without it a single impostor stands for two effects
            that each look poor alone.
        nominal_null: an effect must gain more than any candidate does on recordings that lack nothing. Without it
            the best of many candidates is named by chance.
    """

    projection: bool = True
    whitening: bool = True
    held_out_gate: bool = True
    pairs: bool = True
    nominal_null: bool = True
