"""Does a machine's record hold together? Names, bounds, readings, noise and lags; then it is run."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine
from twinbench.machines.parts import Health, Lag, Reading
from twinbench.machines.sensors import Drift, Noise
from twinbench.machines.tryout import try_loads, try_plant
from twinbench.physics.check import check_simulator
from twinbench.physics.compose import plain_rhs
from twinbench.physics.simulator import Simulator

POINTS = 6
"""States, inputs and parameters drawn about the nominal ones at which readings and lags are compared."""
AGREE_WITHIN = 1e-6
"""Of a scale: how far a reading may be from ``gain * state + bias``, and a lag's rate from that of a first-order lag. A
formula written in another order differs by 1e-12; a term that is there by mistake by far more."""
RESERVED = "time_s"
"""The column of recordings that holds the time."""


def check_machine(machine: Machine) -> None:
    """See that a record holds together, and run it: loads, the plant fresh and worn, the reduced model.

    Raises:
        ValueError: one line that says what is wrong, where, and how to mend it.
    """
    for look in (_kinds, _simulators, _names, _health, _readings, _noise, _lags, _mentions, try_loads, try_plant):
        try:
            look(machine)
        except ValueError as error:
            raise ValueError(f"machine {machine.name!r}: {error}") from error


def _kinds(machine: Machine) -> None:
    """Tuples of the right records, numbers where numbers belong."""
    if not isinstance(machine.name, str) or not re.fullmatch(r"\w[\w-]*", machine.name):
        raise ValueError("its name becomes part of file names; use letters, digits, _ and - only")
    for part in ("plant", "reduced"):
        if not isinstance(getattr(machine, part), Simulator):
            raise ValueError(f"{part} is no Simulator; give one")
    records = {"health": Health, "readings": Reading, "noise": Noise, "lags": Lag, "alike": tuple}
    texts = dict.fromkeys(("estimated", "recalibrated", "query", "slow", "commands"), str)
    for part, kind in {**records, **texts}.items():
        value = getattr(machine, part)
        if not isinstance(value, tuple) or not all(isinstance(v, kind) for v in value):
            word = "names" if kind is str else "tuples of names" if kind is tuple else f"{kind.__name__} records"
            raise ValueError(f"{part} must be a tuple of {word}; a tuple of one is written (x,)")
    if not isinstance(machine.drift, Drift):
        raise ValueError("drift must be a Drift; leave it out if sensors err apart")
    if not (isinstance(machine.leans, int) and machine.leans >= 0):
        raise ValueError(f"leans is {machine.leans!r}; give how many coordinates loads takes, 0 or more")
    period_s = machine.sample_period_s
    if not (isinstance(period_s, int | float) and math.isfinite(period_s) and period_s > 0.0):
        raise ValueError(f"sample_period_s is {period_s!r}; give seconds above zero")
    for part in ("loads", "start", "recombine", "stretched"):
        value = getattr(machine, part)
        if not callable(value) and (part == "loads" or value is not None):
            raise ValueError(f"{part} is {type(value).__name__}; give a function")


def _simulators(machine: Machine) -> None:
    check_simulator(machine.plant)
    for kind in ("states", "inputs", "outputs", "parameters"):
        plant, reduced = (
            [(getattr(v, "name", v), getattr(v, "unit", "")) for v in getattr(s, kind)]
            for s in (machine.plant, machine.reduced)
        )
        for i, (ours, theirs) in enumerate(zip(plant, reduced, strict=False)):
            if ours != theirs:
                raise ValueError(
                    f"{kind} differ: number {i + 1} is {_with_unit(*ours)} of the plant and {_with_unit(*theirs)} of "
                    "the reduced model; both need the same in the same order (a reduced model may leave one unused)"
                )
        if len(plant) != len(reduced):
            raise ValueError(f"the plant has {len(plant)} {kind}, the reduced model {len(reduced)}; give both the same")
    check_simulator(machine.reduced)
    if not machine.inputs:
        raise ValueError("has no inputs; at least one is needed, which loads moves")


def _with_unit(name: str, unit: str) -> str:
    return f"{name!r} in {unit or '1'!r}"


def _names(machine: Machine) -> None:
    states = [v.name for v in machine.plant.states]
    first = tuple(states[: len(machine.estimated)])
    if not machine.estimated:
        raise ValueError("estimated is empty; name the states that are estimated, the simulators' first ones")
    for name in machine.estimated:
        _known(name, states, "estimated names {}, which is no state")
    if machine.estimated != first:
        raise ValueError(
            f"estimated is {', '.join(machine.estimated)}, the simulators' first states are {', '.join(first)}; put "
            "the estimated states first in both simulators, in this order"
        )
    outputs = set(machine.outputs)
    for name in states:
        if name in outputs:
            raise ValueError(f"{name!r} is a state and an output; rename the output, its reading has noise")
    for name in (*machine.channels, *states, *(v.name for v in machine.plant.parameters)):
        if not re.fullmatch(r"\w+", name) or name == RESERVED:
            raise ValueError(f"the name {name!r} cannot be a column's; use letters, digits and _, and not {RESERVED}")


def _health(machine: Machine) -> None:
    if not machine.health:
        raise ValueError("health is empty; name at least one parameter that changes while the machine lives")
    parameters = [v.name for v in machine.plant.parameters]
    _once(machine.health_names, "health names {} twice; leave one out")
    for h in machine.health:
        _known(h.name, parameters, "health names {}, which is no parameter")
        variable = machine.plant.parameters[machine.plant.index(h.name)]
        low, high, healthy = variable.low, variable.high, variable.nominal
        who = f"health {h.name!r}"
        if h.exponential and not (low > 0.0 and healthy > 0.0):
            raise ValueError(
                f"{who} is exponential, and the parameter may be {low:g}; give it a lower bound above zero, or leave "
                "exponential out"
            )
        if not (math.isfinite(low) and math.isfinite(high)):
            raise ValueError(
                f"{who}: the parameter has no end on one side ({low:g} to {high:g}); give it finite bounds"
            )
        if not h.exponential and not low < healthy < high:
            raise ValueError(f"{who}: healthy is {healthy:g}, on a bound ({low:g} to {high:g}); set that farther off")
        for part, ends in (("start", h.start), ("life", h.ends)):
            _range(ends, (low, high), f"{who}: its {part}")
        if not math.isnan(h.counterfactual[0]) and not h.counterfactual[0] < h.counterfactual[1]:
            raise ValueError(f"{who}: counterfactual goes from {h.counterfactual[0]:g} to {h.counterfactual[1]:g}; "
                             "give the lower end first")  # fmt: skip
        if not (math.isfinite(h.walk) and h.walk >= 0.0):
            raise ValueError(f"{who}: walk is {h.walk}; give a number above zero, or leave it out")
    _within_farthest(machine)


def _range(ends: Sequence[float], bounds: tuple[float, float], what: str) -> None:
    if not (isinstance(ends, tuple) and len(ends) == 2 and all(isinstance(e, int | float) for e in ends)):
        raise ValueError(f"{what} is {ends!r}; give two numbers, fresh and worn")
    if not all(bounds[0] <= end <= bounds[1] for end in ends):
        raise ValueError(
            f"{what} goes from {ends[0]:g} to {ends[1]:g}, outside the parameter's bounds {bounds[0]:g} to "
            f"{bounds[1]:g}; widen these, or shorten it"
        )
    if ends[0] == ends[1]:
        raise ValueError(f"{what} is of no size, {ends[0]:g} at both ends; say where it is fresh and where it is worn")


def _within_farthest(machine: Machine) -> None:
    """Filters keep health within ``farthest``; a life must fit in."""
    low, high = machine.zeta_bounds
    for worn in (False, True):
        zeta = machine.coordinates.to_zeta(np.array([h.ends[worn] for h in machine.health]))
        for i in np.flatnonzero((zeta < low) | (zeta > high)):
            h = machine.health[i]
            raise ValueError(
                f"health {h.name!r}: a life reaches {h.ends[worn]:g}, beyond what filters let it be; give a farthest "
                "that is farther from the healthy value"
            )


def _readings(machine: Machine) -> None:
    _in_order([r.output for r in machine.readings], machine.outputs, "readings", "outputs")
    _once([r.key for r in machine.readings], "two readings have the key {}; each needs its own")
    places = {v.name: i for i, v in enumerate(machine.plant.states)}
    readable = (*machine.estimated, *(lag.state for lag in machine.lags))
    for r in machine.readings:
        _known(r.state, readable, f"reading {r.output!r} is of {{}}, which is neither an estimated state nor a lag")
        if r.bias:
            _known(r.bias, machine.health_names, f"reading {r.output!r} has the bias {{}}, which is no health")
        if not re.fullmatch(r"\w+", r.key):
            raise ValueError(f"reading {r.output!r}: the key {r.key!r} names scores; use letters, digits and _")
        if not (math.isfinite(r.gain) and r.gain != 0.0):
            raise ValueError(f"reading {r.output!r}: its gain is {r.gain}; give a number that is not zero")
    output = _plain(machine.reduced.output)
    for x, u, theta in _points(machine):
        y = output(x, u, theta)
        for i, r in enumerate(machine.readings):
            expected = r.gain * x[places[r.state]] + (theta[machine.reduced.index(r.bias)] if r.bias else 0.0)
            if not abs(y[i] - expected) <= AGREE_WITHIN * machine.reduced.outputs[i].scale:
                bias = f" + {r.bias}" if r.bias else ""
                raise ValueError(
                    f"reading {r.output!r} should be {r.gain:g} {r.state}{bias} = {expected:.6g}, and the reduced "
                    f"model's output gives {y[i]:.6g}; mend the Reading or output(x, u, theta)"
                )


def _noise(machine: Machine) -> None:
    _in_order([n.channel for n in machine.noise], machine.channels, "noise", "channels, inputs first")
    for n in machine.noise:
        who, read = f"noise of {n.channel!r}", n.channel in machine.outputs
        for part in ("white", "coloured"):
            value = getattr(n, part)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{who}: {part} is {value}; give a standard deviation, 0 or more")
        if read and n.white == 0.0:
            raise ValueError(f"{who}: white is 0, and no sensor is exact; give its standard deviation")
        if n.coloured and not read:
            raise ValueError(f"{who}: coloured is of outputs only; leave it out")
        if not (math.isfinite(n.tau_s) and n.tau_s > 0.0):
            raise ValueError(f"{who}: tau_s is {n.tau_s}; give seconds above zero")
        if n.grows is not None:
            _known(n.grows.channel, machine.inputs, f"{who} grows with {{}}, which is no input")
            if n.grows.reference == 0.0:
                raise ValueError(f"{who}: its growth refers to 0; give a reference that is not zero")
    for channel in machine.drift.channels:
        _known(channel, machine.channels, "drift names {}, which is no channel")
    if not (machine.drift.share >= 0.0 and machine.drift.tau_s > 0.0):
        raise ValueError("drift: give a share of 0 or more, and a tau_s above zero")


def _lags(machine: Machine) -> None:
    states = [v.name for v in machine.plant.states]
    hidden = states[len(machine.estimated) :]
    for lag in machine.lags:
        _known(lag.state, hidden, "lags names {}, which is no state behind the estimated ones")
        followed = machine.estimated + machine.inputs
        _known(
            lag.follows, followed, f"lag {lag.state!r} follows {{}}, which is neither an estimated state nor an input"
        )
        _known(lag.tau_s, [v.name for v in machine.plant.parameters], f"lag {lag.state!r}: tau_s {{}} is no parameter")
        if bool(lag.faster_with) != bool(lag.exponent):
            raise ValueError(f"lag {lag.state!r} has faster_with or exponent alone; give both, or neither")
        if lag.exponent:
            parameters = [v.name for v in machine.plant.parameters]
            _known(lag.faster_with, machine.estimated, f"lag {lag.state!r}: faster_with {{}} is no estimated state")
            _known(lag.exponent, parameters, f"lag {lag.state!r}: exponent {{}} is no parameter")
    named = [lag.state for lag in machine.lags]
    _once(named, "lags names {} twice; leave one out")
    if named != (sorted_ := sorted(named, key=states.index)):
        raise ValueError(f"lags are {', '.join(named)}; put them in the simulators' order: {', '.join(sorted_)}")
    rhs = _plain(plain_rhs(machine.reduced))
    for x, u, theta in _points(machine):
        rates = rhs(x, u, theta)
        values = dict(zip([*states, *machine.inputs], [*x, *u], strict=True))
        for lag in machine.lags:
            i, tau_s = states.index(lag.state), theta[machine.reduced.index(lag.tau_s)]
            if lag.exponent:
                tau_s *= values[lag.faster_with] ** -theta[machine.reduced.index(lag.exponent)]
            expected = (values[lag.follows] - x[i]) / tau_s
            if not abs(rates[i] - expected) <= AGREE_WITHIN * max(abs(expected), machine.reduced.states[i].scale):
                raise ValueError(
                    f"lag {lag.state!r}: its rate in the reduced model is {rates[i]:.6g}, that of a first-order lag, "
                    f"({lag.follows} - {lag.state}) / {lag.tau_s}, is {expected:.6g}; mend rhs, or leave out the Lag"
                )


def _mentions(machine: Machine) -> None:
    """Names that stand somewhere else in the record."""
    for part in ("query", "regimes"):
        named = getattr(machine, part)
        for expression in named.values() if part == "regimes" else named:
            for channel in str(expression).split("/", maxsplit=1):
                _known(channel, machine.channels, f"{part} names {{}}, which is no channel")
    allowed: dict[str, tuple[Sequence[str], str]] = {
        "slow": (machine.channels, "channel"),
        "commands": (machine.inputs, "input"),
        "recalibrated": ([v.name for v in machine.plant.parameters], "parameter"),
        "state_walk": ([v.name for v in machine.plant.states], "state"),
        "state_spread": (machine.estimated, "estimated state"),
        "least": (machine.estimated, "estimated state"),
    }
    for part, (names, word) in allowed.items():
        for name in getattr(machine, part):
            _known(name, names, f"{part} names {{}}, which is no {word}")
    for part in ("state_walk", "state_spread"):
        for name, value in getattr(machine, part).items():
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{part} of {name!r} is {value}; give a number above zero, or leave it out")
    together = [name for group in machine.alike for name in group]
    for name in together:
        _known(name, machine.estimated, "alike names {}, which is no estimated state")
    _once(together, "alike names {} twice; leave it in one group only")


def _points(machine: Machine) -> Iterable[tuple[Array, Array, Array]]:
    """States and inputs of the reduced model, health and what may be fitted, about their nominal values."""
    rng, simulator = np.random.default_rng(0), machine.reduced
    moving = {*machine.health_names, *machine.recalibrated}
    free = np.array([v.name in moving for v in simulator.parameters])
    for k in range(POINTS):
        point = []
        for group in (simulator.states, simulator.inputs, simulator.parameters):
            low, high, nominal, scale = (np.array([getattr(v, p) for v in group], dtype=np.float64) for p in _PARTS)
            near = np.clip(nominal + (k > 0) * scale * rng.uniform(-1.0, 1.0, len(group)), low, high)
            point.append(np.where(free, near, nominal) if group is simulator.parameters else near)
        yield point[0], point[1], point[2]


_PARTS = ("low", "high", "nominal", "scale")


def _plain(function: Callable[..., Any]) -> Callable[..., Any]:
    """What a compiled function was written as."""
    return getattr(function, "py_func", function)  # type: ignore[no-any-return]


def _in_order(named: Sequence[str], wanted: Sequence[str], part: str, of: str) -> None:
    if list(named) != list(wanted):
        raise ValueError(
            f"{part} are of {', '.join(named) or 'nothing'}; give one for each of the {of}, in order: "
            f"{', '.join(wanted)}"
        )


def _known(name: str, names: Sequence[str], complaint: str) -> None:
    """``complaint`` has {} where the name goes."""
    if name not in names:
        near = difflib.get_close_matches(str(name), names, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"choose from {', '.join(names) or 'none'}"
        raise ValueError(f"{complaint.format(repr(name))}; {hint}")


def _once(names: Sequence[str], complaint: str) -> None:
    if twice := [name for name in names if list(names).count(name) > 1]:
        raise ValueError(complaint.format(repr(twice[0])))
