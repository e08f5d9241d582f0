"""Whatever is wrong with a machine's record is refused in one line that says what, where, and how to mend it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twinbench.machines.check import check_machine
from twinbench.machines.load import BUILTIN, load_machine
from twinbench.machines.machine import Machine
from twinbench.machines.parts import Health, Lag, Reading
from twinbench.machines.sensors import Drift, Growth, Noise
from twinbench.machines.two_tanks import TWO_TANKS
from twinbench.physics.simulator import Simulator

EXAMPLES = Path(__file__).parents[2] / "examples"
PLANT, REDUCED, HEALTH = TWO_TANKS.plant, TWO_TANKS.reduced, TWO_TANKS.health
RHS = PLANT.rhs
H1, H2 = TWO_TANKS.readings
PUMP_V, VALVE, N1, N2 = TWO_TANKS.noise
MENDS = ("give", "leave", "put", "mend", "choose", "did you mean", "keep", "must", "draw", "let", "name", "set")
MENDS += ("need", "widen", "say")


def health(**changes: object) -> dict[str, object]:
    """The first health parameter changed."""
    return {"health": (replace(HEALTH[0], **changes), *HEALTH[1:])}  # type: ignore[arg-type]


def both(old: str, **changes: object) -> dict[str, Simulator]:
    """Both simulators with a variable of theirs changed."""
    found = {}
    for part, simulator in (("plant", PLANT), ("reduced", REDUCED)):
        groups = {
            kind: tuple(replace(v, **changes) if v.name == old else v for v in getattr(simulator, kind))  # type: ignore[arg-type]
            for kind in ("states", "inputs", "outputs", "parameters")
        }
        found[part] = replace(simulator, **groups)
    return found


def constant(*values: float):
    """Loads that never move."""
    return lambda seconds, lean, rng: lambda time_s: np.tile(values, (len(time_s), 1))


def moody(seconds, lean, rng):
    return lambda time_s: np.random.default_rng().uniform(1.0, 1.1, (len(time_s), 2))


def failing(seconds, lean, rng):
    return lean[7]


def rhs_without_lag(x, u, theta):
    return RHS(x, u, theta) * np.array([1.0, 1.0, 0.5])


def broken_above(x, u, theta):
    return RHS(x, u, theta) + 0.0 * np.sqrt(25.0 - x[0])


def rhs_that_drifts(x, u, theta):
    return np.array([RHS(x, u, theta)[0], 1e-3, RHS(x, u, theta)[2]])


def restless(x, u, theta):
    return RHS(x, u, theta) + np.array([0.0, 5.0, 0.0])


def other_output(x, u, theta):
    return np.array([x[0] + 0.3, x[1] + theta[4]])


LAG = TWO_TANKS.lags[0]
REFUSED: dict[str, tuple[dict[str, object], str]] = {
    "name": ({"name": "my machine"}, "its name becomes part of file names"),
    "no simulator": ({"reduced": None}, "reduced is no Simulator"),
    "one name": ({"estimated": "h1_cm"}, "a tuple of one is written (x,)"),
    "records": ({"health": ("pump",)}, "health must be a tuple of Health records"),
    "loads are no function": ({"loads": 3}, "loads is int; give a function"),
    "start is no function": ({"start": 3}, "start is int; give a function"),
    "leans": ({"leans": -1}, "leans is -1"),
    "no drift": ({"drift": None}, "drift must be a Drift"),
    "period": ({"sample_period_s": 0.0}, "sample_period_s is 0.0; give seconds above zero"),
    "endless period": ({"sample_period_s": float("nan")}, "sample_period_s is nan"),
    "states differ": (
        {"reduced": replace(REDUCED, states=(REDUCED.states[1], REDUCED.states[0], REDUCED.states[2]))},
        "states differ: number 1 is 'h1_cm'",
    ),
    "units differ": (
        {"reduced": both("pump_V", unit="kV")["reduced"]},
        "inputs differ: number 1 is 'pump_V' in 'V' of the plant and 'pump_V' in 'kV'",
    ),
    "fewer parameters": ({"reduced": replace(REDUCED, parameters=REDUCED.parameters[:-1])}, "reduced model"),
    "unknown estimated": ({"estimated": ("h3_cm",)}, "estimated names 'h3_cm', which is no state; did you mean"),
    "nothing estimated": ({"estimated": ()}, "estimated is empty"),
    "not the first": ({"estimated": ("h2_cm", "h1_cm")}, "put the estimated states first in both simulators"),
    "state and output": (both("level1_cm", name="h1_cm"), "'h1_cm' is a state and an output"),
    "a name with a space": (both("pump_V", name="pump V"), "the name 'pump V' cannot be a column's"),
    "no health": ({"health": ()}, "health is empty"),
    "health twice": ({"health": (*HEALTH, HEALTH[0])}, "health names 'pump' twice"),
    "unknown health": (health(name="pumps"), "health names 'pumps', which is no parameter; did you mean 'pump'?"),
    "start outside": (health(start=(1.0, 0.1)), "its start goes from 1 to 0.1, outside the parameter's bounds 0.4 to"),
    "start of no size": (health(start=(1.0, 1.0)), "its start is of no size"),
    "start is no pair": (health(start=1.0), "start is 1.0; give two numbers"),
    "life outside": (health(life=(1.5, 0.8)), "its life goes from 1.5 to 0.8, outside"),
    "life of no size": (health(life=(0.8, 0.8)), "its life is of no size"),
    "exponential bias": (
        {"health": (*HEALTH[:4], replace(HEALTH[4], exponential=True))},
        "health 'bias2_cm' is exponential, and the parameter may be -8",
    ),
    "endless parameter": (both("pump", high=np.inf), "has no end on one side (0.4 to inf)"),
    "healthy on a bound": (both("pump", high=1.0), "healthy is 1, on a bound"),
    "farthest too near": (health(farthest=0.95), "beyond what filters let it be"),
    "walk": (health(walk=-1.0), "walk is -1.0"),
    "counterfactual": (health(counterfactual=(1.0, 0.9)), "counterfactual goes from 1 to 0.9"),
    "a reading too few": ({"readings": (H1,)}, "readings are of level1_cm; give one for each of the outputs, in order"),
    "readings in another order": ({"readings": (H2, H1)}, "in order: level1_cm, level2_cm"),
    "reading of nothing": (
        {"readings": (replace(H1, state="h3_cm"), H2)},
        "reading 'level1_cm' is of 'h3_cm', which is neither an estimated state nor a lag",
    ),
    "unknown bias": ({"readings": (H1, replace(H2, bias="bias_cm"))}, "has the bias 'bias_cm', which is no health"),
    "another gain": (
        {"readings": (replace(H1, gain=2.0), H2)},
        "reading 'level1_cm' should be 2 h1_cm = 40, and the reduced model's output gives 20",
    ),
    "no gain": ({"readings": (replace(H1, gain=0.0), H2)}, "its gain is 0.0"),
    "another output": ({"reduced": replace(REDUCED, output=other_output)}, "the reduced model's output gives 20.3"),
    "bias left out": ({"readings": (H1, replace(H2, bias=""))}, "reading 'level2_cm' should be 1 h2_cm ="),
    "key twice": ({"readings": (H1, replace(H2, key="h1"))}, "two readings have the key 'h1'"),
    "odd key": ({"readings": (replace(H1, key="h 1"), H2)}, "the key 'h 1' names scores"),
    "a noise too few": ({"noise": (PUMP_V, VALVE, N1)}, "noise are of pump_V, valve, level1_cm; give one for each"),
    "noise in another order": ({"noise": (VALVE, PUMP_V, N1, N2)}, "in order: pump_V, valve, level1_cm, level2_cm"),
    "negative noise": ({"noise": (PUMP_V, VALVE, replace(N1, white=-1.0), N2)}, "white is -1.0"),
    "an exact sensor": ({"noise": (PUMP_V, VALVE, replace(N1, white=0.0), N2)}, "no sensor is exact"),
    "coloured input": ({"noise": (replace(PUMP_V, coloured=0.1), VALVE, N1, N2)}, "coloured is of outputs only"),
    "tau": ({"noise": (PUMP_V, VALVE, replace(N1, tau_s=0.0), N2)}, "tau_s is 0.0"),
    "grows with nothing": (
        {"noise": (PUMP_V, VALVE, replace(N1, grows=Growth("pump", 1.0, 1.0, 1.0)), N2)},
        "grows with 'pump', which is no input; did you mean 'pump_V'?",
    ),
    "grows from zero": (
        {"noise": (PUMP_V, VALVE, replace(N1, grows=Growth("pump_V", 0.0, 1.0, 1.0)), N2)},
        "its growth refers to 0",
    ),
    "drift of nothing": ({"drift": Drift(("level3_cm",), 0.01)}, "drift names 'level3_cm', which is no channel"),
    "drift of no time": ({"drift": Drift(("level1_cm",), 0.01, 0.0)}, "a tau_s above zero"),
    "lag of nothing": ({"lags": (replace(LAG, state="pump_V"),)}, "lags names 'pump_V', which is no state behind"),
    "lag behind nothing": ({"lags": (replace(LAG, follows="volts"),)}, "lag 'pump_acting_V' follows 'volts'"),
    "lag without a time": ({"lags": (replace(LAG, tau_s="tau"),)}, "lag 'pump_acting_V': tau_s 'tau' is no parameter"),
    "lag twice": ({"lags": (LAG, LAG)}, "lags names 'pump_acting_V' twice"),
    "no first-order lag": (
        {"reduced": replace(REDUCED, rhs=rhs_without_lag)},
        "lag 'pump_acting_V': its rate in the reduced model is",
    ),
    "query": ({"query": ("pump_V/volts",)}, "query names 'volts', which is no channel"),
    "slow": ({"slow": ("h1_cm",)}, "slow names 'h1_cm', which is no channel"),
    "alike": ({"alike": (("h1_cm", "h9_cm"),)}, "alike names 'h9_cm', which is no estimated state"),
    "alike twice": ({"alike": (("h1_cm",), ("h1_cm", "h2_cm"))}, "alike names 'h1_cm' twice"),
    "regimes": ({"regimes": {"level": "h1_cm"}}, "regimes names 'h1_cm', which is no channel"),
    "commands": ({"commands": ("level1_cm",)}, "commands names 'level1_cm', which is no input"),
    "recalibrated": ({"recalibrated": ("flow",)}, "recalibrated names 'flow', which is no parameter"),
    "state walk": ({"state_walk": {"h1": 1.0}}, "state_walk names 'h1', which is no state"),
    "no state walk": ({"state_walk": {"h1_cm": 0.0}}, "state_walk of 'h1_cm' is 0.0"),
    "state spread": ({"state_spread": {"pump_acting_V": 1.0}}, "which is no estimated state"),
    "least": ({"least": {"pump_acting_V": 1.0}}, "least names 'pump_acting_V', which is no estimated state"),
    "loads fail": ({"loads": failing}, "loads(seconds, lean, rng) fails: IndexError"),
    "loads give no function": ({"loads": lambda *_: np.zeros(3)}, "must return a function of time_s"),
    "loads of a wrong shape": ({"loads": constant(5.0)}, "must give (9000, 2): a row for each time"),
    "loads are no numbers": ({"loads": lambda *_: lambda time_s: ["a"]}, "must give numbers"),
    "endless loads": ({"loads": constant(5.0, np.nan)}, "loads leave the bounds of valve in draw 1"),
    "loads leave the bounds": ({"loads": constant(13.0, 0.8)}, "13 V after 0 s, allowed are 0 to 12"),
    "loads of a mood": ({"loads": moody}, "other inputs for the same arguments; draw from rng alone"),
    "stretched": ({"stretched": lambda drive, beyond: 1.0}, "stretched(drive, beyond) must return a function"),
    "recombine": ({"recombine": lambda u, y, rng: u[0]}, "rng) must return as many finite numbers"),
    "starts in a wrong shape": ({"start": lambda u0: np.zeros(2)}, "start(u0) must return 3 numbers"),
    "leaves the states' bounds": (both("h2_cm", high=21.0), "fresh) leaves its bounds: h2_cm is 21 cm after"),
    "diverges": ({"plant": replace(PLANT, rhs=broken_above)}, "diverges: h1_cm is no number after"),
    "does not settle": ({"plant": replace(PLANT, rhs=restless)}, "the plant does not settle at pump_V ="),
}  # fmt: skip


@pytest.mark.parametrize(("changes", "says"), REFUSED.values(), ids=REFUSED)
def test_what_is_wrong_is_refused_in_one_line(changes: dict[str, object], says: str) -> None:
    machine: Machine = replace(TWO_TANKS, **changes)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"machine|simulator") as caught:
        check_machine(machine)
    line = str(caught.value)
    assert line.startswith(f"machine {machine.name!r}: ")
    assert "\n" not in line
    assert says in line
    assert any(word in line.lower() for word in MENDS)


@pytest.mark.parametrize("name", BUILTIN)
def test_the_built_in_machines_hold_together(name: str) -> None:
    check_machine(load_machine(name))


@pytest.mark.parametrize("name", ["own_machine.py", "cascaded_tanks_machine.py", "train_compressor_machine.py"])
def test_the_examples_hold_together(name: str) -> None:
    check_machine(load_machine(str(EXAMPLES / name)))


def test_a_plant_that_never_settles_says_where_it_begins() -> None:
    drifting = replace(TWO_TANKS, plant=replace(PLANT, rhs=rhs_that_drifts))
    with pytest.raises(ValueError, match="or give start"):
        check_machine(drifting)
    check_machine(replace(drifting, start=lambda u0: np.array([10.0, 8.0, u0[0]])))


def test_what_is_left_out_of_a_reading_follows_from_its_names() -> None:
    reading = Reading("level1_cm", "h1_cm")
    assert (reading.key, reading.says, reading.reads) == ("level1_cm", "h1_cm", "level1_cm")
    check_machine(replace(TWO_TANKS, readings=(reading, replace(H2, key=""))))


def test_a_life_and_a_lag_are_as_long_as_they_are_told() -> None:
    assert Health("pump", (1.0, 0.8)).ends == (1.0, 0.8)
    assert Health("pump", (1.0, 0.8), (1.0, 0.7)).span == pytest.approx(0.3)
    assert Health("bias2_cm", (-1.0, 1.0), (-2.0, 2.0), either_way=True).span == pytest.approx(2.0)
    assert Lag("a", "b", "c").follows == "b"
    assert Noise("a", 1.0).grows is None
