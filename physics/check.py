"""Does a simulator, does a mechanism keep its word? Each function is called at the nominal state and about it.

The plain Python functions are called, nothing is compiled: a mistake is told by the line it is in.
"""

from __future__ import annotations

import contextlib
import traceback
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from twinbench.common.trial import about_to
from twinbench.physics.simulator import Array, Mechanism, Series, Simulator, Term, Variable, index_of

_TRIAL_S = 10.0
_TRIAL_SAMPLES = 50
_TRIAL_POINTS = 6
"""States, inputs and parameters drawn between their bounds, at which a function must come back at all."""
_FAR_SCALES = 10.0  # scales from the nominal value at most: bounds may be infinite

Arguments = tuple[Array, ...]


def check_simulator(simulator: Simulator) -> None:
    """Call ``rhs`` (or ``flux`` and ``balance``, or ``stepped``), ``output`` and ``initial``, and look at the results.

    Raises:
        ValueError: one line; a function raises, or returns another length, no numbers, NaN, or not the same twice.
    """
    who = f"simulator {simulator.name!r}"
    _check_records(simulator, who)
    n, inputs, outputs, parameters = simulator.states, simulator.inputs, simulator.outputs, simulator.parameters
    points = _points(n, inputs, parameters)
    _call(simulator.output, points, outputs, f"{who}: output(x, u, theta)")
    _call(simulator.initial, _points(inputs, outputs, parameters), n, f"{who}: initial(u0, y0, theta)")
    if simulator.rhs is not None:
        _call(simulator.rhs, points, n, f"{who}: rhs(x, u, theta)")
    if simulator.stepped is not None:
        x, u, theta = points[0]
        run = simulator.stepped
        who_reads = (*outputs, *n)
        _call(lambda *given: run(*given)[0], [(u[None], np.zeros(1), x, theta)], who_reads, f"{who}: stepped")
    if simulator.flux is not None and simulator.balance is not None:
        f = _call(simulator.flux, points, simulator.fluxes, f"{who}: flux(x, u, theta)")
        (*nominal, _), *others = _points(n, inputs, parameters, simulator.fluxes)
        _call(simulator.balance, [(*nominal, f), *others], n, f"{who}: balance(x, u, theta, f)")


def check_mechanism(simulator: Simulator, mechanism: Mechanism) -> None:
    """See that what it acts on exists, and call its functions once.

    Raises:
        ValueError: one line that names the mechanism and what is wrong with it.
    """
    who = f"mechanism {mechanism.name!r}"
    try:
        at = mechanism.port.variable_of(simulator)
    except ValueError as error:
        raise ValueError(f"{who}: {error}") from None
    match mechanism:
        case Term():
            _check_term(simulator, mechanism, who)
        case Series():
            time_s = np.linspace(0.0, _TRIAL_S, _TRIAL_SAMPLES)
            values = np.full(_TRIAL_SAMPLES, at.nominal)
            trials = [(time_s, values, own) for (own,) in _points(mechanism.parameters)]
            _call(mechanism.series, trials, values.tolist(), f"{who}: series(time_s, values, theta)")
        case _:
            for variable in mechanism.parameters:
                complaint = f"{who}: is an Amplitude, so its parameters are the simulator's; there is no"
                index_of(simulator.parameters, variable.name, complaint)


def _check_term(simulator: Simulator, mechanism: Term, who: str) -> None:
    points = _points(simulator.states + mechanism.states, simulator.inputs, simulator.parameters + mechanism.parameters)
    if mechanism.sees_own:
        at = mechanism.port.variable_of(simulator)
        owns = _points((at,))
        seeing = [(*point, own[0]) for point, (own,) in zip(points, owns, strict=True)]
        _call(mechanism.term, seeing, None, f"{who}: term(x, u, theta, own)")
    else:
        _call(mechanism.term, points, None, f"{who}: term(x, u, theta)")
    if mechanism.into is not None and mechanism.ratio is not None:
        try:
            mechanism.into.variable_of(simulator)
        except ValueError as error:
            raise ValueError(f"{who}: into: {error}") from None
        _call(mechanism.ratio, points, None, f"{who}: ratio(x, u, theta)")
    if mechanism.derivative is not None:
        _call(mechanism.derivative, points, mechanism.states, f"{who}: derivative(x, u, theta)")
    if mechanism.initial is not None:
        _call(mechanism.initial, points, mechanism.states, f"{who}: initial(x0, u0, theta)")


