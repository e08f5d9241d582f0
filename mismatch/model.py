"""The door for simulators and catalogues, and ``model.toml``: a mended simulator that every command takes again.

A mended simulator is a base, the mechanisms switched on in it, and parameter values::

    base = "tanks.py:TANKS"
    inputs = "linear"  # between samples in lines; "held", or left out: each value holds until the next

    [[mechanisms]]
    name = "overflow@level1_m"
    from = "generic"

    [values]
    k1 = 0.0504  # m**0.5/s

Paths in it are relative to the file itself. ``base`` and ``from`` run the Python that they name, ``mismatch.trust``
says whose. What a user gave and cannot be used is ``BadInput`` from here on.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from twinbench.common.errors import BadInput
from twinbench.common.filespec import moved
from twinbench.common.shown import shown
from twinbench.common.toml_file import read_toml
from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.faults import faults
from twinbench.mismatch.trust import Trust
from twinbench.physics import load
from twinbench.physics.check import check_mechanism
from twinbench.physics.compose import compose, with_mechanism
from twinbench.physics.simulator import Mechanism, Series, Simulator, Term, Variable

MOST_BASES = 20
"""Bases of bases. Each round of mending adds one; what is deeper was not made by mending."""
MOST_LISTED = 12
"""Mechanisms that a message names."""
LONGEST_PERIOD_S = 86400.0
"""Between samples. Lags and delays are bounded by so many samples, and a model.toml does not say how far those lie
apart: with longer ones it would be refused what it may hold."""
_ROUNDING_SLACK = 1e-6  # of a parameter's range, by which rounding may carry a value beyond it
_BARE = re.compile(r"[A-Za-z0-9_-]+")

_SHELVES: dict[str, Callable[[Simulator], tuple[Mechanism, ...]]] = {
    "builtin": load.builtin_catalogue,
    "generic": generic,
    "faults": faults,
}
"""Where our own mechanisms come from."""


@dataclass(frozen=True)
class Model:
    """A simulator, and the faults of its sensors and inputs that no differential equation can hold.

    The faults' fitted sizes are their parameters' nominal values. ``inputs`` between samples are "held" or "linear",
    as the file says; empty if nobody said.
    """

    simulator: Simulator
    faults: tuple[Series, ...] = ()
    inputs: str = ""


def load_simulator(spec: str, trust: bool = False) -> Simulator:
    """A simulator by name, ``path/to/file.py[:NAME]``, ``package.module:NAME`` or ``path/to/model.toml``.

    Args:
        spec: one of these; a name is one of ``twinbench list simulators``.
        trust: run the Python that a ``model.toml`` names wherever it lies.

    Raises:
        BadInput: no such simulator, its file fails to import, or its functions do not fit.
    """
    return load_model(spec, trust).simulator


def load_model(spec: str, trust: bool = False) -> Model:
    """As ``load_simulator``, with the faults that a ``model.toml`` holds.

    Raises:
        BadInput: as there, or the file is no model, or does not fit its base, or names Python that lies elsewhere.
    """
    with as_bad_input():
        if spec.endswith(".toml"):
            return _read(Path(spec), Trust.of(Path(spec), trust), ())
        return Model(load.load_simulator(spec))


def made_of(spec: str) -> Iterator[str]:
    """The specs that a simulator is made of: its own, and of a ``model.toml`` its base and its mechanisms' sources."""
    yield spec
    if spec.endswith(".toml"):
        content = _content(Path(spec))
        for below in (content["base"], *(entry["from"] for entry in content["mechanisms"])):
            yield from made_of(moved(below, Path(spec).parent, Path.cwd()))


def load_catalogue(spec: str, simulator: Simulator) -> tuple[Mechanism, ...]:
    """A user's mechanisms from ``path/to/file.py[:NAME]``, which join those that we have for the simulator.

    Args:
        spec: the file and, where it holds several, the name in it.
        simulator: that they have to fit.

    Raises:
        BadInput: no such file, a mechanism that does not fit, or a name that one of ours has.
    """
    with as_bad_input():
        mechanisms = load.load_catalogue(spec, simulator)
    taken = {name for m in whole_catalogue(simulator) for name in _names(m)}
    for mechanism in mechanisms:
        if twice := [name for name in _names(mechanism) if name in taken]:
            raise BadInput(
                f"{spec}: mechanism {mechanism.name!r}: our own catalogue has a {twice[0]!r} too; rename yours"
            )
    return mechanisms


def whole_catalogue(
    simulator: Simulator, own: Sequence[Mechanism] = (), sample_period_s: float = 0.05
) -> tuple[Mechanism, ...]:
    """Everything that may be missing: what we know of machines of its kind, of any machine and sensor, and yours.

    What is switched on in the simulator already is not missing.

    Raises:
        BadInput: the simulator's equations move it at a rate that no machine has.
    """
    # What is known of this kind of machine says the same in its own words, and more exactly.
    with as_bad_input():
        physics = load.builtin_catalogue(simulator) or generic(simulator)
    known = (*physics, *faults(simulator, sample_period_s), *own)
    there = {v.name for v in simulator.states + simulator.parameters}
    return tuple(m for m in known if m.name not in simulator.mechanisms and there.isdisjoint(_names(m)[1:]))


