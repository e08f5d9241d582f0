"""Interacting multiple models over how health moves, on the recalibrated nominal model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

from twinbench.baselines.modes_ekf import ModesEKF
from twinbench.baselines.nominal_ekf import NominalEKF
from twinbench.methods.estimator import register


@register
class NominalIMM(ModesEKF, NominalEKF):
    """What the same engineer would run who knows that wear comes in spells, and that sensors fail."""

    name = "nominal_imm"
    says = "interacting multiple models of wear and failing sensors with the recalibrated reduced-order model"
    implementations: ClassVar[tuple[str, ...]] = ("compiled",)
    settings: ClassVar[dict[str, Any]] = {
        **{name: value for name, value in NominalEKF.settings.items() if name != "implementation"},
        "health_walk": 2.68,
        "state_walk": 15.01,
        "slow_error": 0.8677,
        "still": 0.04017,
        "leap": 1.13,
    }
    search_space: ClassVar[dict[str, Sequence[float]]] = {**NominalEKF.search_space, **ModesEKF.search_space}
