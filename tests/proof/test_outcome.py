"""What a verdict comes to, and what the gates make of many."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from twinbench.proof.concealed.findings import miss, stated, with_marks
from twinbench.proof.concealed.gates import as_markdown, gate_table
from twinbench.proof.concealed.judge import COLUMNS
from twinbench.proof.concealed.outcome import outcome
from twinbench.proof.concealed.power import outcomes, power, reliability, reliability_error

RUB, DRY, PULL = "coulomb_friction@w", "coulomb_friction_unequal@w", "offset@w"
"""The second has the first in its class, the third is something else."""


def truth(*effects: tuple[str, tuple[str, ...]], cell: str = "mechanism") -> dict:
    return {
        "cell": cell,
        "effects": [{"name": n, "class": list(same), "ports": ["balance:w", "flux:f"]} for n, same in effects],
    }


ONE = truth((RUB, (RUB, DRY)))
TWO = truth((RUB, (RUB, DRY)), (PULL, (PULL,)), cell="two_effects")


@pytest.mark.parametrize(
    ("case", "claims", "ports", "comes_to"),
    [
        (ONE, [[RUB]], [], "name"),
        (ONE, [[DRY]], [], "class"),
        (ONE, [[RUB, DRY]], [], "class"),
        (ONE, [[RUB, DRY, "x"]], [], "set"),
        (ONE, [[DRY, "x"]], [], "set"),
        (ONE, [[RUB, "x", "y", "z"]], [["balance:w"]], "located"),
        (ONE, [[RUB, "x", "y", "z"]], [["balance:i"]], "abstained"),
        (ONE, [["x"]], [], "wrong"),
        (ONE, [["x", "y"]], [], "wrong"),
        (ONE, [[RUB], ["x"]], [], "wrong"),
        (ONE, [[RUB], ["x", "y"]], [], "wrong"),
        (ONE, [[]], [["flux:f"]], "located"),
        (ONE, [[]], [["balance:i"]], "abstained"),
        (ONE, [], [], "abstained"),
        (ONE, [[RUB], []], [], "name"),
        (TWO, [[RUB], [PULL]], [], "name"),
        (TWO, [[DRY], [PULL]], [], "class"),
        (TWO, [[DRY, "x"], [PULL]], [], "set"),
        (TWO, [[RUB]], [["balance:w"]], "located"),
        (TWO, [[RUB], ["x"]], [], "wrong"),
        (truth(cell="clean"), [], [], "abstained"),
        (truth(cell="clean"), [[]], [["balance:w"]], "abstained"),
        (truth(cell="clean"), [["x"]], [], "false"),
        (truth(cell="poor_excitation"), [["x", "y"]], [], "false"),
        (truth(("odd", ()), cell="foreign"), [["x"]], [], "wrong"),
        (truth((RUB, (RUB, DRY)), cell="left_out"), [["x", "y"]], [], "wrong"),
        (truth((RUB, (RUB, DRY)), cell="left_out"), [[]], [["balance:w"]], "located"),
        (truth((RUB, (RUB, DRY)), cell="left_out"), [], [], "abstained"),
    ],
)
def test_a_verdict_comes_to_one_word(case: dict, claims: list, ports: list, comes_to: str) -> None:
    assert outcome(case, claims, ports) == comes_to


def row(**values: object) -> dict:
    usual = dict.fromkeys(COLUMNS, np.nan) | dict.fromkeys(("named", "set", "probability", "ports", "inexact"), "")
    usual |= {"verdict": "missing physics", "engine": "ours", "machine": "motor", "kind": "tuned", "cell": "mechanism"}
    usual |= {"truth": RUB, "class": f"{RUB}|{DRY}", "port_truth": "balance:w", "detectable": True, "D0_sq": 100.0}
    return usual | {"outcome": "abstained", "ideal_name": 0.9, "ideal_class": 0.95} | values


ROWS = pd.DataFrame(
    [
        row(case="0", named=RUB, outcome="name", probability="0.97", ports="balance:w"),
        row(case="1", named=DRY, outcome="class", probability="0.96"),
        row(case="2", named="x", outcome="wrong", probability="0.98"),
        row(case="3", set=f"{RUB}|y", outcome="set", probability="0.6"),
        row(case="4", named="x", outcome="wrong", detectable=False),
        row(case="5", kind="random", outcome="located", ports="balance:w"),
        row(case="6", cell="clean", truth="", port_truth="", detectable=False, D0_sq=np.nan, parameters_covered=0.8),
        row(case="7", cell="clean", truth="", port_truth="", detectable=False, named="x", outcome="false"),
        row(case="8", cell="foreign", outcome="located", ports="balance:i+balance:w", **{"class": ""}),
        row(case="9", cell="left_out", named="x", outcome="wrong", ports="balance:i"),
        row(case="10", cell="sensor", outcome="located", ports="output:w|balance:w"),
        row(case="11", cell="sensor", named=RUB, outcome="name", ports="balance:w", size_covered=1.0),
        row(case="12", cell="two_effects", outcome="class", gain=0.97, parameters_covered=1.0),
        row(
            case="13",
            cell="onset",
            outcome="abstained",
            onset_error_s=4.0,
            verdict="consistent",
            decoys_named=0.1,
            seconds=6.0,
        ),
    ]
)


def test_gates_count_what_they_say() -> None:
    gates = gate_table(ROWS).set_index("gate")

    def at(name: str) -> tuple:
        g = gates.loc[name]
        return pytest.approx(g["measured"]), g["cases"], g["met"]

    assert at("single effect: right name or class, all machines") == (2 / 6, 6, None)
    assert at("single effect: right name or class, tuned machines") == (2 / 5, 5, False)
    assert at("single effect: right name alone, tuned machines") == (1 / 5, 5, False)
    assert at("single effect: right name or class, random machines") == (0.0, 1, False)
    assert at("single effect: right name, class or a set of at most three") == (3 / 6, 6, None)
    assert at("sound machine: false name") == (0.5, 2, False)
    assert at("sound machine: false name or set") == (0.5, 2, True)  # one case
    assert at("confidently wrong, of all verdicts") == (4 / 14, 14, False)
    assert at("effects that are certainly not there, named") == (0.1, 1, False)
    assert at("detectable effect or fault: called consistent or a parameter change") == (1 / 11, 11, None)
    assert at("single names that are wrong, of all that are said") == (4 / 7, 7, None)
    assert at("both of two effects, by class") == (1.0, 1, True)
    assert at("not in the catalogue: no wrong name") == (0.5, 2, False)
    assert at("not in the catalogue: located within two ports") == (0.5, 2, False)
    assert at("sensor or input fault, by class") == (0.5, 2, False)
    assert at("sensor or input fault called physics") == (0.5, 2, False)
    assert at("sets that hold an effect of the case") == (1.0, 1, True)
    assert at("90 % intervals of parameters cover, sound machines") == (0.8, 1, False)
    assert at("90 % intervals of parameters cover, beside an effect") == (1.0, 1, False)
    assert at("held-out gain of named effects, median") == (0.97, 1, True)
    assert at("onset error, median, s") == (4.0, 1, True)
    assert at("seconds of one core that a case takes, median") == (6.0, 1, False)
    assert gates.loc["single effect: right name or class, tuned machines", "ideal"] == pytest.approx(0.95)
    said = as_markdown(gates.reset_index())
    assert (
        "| single effect: right name alone, tuned machines | >= 0.85 | 0.2 | 0.0362 to 0.624 | 0.9 | 5 | **no** |"
        in said
    )


def test_what_probabilities_are_worth_is_counted_name_by_name() -> None:
    claims = stated(ROWS)
    assert claims["single"].sum() == 7
    assert len(claims) == 8
    bins = reliability(claims)
    assert bins[["low", "high", "cases"]].to_numpy().tolist() == [[0.95, 0.99, 3.0]]
    assert bins["right"].tolist() == [pytest.approx(2 / 3)]
    assert reliability_error(bins) == pytest.approx(0.97 - 2 / 3)
    assert np.isnan(reliability_error(bins[:0]))


def test_power_is_told_by_distance_beside_the_ideal_observers() -> None:
    table = power(ROWS)
    pooled = table[(table["machine"] == "all") & (table["kind"] == "tuned")]
    assert pooled[["low", "high", "cases"]].to_numpy().tolist() == [[10.0, 17.0, 8.0]]
    assert pooled["right"].tolist() == [pytest.approx(3 / 8)]
    assert pooled["ideal"].tolist() == [pytest.approx(0.95)]
    assert (table.loc[table["machine"] == "motor", "truth"] == RUB).all()


def test_outcomes_are_counted_by_machine_and_cell() -> None:
    table = outcomes(ROWS).set_index(["machine", "cell"])
    assert table.loc[("motor", "mechanism"), ["name", "class", "set", "wrong", "located", "cases"]].tolist() == [
        1, 1, 1, 2, 1, 6,
    ]  # fmt: skip
    assert table.loc[("motor", "clean"), "false"] == 1


def test_every_miss_is_called_by_its_worst() -> None:
    said = [miss(r) for _, r in with_marks(ROWS).iterrows()]
    assert said == [
        "", "", "wrong name", "set only", "wrong name", "not named", "", "false name", "", "wrong name",
        "sensor called physics", "", "", "not named",
    ]  # fmt: skip
