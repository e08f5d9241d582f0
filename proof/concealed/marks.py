"""What a row of ``cases.csv`` got right and wrong."""

from __future__ import annotations

from typing import NamedTuple

import pandas as pd

DETECTABLE = 0.3
REACHED_SHARE = 0.9
"""A severity counts as reached from this share of it on."""
SOUND = ("clean", "parameters", "poor_excitation")
WITH_NAME = ("mechanism", "onset")
UNKNOWN = ("left_out", "foreign")
LARGEST_SET = 3


class Marks(NamedTuple):
    """Marks of one case; ``None`` where the case does not ask."""

    named_right: bool | None  # single effect that can be detected: its name, alone
    set_right: bool | None  # ... its name alone, or inside a set of at most three
    pair_right: bool | None  # both of two effects by name
    false_name: bool | None  # something named on a sound machine, or where nothing can be told
    physics_for_sensor: bool | None
    fault_right: bool | None  # sensor or input fault by name
    confidently_wrong: bool  # a single name that is wrong
    abstained_right: bool | None  # truth not in the catalogue: no single name, or a right set
    located: bool | None


def marks(row: pd.Series) -> Marks:
    """Mark one row."""
    cell = row["cell"]
    truth = [set(effect.split("|")) for effect in _parts(row["truth"], "+")]
    named = set(_parts(row["named"], "+"))
    sets = [set(s.split("|")) for s in _parts(row["set"], "+")]
    small = [s for s in sets if len(s) <= LARGEST_SET]
    right = set().union(*truth)
    alike = set(str(row["alike"]).replace("+", "|").split("|")) - {""}
    wrong = named - right
    answers = right | alike
    detectable = float(row["severity"]) >= REACHED_SHARE * DETECTABLE
    alone = all(effect & named for effect in truth) and not wrong
    inside = all(effect & named or any(effect & s for s in small) for effect in truth) and not wrong
    single = detectable and cell in WITH_NAME
    # Who says that nothing explains it calls it nothing.
    called = [] if row["verdict"] == "unexplained" else _parts(row["ports_named"], "+")
    physics = [p for p in called if p.startswith(("balance:", "flux:"))]
    ports = [set(p.split("|")) for p in _parts(row["port_truth"], "+")]
    pointed = set(row["ports_named"].replace("+", "|").split("|"))
    return Marks(
        named_right=alone if single else None,
        set_right=inside if single or (detectable and cell == "confusable") else None,
        pair_right=alone if detectable and cell == "two_effects" else None,
        false_name=bool(named or sets) if cell in SOUND else None,
        physics_for_sensor=bool(physics) and not right & named if cell == "sensor" else None,
        fault_right=alone if detectable and cell == "sensor" else None,
        confidently_wrong=bool(wrong) or (cell in SOUND and bool(named)),
        abstained_right=(not wrong and (not sets or any(answers & s for s in sets))) if cell in UNKNOWN else None,
        located=all(p & pointed for p in ports) if detectable and cell not in (*SOUND, "sensor") else None,
    )


def miss(row: pd.Series) -> str:
    """What went wrong in a case, in a word or two; empty if nothing."""
    m = marks(row)
    if row["verdict"] == "failed":
        return "engine failed"
    for wrong, says in (
        (m.false_name, "false name"),
        (m.physics_for_sensor, "sensor called physics"),
        (m.confidently_wrong, "wrong name"),
        (m.abstained_right is False, "wrong set"),
        (m.pair_right is False, "not both of two"),
        (m.fault_right is False, "sensor fault not named"),
        (m.set_right is False, "not named"),
        (m.named_right is False, "set only"),
        (m.located is False, "located elsewhere"),
    ):
        if wrong:
            return says
    return ""


def _parts(text: str, by: str) -> list[str]:
    return [part for part in str(text).split(by) if part]
