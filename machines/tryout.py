"""A machine is run before it is believed: its loads, and its plant and reduced model, fresh and worn, under them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from twinbench.common.trial import about_to
from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine
from twinbench.physics.integrate import Varying, simulate
from twinbench.physics.simulator import Simulator, Variable

LOADS_S = 1800.0
"""How long loads are drawn for: a recording of the benchmark's usual profiles."""
TRIED_TICKS = 6000
"""Of it, how many the simulators are run over: five minutes at 20 Hz. A machine that leaves its bounds only later is
found when it is simulated."""
TRIED_DRAWS = 6
"""Draws that are tried: all leans low and fresh, all high and worn, the rest anywhere in between."""
SLACK = 1e-9
"""Of a variable's range: how far beyond its bounds counts as round-off."""


class Draw(NamedTuple):
    """One draw of loads and wear.

    Attributes:
        name: for messages.
        u: (N, nu) inputs in their units.
        health: (nh,) in the parameters' units.
    """

    name: str
    u: Array
    health: Array


def draws(machine: Machine) -> Iterator[Draw]:
    """Loads of LOADS_S with the wear that goes with them, the same ones each time.

    Raises:
        ValueError: one line; loads fail, or are of a wrong shape.
    """
    rng = np.random.default_rng(0)
    fresh, worn = np.array([h.ends for h in machine.health]).T
    for k in range(TRIED_DRAWS):
        lean, wear = rng.random(machine.leans), rng.random(len(machine.health))
        if k < 2:
            lean, wear = np.full_like(lean, k), np.full_like(wear, k)
        said = ", ".join(f"{v:.2g}" for v in lean) or "none"
        name = f"draw {k + 1} (lean {said}, {('fresh', 'worn', 'part worn')[min(k, 2)]})"
        yield Draw(name, _inputs(machine, lean, k), fresh + wear * (worn - fresh))


def _inputs(machine: Machine, lean: Array, seed: int) -> Array:
    time_s = np.arange(round(LOADS_S / machine.sample_period_s), dtype=np.float64) * machine.sample_period_s
    drive = _called(machine.loads, (LOADS_S, lean, np.random.default_rng(seed)), "loads(seconds, lean, rng)")
    if not callable(drive):
        raise ValueError(f"loads(seconds, lean, rng) returns {type(drive).__name__}, must return a function of time_s")
    return _driven(machine, drive, time_s, "loads")


