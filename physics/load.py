"""Find a simulator or a catalogue by name, in a file, or in a package; and see that its functions fit."""

from __future__ import annotations

import contextlib
import difflib
import importlib
import importlib.util
import os
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from twinbench.common.filespec import USER_FILE, spec_of_file, split_spec
from twinbench.common.trial import about_to, tried
from twinbench.physics.check import check_mechanism, check_simulator, last_line
from twinbench.physics.fmu.as_simulator import simulator_of
from twinbench.physics.simulator import Mechanism, Simulator

Held = TypeVar("Held")

BUILTIN = {"compressor": "twinbench.physics.compressor:PLANT", "nominal": "twinbench.physics.nominal:NOMINAL"}
"""Simulators that are named without a file."""
BUILTIN_CATALOGUE = "twinbench.physics.mechanisms:CATALOGUE"


def load_simulator(spec: str) -> Simulator:
    """A simulator by name, from ``path/to/file.py[:NAME]``, ``package.module:NAME`` or ``path/to/machine.fmu``.

    A file that holds one Simulator needs no NAME.

    Raises:
        ValueError: one line; no such simulator, its file fails to import, or its functions do not fit.
    """
    if spec in BUILTIN:
        return _simulator(BUILTIN[spec])
    # Elsewhere first: whatever it does, this process goes on.
    tried(lambda: _checked(spec), spec)
    return _simulator(spec)


def _checked(spec: str) -> None:
    simulator = _simulator(spec)
    try:
        check_simulator(simulator)
    except ValueError as error:
        raise ValueError(f"{spec}: {error}") from error


def _simulator(where: str) -> Simulator:
    """The one that a spec names, as it is."""
    if where.endswith(".fmu"):
        about_to("loading it")
        return simulator_of(where)
    return held(where, Simulator, tuple(BUILTIN))


def held(where: str, kind: type[Held], known: Sequence[str]) -> Held:
    """The record that ``path/to/file.py[:NAME]`` or ``package.module:NAME`` holds, as it is.

    Args:
        where: the spec.
        kind: of what class it is.
        known: names that would do without a file, for the message.

    Raises:
        ValueError: one line; no such file, it fails to import, or it holds no such record.
    """
    word = kind.__name__
    module, name = _module_of(where)
    if module is None:
        near = difflib.get_close_matches(where, known, n=1)
        hint = f"did you mean {near[0]!r}?" if near else "give path/to/file.py[:NAME] or package.module:NAME."
        raise ValueError(f"no {word.lower()} {where!r}; {hint} Known by name: {', '.join(known)}")
    found = {n: v for n, v in vars(module).items() if isinstance(v, kind)}
    if name:
        if name not in found:
            raise ValueError(f"{where}: has no {word} {name!r}; it has: {', '.join(found) or 'none'}")
        return found[name]
    if not found:
        raise ValueError(f"{where}: holds no {word}; write NAME = {word}(...) at its top level")
    first, record = next(iter(found.items()))
    if any(other is not record for other in found.values()):
        raise ValueError(f"{where}: holds {word}s {', '.join(found)}; name one, like {where}:{first}")
    return record


def load_catalogue(spec: str, simulator: Simulator) -> tuple[Mechanism, ...]:
    """A user's mechanisms from ``path/to/file.py[:NAME]``, each tried once on the simulator.

    NAME is a tuple or list of Mechanisms; left out it is CATALOGUE, or else every Mechanism that
    stands at the file's top level. Those that are switched on in the simulator already are left out.

    Raises:
        ValueError: one line; no such file or name, no mechanism, or one that does not fit the simulator.
    """
    tried(lambda: _check_mechanisms(spec, simulator), spec)
    return _mechanisms(spec, simulator)


def _check_mechanisms(spec: str, simulator: Simulator) -> None:
    mechanisms = _mechanisms(spec, simulator)
    try:
        check_catalogue(simulator, mechanisms)
    except ValueError as error:
        raise ValueError(f"{spec}: {error}") from error


