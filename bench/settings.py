"""Are a profile's settings for estimators ones that they have?"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Any

from twinbench.bench.profile import KINDS, Profile, fits
from twinbench.bench.registry import discover
from twinbench.common.errors import BadInput
from twinbench.methods.estimator import Estimator


def check_settings(kinds: Collection[type[Estimator]], profile: Profile) -> None:
    """Refuse what a profile sets for these estimators, or for none that there is.

    Raises:
        BadInput: an unknown estimator or setting, or a value of another kind.
    """
    for kind in kinds:
        _check_own(kind, profile)
    unplanned = set(profile.settings) - {kind.name for kind in kinds}
    if unplanned and (unknown := sorted(unplanned - set(discover()))):
        raise BadInput(f"profile {profile.name!r} has settings for {unknown[0]!r}, which is no estimator; remove them")


def _check_own(kind: type[Estimator], profile: Profile) -> None:
    own = profile.settings.get(kind.name, {})
    where = f"profile {profile.name!r}, [settings.{kind.name}]"
    try:
        kind(**own)
    except ValueError as error:
        raise BadInput(f"{where}: {error}") from error
    for key, value in own.items():
        expected = type(kind.settings[key])
        if expected in KINDS and not fits(value, expected):
            raise BadInput(f"{where}: {key} is {value!r}, must be {KINDS[expected]}")


def search_space(kind: type[Estimator], name: str, start: Any) -> Sequence[Any]:
    """The range, or the list of choices, in which a setting is searched from its value in the profile.

    Raises:
        BadInput: no such range, or the search would start outside.
    """
    space = kind.search_space[name]
    where = f"{kind.name}: the search space of {name}"
    if isinstance(space, list):
        if start not in space:
            raise BadInput(f"{where} is {space}, and the profile's {start!r} is none of it; change one of them")
        return space
    try:
        low, high = (float(side) for side in space)
    except (TypeError, ValueError) as error:
        raise BadInput(f"{where} is {space!r}, must be (low, high) or a list of choices") from error
    if not 0.0 < low < high < math.inf:  # it is searched by factors
        raise BadInput(f"{where} is {space!r}, must be (low, high) with 0 < low < high")
    if not isinstance(start, int | float) or not low <= start <= high:
        raise BadInput(f"{where} is {low:g} to {high:g}, and the profile's {start!r} is outside; change one of them")
    return space