def _driven(machine: Machine, drive: Callable[[Array], Any], time_s: Array, who: str) -> Array:
    what = f"what {who} returns, called with time_s of shape {time_s.shape},"
    u = _called(drive, (time_s,), what)
    try:
        u = np.asarray(u, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{what} gives {type(u).__name__}, must give numbers") from error
    wanted = (len(time_s), len(machine.inputs))
    if u.shape != wanted:
        raise ValueError(
            f"{what} gives shape {u.shape}, must give {wanted}: a row for each time, a column for each of "
            f"{', '.join(machine.inputs)}"
        )
    return u


def _called(function: Callable[..., Any], arguments: tuple[Any, ...], what: str) -> Any:
    about_to(what)
    try:
        return function(*arguments)
    except Exception as error:
        said = (str(error).splitlines() or [""])[0]
        raise ValueError(f"{what} fails: {type(error).__name__}: {said}; mend it there") from error


def try_loads(machine: Machine) -> None:
    """Loads are numbers within the inputs' bounds, and the same from the same stream.

    Raises:
        ValueError: one line.
    """
    first, again = list(draws(machine)), list(draws(machine))
    time_s = np.arange(len(first[0].u), dtype=np.float64) * machine.sample_period_s
    for draw, other in zip(first, again, strict=True):
        if found := _beyond(draw.u, machine.plant.inputs):
            i, k = found
            variable = machine.plant.inputs[i]
            raise ValueError(
                f"loads leave the bounds of {variable.name} in {draw.name}: {draw.u[k, i]:.4g} {variable.unit} after "
                f"{time_s[k]:.4g} s, allowed are {variable.low:g} to {variable.high:g}; keep loads inside, or widen "
                "the bounds"
            )
        if not np.array_equal(draw.u, other.u):
            raise ValueError(
                "loads(seconds, lean, rng) gives other inputs for the same arguments; draw from rng alone, and once"
            )
    if machine.stretched is not None:
        drive = _called(machine.loads, (LOADS_S, np.full(machine.leans, 0.5), np.random.default_rng(0)), "loads")
        farther = _called(machine.stretched, (drive, 0.2), "stretched(drive, beyond)")
        if not callable(farther):
            raise ValueError("stretched(drive, beyond) must return a function of time_s, as loads does")
        if not np.isfinite(_driven(machine, farther, time_s, "stretched")).all():
            raise ValueError("stretched(drive, beyond) gives what is no number; mend it")


def try_plant(machine: Machine) -> None:
    """The plant stays within its states' bounds under loads, fresh and worn; the reduced model, too.

    Raises:
        ValueError: one line; which state, when, in which draw.
    """
    kept = []
    for draw in draws(machine):
        u = draw.u[:TRIED_TICKS]
        about_to(f"the plant in {draw.name}")
        x0 = _start(machine, u[0], draw.name)
        for simulator, who in ((machine.plant, "the plant"), (machine.reduced, "the reduced model")):
            about_to(f"{who} in {draw.name}")
            x, y = _ran(machine, simulator, u, x0, draw.health)
            _stays(machine, simulator, x, f"{who} in {draw.name}")
            if who == "the plant":
                kept.append((u, y))
    if machine.recombine is not None:
        inputs, outputs = (np.stack(part) for part in zip(*kept, strict=True))
        what = "recombine(inputs, outputs, rng)"
        mixed = np.asarray(_called(machine.recombine, (inputs, outputs, np.random.default_rng(0)), what))
        if mixed.shape != inputs.shape or not np.isfinite(mixed).all():
            raise ValueError(f"{what} must return as many finite numbers as inputs has, shape {inputs.shape}")


def _start(machine: Machine, u0: Array, name: str) -> Array:
    """Where a recording begins."""
    inputs = ", ".join(f"{n} = {v:.4g}" for n, v in zip(machine.inputs, u0, strict=True))
    if machine.start is None:
        try:
            with np.errstate(all="ignore"):
                return machine.at_first(u0)
        except ValueError as error:
            raise ValueError(
                f"the plant does not settle at {inputs} ({name}); let every state come to rest under constant inputs, "
                "or give start(u0), where recordings begin"
            ) from error
    x0 = np.asarray(_called(machine.start, (u0,), "start(u0)"), dtype=np.float64)
    if x0.shape != (len(machine.plant.states),) or not np.isfinite(x0).all():
        raise ValueError(f"start(u0) must return {len(machine.plant.states)} numbers, where the states are at {inputs}")
    return x0


def _ran(machine: Machine, simulator: Simulator, u: Array, x0: Array, health: Array) -> tuple[Array, Array]:
    varying = Varying(machine.health_names, np.tile(health, (1, len(u), 1)))
    with np.errstate(all="ignore"):
        x, y = simulate(simulator, u[None], x0, dt_s=machine.sample_period_s, varying=varying)
    return x[0], y[0]


def _stays(machine: Machine, simulator: Simulator, x: Array, who: str) -> None:
    if found := _beyond(x, simulator.states):
        i, k = found
        variable, at_s = simulator.states[i], k * machine.sample_period_s
        if not np.isfinite(x[k, i]):
            raise ValueError(
                f"{who} diverges: {variable.name} is no number after {at_s:.4g} s; mend its equations, or give a "
                "shorter sample_period_s"
            )
        raise ValueError(
            f"{who} leaves its bounds: {variable.name} is {x[k, i]:.4g} {variable.unit} after {at_s:.4g} s, allowed "
            f"are {variable.low:g} to {variable.high:g}; keep loads milder, or widen these"
        )


def _beyond(values: Array, variables: tuple[Variable, ...]) -> tuple[int, int] | None:
    """Which variable, at which row of (N, n), is first no number or outside its bounds."""
    low, high, nominal = (np.array([getattr(v, part) for v in variables]) for part in ("low", "high", "nominal"))
    slack = SLACK * np.maximum(np.where(np.isfinite(high - low), high - low, np.abs(nominal)), 1e-30)
    wrong = ~np.isfinite(values) | (values < low - slack) | (values > high + slack)
    if not wrong.any():
        return None
    k = int(np.argmax(wrong.any(axis=1)))
    return int(np.argmax(wrong[k])), k
