"""Find a machine by name or in a file, and see that it fits before anything is done with it."""

from __future__ import annotations

import functools
import os
from pathlib import Path

from twinbench.common.errors import BadInput
from twinbench.common.filespec import split_spec
from twinbench.common.trial import tried
from twinbench.machines.check import check_machine
from twinbench.machines.machine import Machine
from twinbench.physics.load import held

__all__ = ["BUILTIN", "check_machine", "load_machine", "machine_at"]

BUILTIN = {
    "compressor": "twinbench.machines.compressor:COMPRESSOR",
    "two_tanks": "twinbench.machines.two_tanks:TWO_TANKS",
    "motor": "twinbench.machines.motor:MOTOR",
}
"""Machines that are named without a file, and where they are; each is imported when it is asked for."""


def load_machine(spec: str) -> Machine:
    """A machine by name, from ``path/to/file.py[:NAME]`` or from ``package.module:NAME``, tried before it is used.

    A file that holds one Machine needs no NAME.

    Raises:
        BadInput: one line; no such machine, its file fails to import, or ``check_machine`` refuses it.
    """
    if spec not in BUILTIN:
        try:
            tried(lambda: _checked(spec), spec)  # elsewhere first: whatever it does, this process goes on
        except ValueError as error:
            raise BadInput(str(error)) from error
    return machine_at(spec)


def machine_at(spec: str) -> Machine:
    """As ``load_machine``, untried: for a process whose parent has tried it. One spec is one object.

    Raises:
        BadInput: one line; no such machine, or its file fails to import.
    """
    file, _ = split_spec(spec)
    try:
        return _machine(spec, Path(file).read_bytes() if os.path.isfile(file) else b"")
    except (OSError, ValueError) as error:
        raise BadInput(str(error)) from error


@functools.lru_cache(maxsize=8)
def _machine(spec: str, content: bytes) -> Machine:
    """Of each content of its file one: a second one would have its equations compiled again."""
    return held(BUILTIN.get(spec, spec), Machine, tuple(BUILTIN))


def _checked(spec: str) -> None:
    machine = machine_at(spec)
    try:
        check_machine(machine)
    except ValueError as error:
        raise ValueError(f"{spec}: {error}") from error