def model_toml(
    base: str,
    simulator: Simulator,
    mechanisms: Sequence[Mechanism],
    values: Mapping[str, float],
    folder: Path,
    catalogue: str = "",
    inputs: str = "",
) -> str:
    """The text of ``folder/model.toml``.

    Args:
        base: the spec of the simulator that was mended.
        simulator: that simulator itself.
        mechanisms: what was found, physics and faults.
        values: by name, every calibrated parameter and those of the mechanisms, in their units.
        catalogue: where mechanisms that are not ours come from, as given to ``load_catalogue``.
        inputs: how they go between samples, "held" or "linear"; nothing is said of it if left out.

    Raises:
        ValueError: a mechanism of no catalogue, an unknown parameter, or a value that is no finite number.
    """
    lines = [
        "# A mended simulator: every command that takes a simulator takes this file.",
        f"base = {_quoted(moved(base, Path.cwd(), folder))}",
        *([f"inputs = {_quoted(inputs)}"] if inputs else []),
    ]
    units = {v.name: v.unit for v in simulator.parameters}
    for mechanism in mechanisms:
        source = _source_of(mechanism, simulator) or moved(catalogue, Path.cwd(), folder)
        if not source:
            raise ValueError(f"mechanism {mechanism.name!r} is in no catalogue; name the file it comes from")
        lines += [
            "",
            "[[mechanisms]]",
            f"name = {_quoted(mechanism.name)}",
            f"from = {_quoted(source)}",
            *(f"# {line}" for line in mechanism.says.splitlines()),
        ]
        units |= {v.name: v.unit for v in mechanism.parameters}
    lines += ["", "[values]"]
    for name, value in values.items():
        if name not in units:
            raise ValueError(f"value of {name!r}: neither the simulator nor a mechanism has that parameter")
        if not math.isfinite(value):
            raise ValueError(f"value of {name!r} is {value}, must be a finite number")
        key = name if _BARE.fullmatch(name) else _quoted(name)
        lines.append(f"{key} = {float(value)!r}  # {units[name]}".rstrip(" #"))
    return "\n".join(lines) + "\n"


def _read(path: Path, trust: Trust, above: tuple[Path, ...]) -> Model:
    """What the file says of its base; ``above`` are the files whose base it is."""
    content = _content(path)
    if path.resolve() in above:
        raise ValueError(f"{path}: is its own base; name the simulator that was mended")
    if len(above) >= MOST_BASES:
        raise ValueError(f"{above[0]}: has more than {MOST_BASES} bases below it; name the simulator that was mended")
    below = moved(content["base"], path.parent, Path.cwd())
    if below.endswith(".toml"):
        base = _read(Path(below), trust, (*above, path.resolve()))
    else:
        trust.check(below)
        try:
            base = Model(load.load_simulator(below))
        except ValueError as error:
            raise ValueError(f"{path}: base: {error}") from error
    simulator, known = base.simulator, list(base.faults)
    sources = {e["from"]: moved(e["from"], path.parent, Path.cwd()) for e in content["mechanisms"]}
    shelves = {}
    for name, source in sources.items():
        try:
            shelves[name] = _shelf(source, simulator, trust)
        except ValueError as error:
            raise ValueError(f"{path}: from = {shown(name)}: {error}") from error
    terms = []
    for entry in content["mechanisms"]:
        offered = {m.name: m for m in shelves[entry["from"]]}
        if entry["name"] not in offered:
            listed = _some(offered)
            raise ValueError(f"{path}: {entry['from']} has no mechanism {entry['name']!r}; it has: {listed}")
        mechanism = offered[entry["name"]]
        check_mechanism(base.simulator, mechanism)
        match mechanism:
            case Series():
                known.append(mechanism)
            case Term():
                terms.append(mechanism)
            case _:
                simulator = with_mechanism(simulator, mechanism)
    if terms:
        named = replace(simulator, mechanisms=(*simulator.mechanisms, *(m.name for m in terms)))
        simulator = compose(named, tuple(terms))
    values = content["values"]
    own = {v.name for v in simulator.parameters}
    _check_values(path, values, _settable(base.simulator, simulator, (*terms, *known)))
    return Model(
        simulator.with_values(**{name: value for name, value in values.items() if name in own}),
        tuple(replace(m, parameters=tuple(_with_value(v, values) for v in m.parameters)) for m in known),
        content["inputs"] or base.inputs,
    )


def _settable(base: Simulator, simulator: Simulator, mechanisms: Sequence[Term | Series]) -> dict[str, Variable]:
    """What values may be given, with the bounds that they have to keep.

    Args:
        base: what ``simulator`` is made of, beside the mechanisms.
    """
    found = {v.name: v for v in (*simulator.parameters, *(v for m in mechanisms for v in m.parameters))}
    found |= {m.parameters[0].name: _from_absence(m) for m in mechanisms}
    mended = mechanisms or base.mechanisms
    ours = (*(generic(base) if mended else ()), *faults(base, LONGEST_PERIOD_S))
    return found | {v.name: v for m in ours for v in _roomy(m, base) if v.name in found}