def _mechanisms(spec: str, simulator: Simulator) -> tuple[Mechanism, ...]:
    """Those that a spec names and the simulator does not have yet, as they are."""
    module, name = _module_of(spec)
    if module is None:
        raise ValueError(f"no catalogue {spec!r}; give the path of a .py file with Mechanisms in it")
    inside = vars(module)
    if name and name not in inside:
        offered = ", ".join(n for n, v in inside.items() if _are_mechanisms(v)) or "none"
        raise ValueError(f"{spec}: has no {name!r}; tuples of Mechanisms in it: {offered}")
    if name or "CATALOGUE" in inside:
        listed = inside[name or "CATALOGUE"]
        listed = (listed,) if isinstance(listed, Mechanism) else listed
        if not _are_mechanisms(listed):
            raise ValueError(f"{spec}: {name or 'CATALOGUE'} must be a tuple or list of Mechanisms")
        mechanisms = tuple(listed)
    else:
        mechanisms = tuple({id(v): v for v in inside.values() if isinstance(v, Mechanism)}.values())
    if not mechanisms:
        raise ValueError(f"{spec}: holds no Mechanism; write CATALOGUE = (Term(...), ...), or Amplitude or Series")
    return tuple(m for m in mechanisms if m.name not in simulator.mechanisms)


def check_catalogue(simulator: Simulator, mechanisms: Sequence[Mechanism]) -> None:
    """See that each mechanism fits the simulator, and that no name stands for two.

    Raises:
        ValueError: one line that names the mechanism.
    """
    owners = {v.name: f"simulator {simulator.name!r}" for v in simulator.states + simulator.parameters}
    names: set[str] = set()
    for mechanism in mechanisms:
        if mechanism.name in names:
            raise ValueError(f"mechanism {mechanism.name!r}: is there twice; rename one")
        names.add(mechanism.name)
        check_mechanism(simulator, mechanism)
        for variable in mechanism.brings:
            if variable.name in owners:
                raise ValueError(
                    f"mechanism {mechanism.name!r}: its {variable.name!r} is also a name of "
                    f"{owners[variable.name]}; rename one"
                )
            owners[variable.name] = f"mechanism {mechanism.name!r}"


def builtin_catalogue(simulator: Simulator) -> tuple[Mechanism, ...]:
    """The compressor's catalogue where the simulator has all its amplitudes, else nothing."""
    module, name = _module_of(BUILTIN_CATALOGUE)
    mechanisms: tuple[Mechanism, ...] = getattr(module, name)
    names = {v.name for v in simulator.parameters}
    return mechanisms if all(v.name in names for m in mechanisms for v in m.parameters) else ()


def _are_mechanisms(what: Any) -> bool:
    return isinstance(what, tuple | list) and bool(what) and all(isinstance(m, Mechanism) for m in what)


def _module_of(spec: str) -> tuple[ModuleType | None, str]:
    """The imported file or package of a spec, and the NAME after its colon; None where it names neither."""
    file, wanted = split_spec(spec)
    if file.endswith(".py"):
        return _import_file(Path(file)), wanted
    name, colon, wanted = spec.partition(":")
    if not colon or not re.fullmatch(r"\w+(\.\w+)*", name):
        return None, ""
    if "" not in sys.path and str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))  # the installed command does not look where it is called
    return _guarded(lambda: importlib.import_module(name), spec, ""), wanted


def _import_file(path: Path) -> ModuleType:
    if not os.path.isfile(path):
        raise ValueError(f"no file {path}; check the path")
    name = USER_FILE + path.stem
    spec = spec_of_file(name, path)
    if spec is None or spec.loader is None:
        raise ValueError(f"{path}: is no Python module; give the path of a .py file")
    module = importlib.util.module_from_spec(spec)
    loader = spec.loader
    sys.modules[name] = module
    _guarded(lambda: loader.exec_module(module), str(path), str(spec.origin))
    return module


def _guarded(load: Callable[[], Any], where: str, file: str) -> Any:
    """Import something of a user's; whatever goes wrong in it becomes one line with the place in ``file``."""
    about_to("importing it")
    try:
        with contextlib.redirect_stdout(sys.stderr):  # what a file prints must not get into our output
            return load()
    except (Exception, SystemExit) as error:
        if isinstance(error, SyntaxError) and error.filename == file:
            number, said = error.lineno, error.msg
        else:
            number, said = last_line(error, file), (str(error).splitlines() or [""])[0]
        line = f", line {number}" if file and number else ""
        raise ValueError(f"{where}{line}: fails to import: {type(error).__name__}: {said}; mend it there") from error