def _check_records(simulator: Simulator, who: str) -> None:
    kinds = ("states", "inputs", "outputs", "parameters", "fluxes")
    for kind in kinds:
        if not all(isinstance(v, Variable) for v in getattr(simulator, kind)):
            raise ValueError(f"{who}: {kind} must be a tuple of Variables")
    for kind in ("states", "outputs"):
        if not getattr(simulator, kind) and not (kind == "states" and simulator.stepped is not None):
            raise ValueError(f"{who}: has no {kind}; at least one is needed")
    for kind in ("outputs", "parameters"):
        names = {v.name for v in getattr(simulator, kind)}
        other = "inputs" if kind == "outputs" else "states"
        if both := [v.name for v in getattr(simulator, other) if v.name in names]:
            raise ValueError(f"{who}: {both[0]!r} is the name of one of its {other} and of its {kind}; rename one")
    for kind in kinds:
        for v in getattr(simulator, kind):
            if not (isinstance(v.name, str) and isinstance(v.unit, str)):
                raise ValueError(f"{who}: name and unit of {v.name!r} must be text; '1' is no unit")
            if not (np.isfinite(v.scale) and v.scale > 0.0):
                raise ValueError(f"{who}: scale of {v.name!r} is {v.scale}; give a typical size of change, above zero")
            if not np.isfinite(v.nominal):
                raise ValueError(f"{who}: nominal of {v.name!r} is {v.nominal}; give a number")


def last_line(error: BaseException, file: str) -> int | None:
    """The line of ``file`` that an error came through last, if it did; of an endless recursion there are many."""
    line = None
    for frame, number in traceback.walk_tb(error.__traceback__):
        if frame.f_code.co_filename == file:
            line = number
    return line


def _points(*groups: Sequence[Variable]) -> list[Arguments]:
    """The groups' values at their nominal, at their low, at their high ends, and drawn in between."""
    rng = np.random.default_rng(0)
    nominal = [np.array([v.nominal for v in group], dtype=np.float64) for group in groups]
    low = [np.array([max(v.low, v.nominal - _FAR_SCALES * v.scale) for v in group]) for group in groups]
    high = [np.array([min(v.high, v.nominal + _FAR_SCALES * v.scale) for v in group]) for group in groups]
    ends = list(zip(low, high, strict=True))
    drawn = [tuple(a + rng.random(len(a)) * (b - a) for a, b in ends) for _ in range(_TRIAL_POINTS)]
    return [tuple(nominal), tuple(low), tuple(high), *drawn]


def _call(function: Callable[..., Any], points: Sequence[Arguments], like: Sequence[Any] | None, what: str) -> Array:
    """The result at the first point: as many finite numbers as ``like`` has entries, or one number if that is None.

    At the others it must only come back, and at the first once more with the same.
    """
    function = getattr(function, "py_func", function)
    values = _checked(function, points[0], like, what)
    for arguments in points[1:]:
        about_to(f"{what} at values between its bounds")
        with contextlib.suppress(Exception), np.errstate(all="ignore"):
            function(*(a.copy() for a in arguments))
    if not np.array_equal(values, _checked(function, points[0], like, what)):
        raise ValueError(
            f"{what} returns other numbers for the same arguments; it must not draw any, nor look at a clock or at "
            "what it did before"
        )
    return values


def _checked(function: Callable[..., Any], arguments: Arguments, like: Sequence[Any] | None, what: str) -> Array:
    given = tuple(a.copy() for a in arguments)
    about_to(what)
    try:
        with np.errstate(all="ignore"):
            result = function(*given)
    except Exception as error:
        home = getattr(getattr(function, "__code__", None), "co_filename", "")
        line = last_line(error, home)
        place = f" in line {line}" if line else ""
        said = (str(error).splitlines() or [""])[0]
        raise ValueError(f"{what} fails{place}: {type(error).__name__}: {said}; mend it there") from error
    if result is None:
        raise ValueError(f"{what} returns nothing; end it with return")
    try:
        is_complex = np.iscomplexobj(result)
        values = np.array(np.real(result) if is_complex else result, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{what} returns {type(result).__name__}, must return numbers") from error
    if is_complex:
        raise ValueError(f"{what} returns complex numbers, must return real ones")
    names = [v.name for v in like or () if isinstance(v, Variable)]
    shape = () if like is None else (len(like),)
    if values.shape != shape:
        must = "one number" if like is None else f"{len(like)} numbers"
        was = "one number" if values.shape == () else f"an array of shape {values.shape}"
        raise ValueError(f"{what} returns {was}, must return {must}{_listed(names)}")
    wrong = ~np.isfinite(values)
    if wrong.any():
        bad = f" for {names[int(np.argmax(wrong))]}" if names else ""
        raise ValueError(f"{what} returns {values[wrong].flat[0]}{bad} at the nominal values; mend it or move them")
    if any(not np.array_equal(a, b) for a, b in zip(arguments, given, strict=True)):
        raise ValueError(f"{what} changes its arguments; let it work on copies")
    return values


def _listed(names: Sequence[str]) -> str:
    return f" ({', '.join(names)})" if names else ""