def _from_absence(mechanism: Mechanism) -> Variable:
    """Its size, with all that lies between its absence and its bounds."""
    size = mechanism.parameters[0]
    return replace(size, low=min(size.low, mechanism.off), high=max(size.high, mechanism.off))


def _roomy(mechanism: Mechanism, simulator: Simulator) -> list[Variable]:
    """Parameters of one of our mechanisms, with all that a fit may find: it sizes them anew for its recordings.

    Thresholds may lie wherever their channel goes. A fault's size keeps its bounds, and all else keeps its sign.
    """
    size, *shape = mechanism.parameters
    channels = (*simulator.states, *simulator.fluxes, *simulator.outputs, *simulator.inputs)
    units = {v.unit for v in channels if v.name == mechanism.port.variable}
    first = _of_one_sign(size) if mechanism.kind == "physics" else _from_absence(mechanism)
    return [first, *(_anywhere(v) if v.unit in units and v.low != 0.0 else _of_one_sign(v) for v in shape)]


def _of_one_sign(v: Variable) -> Variable:
    return replace(v, low=0.0 if v.low >= 0.0 else -math.inf, high=0.0 if v.high <= 0.0 else math.inf)


def _anywhere(v: Variable) -> Variable:
    return replace(v, low=-math.inf, high=math.inf)


def _check_values(path: Path, values: Mapping[str, float], known: Mapping[str, Variable]) -> None:
    """Refuse values of unknown parameters, and those that lie outside the bounds of known ones."""
    for name, value in values.items():
        if name not in known:
            raise ValueError(f"{path}: [values] has {shown(name)}, which is no parameter of this model; remove it")
        low, high = known[name].low, known[name].high
        slack = _ROUNDING_SLACK * (high - low if math.isfinite(high - low) else abs(value))
        if not low - slack <= value <= high + slack:
            raise ValueError(
                f"{path}: [values] {name} = {value:g} lies outside its bounds, {low:g} to {high:g}; "
                "mend it, or the bounds where the parameter is defined"
            )


def _content(path: Path) -> dict[str, Any]:
    """What the file says, checked and complete."""
    if not os.path.isfile(path):
        raise ValueError(f"no file {path}; check the path")
    raw = read_toml(path)
    base, mechanisms, values = raw.pop("base", None), raw.pop("mechanisms", []), raw.pop("values", {})
    inputs = raw.pop("inputs", "")
    if not isinstance(base, str) or raw:
        raise ValueError(
            f"{path}: is no model; it must hold base, [[mechanisms]] and [values], may hold inputs, and nothing else"
        )
    if inputs not in ("", "held", "linear"):
        raise ValueError(f'{path}: inputs is {shown(inputs)}, must be "held" or "linear"')
    for entry in mechanisms if isinstance(mechanisms, list) else [None]:
        if (
            not isinstance(entry, dict)
            or set(entry) != {"name", "from"}
            or not all(isinstance(value, str) for value in entry.values())
        ):
            raise ValueError(f"{path}: each of [[mechanisms]] must hold two texts, name and from")
    names = [entry["name"] for entry in mechanisms]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ValueError(f"{path}: mechanism {shown(twice[0])} is there twice; remove one")
    if not isinstance(values, dict):
        raise ValueError(f"{path}: [values] must be a table of numbers")
    numbers = {k: _number(v, path) for k, v in values.items()}
    return {"base": base, "inputs": inputs, "mechanisms": mechanisms, "values": numbers}


def _number(value: object, path: Path) -> float:
    number = math.nan
    if isinstance(value, int | float) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):  # TOML's whole numbers have as many figures as they like
            number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{path}: [values] must hold numbers only; {shown(value)} is none")
    return number


def _shelf(source: str, simulator: Simulator, trust: Trust) -> tuple[Mechanism, ...]:
    if source in _SHELVES:
        return _SHELVES[source](simulator)
    trust.check(source)
    return load.load_catalogue(source, simulator)


def _source_of(mechanism: Mechanism, simulator: Simulator) -> str:
    found = (name for name, shelf in _SHELVES.items() if mechanism.name in {m.name for m in shelf(simulator)})
    return next(found, "")


def _names(mechanism: Mechanism) -> list[str]:
    """What must not stand for two things: its name, and those of the variables that it brings."""
    return [mechanism.name, *(v.name for v in mechanism.brings)]


def _with_value(variable: Variable, values: Mapping[str, float]) -> Variable:
    value = values.get(variable.name, variable.nominal)
    return replace(variable, nominal=value, low=min(variable.low, value), high=max(variable.high, value))


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)  # a basic string of TOML is written like one of JSON


def _some(names: Mapping[str, object]) -> str:
    listed = list(names)
    return (", ".join(listed[:MOST_LISTED]) or "none") + (", ..." if len(listed) > MOST_LISTED else "")


@contextlib.contextmanager
def as_bad_input() -> Iterator[None]:
    """The one place where the ``ValueError`` of physics, which knows no users, becomes ``BadInput``."""
    try:
        yield
    except BadInput:
        raise
    except ValueError as error:
        raise BadInput(str(error)) from error
