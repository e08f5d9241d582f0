"""Does a simulator, does a mechanism keep its word? Each function is called once at the nominal state.

The plain Python functions are called, nothing is compiled: a mistake is told by the line it is in.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from physics.simulator import Array, Mechanism, Simulator, Variable, index_of

_TRIAL_S = 10.0
_TRIAL_SAMPLES = 50


def check_simulator(simulator: Simulator) -> None:
    """Call ``rhs`` (or ``flux`` and ``balance``), ``output`` and ``initial`` once, and look at what they return.

    Raises:
        ValueError: one line; a function raises, or returns another length, no numbers, or NaN.
    """
    who = f"simulator {simulator.name!r}"
    _check_records(simulator, who)
    x, u, y = (_nominal(v) for v in (simulator.states, simulator.inputs, simulator.outputs))
    theta = simulator.theta()
    n = simulator.states
    _call(simulator.output, (x, u, theta), simulator.outputs, f"{who}: output(x, u, theta)")
    _call(simulator.initial, (u, y, theta), n, f"{who}: initial(u0, y0, theta)")
    if simulator.rhs is not None:
        _call(simulator.rhs, (x, u, theta), n, f"{who}: rhs(x, u, theta)")
    if simulator.flux is not None and simulator.balance is not None:
        f = _call(simulator.flux, (x, u, theta), simulator.fluxes, f"{who}: flux(x, u, theta)")
        _call(simulator.balance, (x, u, theta, f), n, f"{who}: balance(x, u, theta, f)")


def check_mechanism(simulator: Simulator, mechanism: Mechanism) -> None:
    """See that the port exists, and call the term, the derivative or the series once.

    Raises:
        ValueError: one line that names the mechanism and what is wrong with it.
    """
    who = f"mechanism {mechanism.name!r}"
    kind, _, target = mechanism.port.partition(":")
    ports = {
        "balance": simulator.states, "flux": simulator.fluxes,
        "output": simulator.outputs, "input": simulator.inputs,
    }  # fmt: skip
    if kind not in ports or not target:
        raise ValueError(f"{who}: port {mechanism.port!r} must read {', '.join(f'{k}:NAME' for k in ports)}")
    index_of(ports[kind], target, f"{who}: simulator {simulator.name!r} has no {kind}")
    if mechanism.kind not in ("physics", "sensor", "input"):
        raise ValueError(f"{who}: kind is {mechanism.kind!r}, must be physics, sensor or input")
    if not mechanism.parameters:
        raise ValueError(f"{who}: has no parameters; the first is its size")
    if mechanism.term is not None and mechanism.series is not None:
        raise ValueError(f"{who}: has a term and a series; give one")
    if bool(mechanism.states) != (mechanism.derivative is not None):
        raise ValueError(f"{who}: states and derivative go together; give both or neither")
    if mechanism.initial is not None and not mechanism.states:
        raise ValueError(f"{who}: has initial but no states; give both or leave it out")
    own = _nominal(mechanism.parameters)
    if mechanism.series is not None:
        if kind not in ("output", "input"):
            raise ValueError(f"{who}: a series acts on an output or an input, not on {mechanism.port!r}")
        time_s = np.linspace(0.0, _TRIAL_S, _TRIAL_SAMPLES)
        values = np.full(_TRIAL_SAMPLES, ports[kind][[v.name for v in ports[kind]].index(target)].nominal)
        _call(mechanism.series, (time_s, values, own), values.tolist(), f"{who}: series(time_s, values, theta)")
    elif mechanism.term is not None:
        x = np.concatenate((_nominal(simulator.states), _nominal(mechanism.states)))
        arguments = (x, _nominal(simulator.inputs), np.concatenate((simulator.theta(), own)))
        _call(mechanism.term, arguments, None, f"{who}: term(x, u, theta)")
        if mechanism.derivative is not None:
            _call(mechanism.derivative, arguments, mechanism.states, f"{who}: derivative(x, u, theta)")
        if mechanism.initial is not None:
            _call(mechanism.initial, arguments, mechanism.states, f"{who}: initial(x0, u0, theta)")
    else:
        for variable in mechanism.parameters:
            index_of(
                simulator.parameters, variable.name,
                f"{who}: has no term and no series, so its parameters are the simulator's; there is no",
            )  # fmt: skip
        if len(mechanism.absent) != len(mechanism.parameters):
            raise ValueError(
                f"{who}: absent has {len(mechanism.absent)} values for {len(mechanism.parameters)} "
                "parameters; give the value of each that switches it off"
            )


def _check_records(simulator: Simulator, who: str) -> None:
    kinds = ("states", "inputs", "outputs", "parameters", "fluxes")
    for kind in kinds:
        if not all(isinstance(v, Variable) for v in getattr(simulator, kind)):
            raise ValueError(f"{who}: {kind} must be a tuple of Variables")
    for kind in ("states", "outputs"):
        if not getattr(simulator, kind):
            raise ValueError(f"{who}: has no {kind}; at least one is needed")
    for kind in ("outputs", "parameters"):
        names = {v.name for v in getattr(simulator, kind)}
        other = "inputs" if kind == "outputs" else "states"
        if both := [v.name for v in getattr(simulator, other) if v.name in names]:
            raise ValueError(f"{who}: {both[0]!r} is the name of one of its {other} and of its {kind}; rename one")
    for kind in kinds:
        for v in getattr(simulator, kind):
            if not np.isfinite(v.nominal):
                raise ValueError(f"{who}: nominal of {v.name!r} is {v.nominal}; give a number")


def _nominal(variables: Sequence[Variable]) -> Array:
    return np.array([v.nominal for v in variables], dtype=np.float64)


def _call(function: Callable[..., Any], arguments: tuple[Array, ...], like: Sequence[Any] | None, what: str) -> Array:
    """The result of one call: as many finite numbers as ``like`` has entries, or one number if that is None."""
    function = getattr(function, "py_func", function)
    given = tuple(a.copy() for a in arguments)
    try:
        with np.errstate(all="ignore"):
            result = function(*given)
    except Exception as error:
        home = getattr(getattr(function, "__code__", None), "co_filename", "")
        lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == home]
        place = f" in line {lines[-1]}" if lines else ""
        said = (str(error).splitlines() or [""])[0]
        raise ValueError(f"{what} fails{place}: {type(error).__name__}: {said}; mend it there") from error
    if result is None:
        raise ValueError(f"{what} returns nothing; end it with return")
    try:
        values = np.asarray(result, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{what} returns {type(result).__name__}, must return numbers") from error
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
