"""An FMU as a simulator: its states, inputs, outputs and parameters, its rates and readings."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from twinbench.physics.fmu import calls
from twinbench.physics.fmu.description import REAL, Description, Scalar
from twinbench.physics.fmu.library import Library
from twinbench.physics.fmu.unpack import digest, opened
from twinbench.physics.native import executed, native
from twinbench.physics.simulator import Array, Equation, Simulator, Variable

START_STEPS, CLOSE_SCALES, DIFFERENCE_SCALES = 20, 1e-9, 1e-6
"""Newton steps to the state that reads what was read, how near in scales is there, and the step of the differences."""
TRIED_POINTS, FAR, LATER_S = 200, 10.0, 1.0
"""Points at which it is tried on load, how far away in scales, and a time after the start."""
TRIED_STEPS, TRIED_STEP_S, BY_SOLVER = 20, 0.01, 1e-6
"""Steps for which one that can only be stepped is tried, how long they are if it does not say, and a relative
difference that its integrator may make."""
ON_TIME = "time; make what drives it an input"


_KNOWN: dict[str, Simulator] = {}
"""By content, wherever the file lies: a process may not be able to load it again."""


def simulator_of(path: str | Path) -> Simulator:
    """The simulator that an FMU is (FMI 2.0 or 3.0), for model exchange or for co-simulation.

    One for co-simulation that tells no rates before it is stepped has ``stepped`` in place of ``rhs``.

    An FMU is somebody's machine code. To load it is to run it.

    Raises:
        ValueError: one line: no FMU, or one that is no ordinary differential equation in real numbers.
    """
    content = digest(Path(path)) if Path(path).is_file() else ""
    try:
        if content not in _KNOWN:
            _KNOWN[content] = _loaded(Path(path), content)
        return _KNOWN[content]
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _loaded(path: Path, content: str) -> Simulator:
    description, folder = opened(path)
    inputs, outputs, parameters = _chosen(description)
    key = int(content[:15], 16)
    library = Library(description, folder, key, (inputs, outputs, parameters))
    rhs, output = _equation("rhs", calls.rates, key), _equation("output", calls.readings, key)
    found = Simulator(
        name=description.name or path.stem,
        says=description.says,
        states=tuple(map(_variable, description.states)),
        inputs=tuple(map(_variable, inputs)),
        outputs=tuple(map(_variable, outputs)),
        parameters=tuple(map(_variable, parameters)),
        rhs=rhs,
        output=output,
        initial=_unknown,
    )
    found = _at_start(found, calls.start(key, found.theta()))
    if not description.exchange and not _obeys(found, key):
        return _stepped(found, description, library)
    _probe(found, library)
    return found


def _stepped(simulator: Simulator, description: Description, library: Library) -> Simulator:
    """The same as one that can only be stepped.

    Raises:
        ValueError: one line: it cannot be, or depends on time.
    """
    states, key = description.starts, library.key
    library.steps(states)
    found = replace(
        simulator,
        states=tuple(map(_variable, states)),
        rhs=None,
        initial=_unknown,
        stepped=functools.partial(_run, key),
    )
    found = _at_start(found, calls.start(key, found.theta()))
    seconds = np.full(TRIED_STEPS, description.step_s or TRIED_STEP_S)
    x, u = (np.array([v.nominal for v in group]) for group in (found.states, found.inputs))
    library.set_time(LATER_S)
    later = _run(key, np.tile(u, (TRIED_STEPS, 1)), seconds, x, found.theta())
    library.set_time(0.0)
    run = _run(key, np.tile(u, (TRIED_STEPS, 1)), seconds, x, found.theta())
    if not np.isfinite(run).all():
        raise _failing(library)
    apart = np.abs(later - run).max(initial=0.0)  # NaN, and so no larger, if it begins at no other time
    if apart > BY_SOLVER * np.abs(run).max(initial=0.0):
        raise ValueError(f"what it does depends on {ON_TIME}")
    return found


def _run(key: int, u: Array, seconds: Array, x0: Array, theta: Array) -> Array:
    return np.asarray(calls.run(key, *(np.ascontiguousarray(part) for part in (u, seconds, x0, theta))))


def _at_start(simulator: Simulator, x: Array) -> Simulator:
    """With the states (nx,) in which it starts as nominal, and what the readings are there."""
    if not np.isfinite(x).all():
        return simulator
    u, theta = np.array([v.nominal for v in simulator.inputs]), simulator.theta()
    states = tuple(_moved_to(s, float(value)) for s, value in zip(simulator.states, x, strict=True))
    y, scale = simulator.output(x, u, theta), np.array([s.scale for s in states])
    spread = np.sqrt((_slopes(simulator, x, u, theta, scale) ** 2).sum(axis=1))
    outputs = tuple(
        replace(_moved_to(o, float(value)), scale=float(o.scale if math.isfinite(o.high - o.low) else by or o.scale))
        for o, value, by in zip(simulator.outputs, y, spread, strict=True)
    )
    found = replace(simulator, states=states, outputs=outputs)
    return replace(found, initial=Initial(found))


def _moved_to(v: Variable, nominal: float) -> Variable:
    return replace(v, nominal=nominal, low=min(v.low, nominal), high=max(v.high, nominal))


def _slopes(simulator: Simulator, x: Array, u: Array, theta: Array, scale: Array) -> Array:
    """What the readings change by if a state moves by its scale, (ny, nx), by central differences."""
    if not len(scale):
        return np.zeros((len(simulator.outputs), 0))
    ahead, behind = (
        np.stack([simulator.output(x + way * DIFFERENCE_SCALES * move, u, theta) for move in np.diag(scale)], axis=-1)
        for way in (1.0, -1.0)
    )
    return np.nan_to_num((ahead - behind) / (2.0 * DIFFERENCE_SCALES))


def _unknown(u0: Array, y0: Array, theta: Array) -> Array:
    """Stands where ``Initial`` will, which needs the simulator."""
    raise NotImplementedError


def _obeys(simulator: Simulator, key: int) -> bool:
    """Can an FMU for co-simulation be brought to a state, and does it tell rates there, before it is stepped?"""
    x, u = (np.array([v.nominal for v in group]) for group in (simulator.states, simulator.inputs))
    x = x + np.array([s.scale for s in simulator.states])
    theta = simulator.theta()
    kept = np.array_equal(calls.kept(key, x, u, theta), x)
    return bool(len(x) and kept and np.isfinite(simulator.rhs(x, u, theta)).all())  # type: ignore[misc]


def _failing(library: Library) -> ValueError:
    said = f": {library.says}" if library.says else ""
    return ValueError(f"reports an error at its own start{said}; see that it simulates where it was made")


def _probe(simulator: Simulator, library: Library) -> None:
    """Try it at states and inputs about the nominal ones.

    Raises:
        ValueError: one line: it is no ordinary differential equation.
    """
    groups, theta, rng = (simulator.states, simulator.inputs), simulator.theta(), np.random.default_rng(0)
    x, u = (np.array([v.nominal for v in group]) for group in groups)
    of_x, of_u = (np.array([v.scale for v in group]) for group in groups)
    before = simulator.rhs(x, u, theta)  # type: ignore[misc]
    if not np.isfinite(before).all():
        raise _failing(library)
    library.set_time(LATER_S)
    if not np.array_equal(before, simulator.rhs(x, u, theta)):  # type: ignore[misc]
        raise ValueError(f"its rates depend on {ON_TIME}")
    for _ in range(TRIED_POINTS):
        away = (rng.uniform(-FAR, FAR, part.size) for part in (x, u))
        simulator.rhs(x + of_x * next(away), u + of_u * next(away), theta)  # type: ignore[misc]
    if library.noted(calls.TIMED):
        raise ValueError("has a timetable of events; make what happens then an input")
    if library.noted(calls.JUMPED):
        raise ValueError("its states jump at events; only machines whose states move steadily can be examined")


def _variable(v: Scalar) -> Variable:
    """Nominal at its start, or near 0 within its bounds where that is calculated."""
    nominal = v.start if math.isfinite(v.start) else min(max(v.low, 0.0), v.high)
    low, high = min(v.low, nominal), max(v.high, nominal)
    return Variable(v.name, v.unit, low, high, nominal, v.size if v.size > 0.0 else 0.0, v.says)


def _chosen(description: Description) -> tuple[tuple[Scalar, ...], ...]:
    """Inputs, outputs and parameters of the simulator.

    Raises:
        ValueError: one line: what cannot be simulated.
    """
    if description.needs_tool:
        raise ValueError("runs only where its authoring tool is; export it with its own binary")
    if not description.states and description.exchange:
        raise ValueError("has no continuous states, so nothing to simulate")
    real = REAL[description.version]
    inputs = description.of("input")
    for v in (*inputs, *description.states):
        if v.kind != real:
            what = "an array" if v.kind == "array" else f"of type {v.kind}"
            raise ValueError(f"its {v.causality} {v.name!r} is {what}, must be a single real number")
    outputs = tuple(v for v in description.of("output") if v.kind == real) or description.states
    if not outputs:
        raise ValueError("has no outputs that are real numbers, so nothing to compare")
    parameters = tuple(v for v in description.of("parameter") if v.kind == real and math.isfinite(v.start))
    return inputs, outputs, parameters


def _equation(name: str, function: Callable[..., Any], key: int) -> Equation:
    """An equation that calls an FMU, plain; compiled it is kept from process to process.

    The key is a number of a type. For a literal numba would compile what is called again, for each FMU.
    """
    text = f"def {name}(x, u, theta):\n    return call(np.int64({key}), x, u, theta)\n"
    made = executed(text, {"call": function})[name]
    made.native = functools.partial(_compiled, name, text, function)
    return made  # type: ignore[no-any-return]


def _compiled(name: str, text: str, function: Callable[..., Any]) -> Any:
    return native(text, (("call", function),))[name]


@dataclass(frozen=True, eq=False)
class Initial:
    """Where a recording begins: the state nearest to the FMU's own start whose readings are the first ones.

    Nearest is meant in the states' scales. What the readings do not tell stays where the FMU starts.
    """

    simulator: Simulator

    def __call__(self, u0: Array, y0: Array, theta: Array) -> Array:
        """x0 (nx,) from first inputs (nu,) and readings (ny,) in the units of the simulator's variables."""
        x = np.array([s.nominal for s in self.simulator.states])
        scale = np.array([s.scale for s in self.simulator.states])
        of_reading = np.array([o.scale for o in self.simulator.outputs])
        for _ in range(START_STEPS if len(x) else 0):
            gap = (y0 - self.simulator.output(x, u0, theta)) / of_reading
            gap[~np.isfinite(gap)] = 0.0
            slopes = _slopes(self.simulator, x, u0, theta, scale) / of_reading[:, None]
            move = np.linalg.pinv(slopes, rcond=DIFFERENCE_SCALES) @ gap
            x = x + scale * move
            if np.abs(move).max() < CLOSE_SCALES:
                break
        return x
