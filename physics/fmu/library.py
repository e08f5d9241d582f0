"""An FMU's binary, loaded: instances of it, and the table by which compiled code finds them."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twinbench.common.jobs import cores
from twinbench.physics.fmu import calls
from twinbench.physics.fmu.description import Description, Scalar
from twinbench.physics.fmu.unpack import binary

NAMES = {
    "2": (
        "SetReal", "GetReal", "SetContinuousStates", "GetDerivatives", "Reset", "SetupExperiment",
        "EnterInitializationMode", "ExitInitializationMode", "EnterEventMode", "NewDiscreteStates",
        "EnterContinuousTimeMode", "GetContinuousStates", "DoStep",
    ),
    "3": (
        "SetFloat64", "GetFloat64", "SetContinuousStates", "GetContinuousStateDerivatives", "Reset", "",
        "EnterInitializationMode", "ExitInitializationMode", "EnterEventMode", "UpdateDiscreteStates",
        "EnterContinuousTimeMode", "GetContinuousStates", "DoStep",
    ),
}  # fmt: skip
"""FMI's names of ``calls.FUNCTIONS``, by version."""
OF_ALL = ("SetReal", "GetReal", "SetFloat64", "GetFloat64", "Reset", "SetupExperiment", "EnterInitializationMode")
"""Those that an FMU for co-simulation is asked for, too."""
TO_STEP = ("ExitInitializationMode", "DoStep")
"""And those of one that has to be stepped; ``calls`` has their places."""
LOG = {
    "2": ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p),
    "3": ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p),
}


class _Callbacks(ctypes.Structure):
    """What FMI 2 wants to call back."""

    _fields_ = (
        ("logger", LOG["2"]), ("allocate", ctypes.c_void_p), ("free", ctypes.c_void_p),
        ("step_finished", ctypes.c_void_p), ("environment", ctypes.c_void_p),
    )  # fmt: skip


_LOADED: list[Library] = []
"""Compiled code has their addresses, so they stay until the process ends."""


class Library:
    """An FMU in this process.

    Attributes:
        key: by which compiled code finds it.
        says: what it logged last.
    """

    def __init__(self, description: Description, folder: Path, key: int, chosen: tuple[Sequence[Scalar], ...]) -> None:
        """Load it, instantiate it, and register it.

        Args:
            chosen: its inputs, outputs and parameters as the simulator has them.

        Raises:
            ValueError: one line: the binary does not load, lacks a function, or makes no instance.
        """
        self.key, self.says = key, ""
        file = binary(description, folder)
        try:
            self._library = ctypes.CDLL(str(file))
        except OSError as error:
            raise ValueError(f"its binary does not load: {error}") from None
        self._prefix, self._version = f"fmi{description.version}", description.version
        self._log = LOG[description.version](lambda *said: self._note(said[-1]))
        count = 1 if description.once else cores() + 1
        handles = [self._instance(description, folder, k) for k in range(count)]
        self._instances = count
        groups = (description.states, description.rates, *chosen)
        self._references = [np.array([v.reference for v in group], np.uint32) for group in groups]
        self._table = self._tabled(description, handles)
        place = len(_LOADED)
        if place == calls.MOST_FMUS:
            raise ValueError(f"is FMU number {place + 1} of this process, which may hold {calls.MOST_FMUS}")
        calls.REGISTRY[place] = key, self._table.ctypes.data
        _LOADED.append(self)

    def noted(self, place: int) -> bool:
        """Has ``calls`` noted this in the table?"""
        return bool(self._table[place])

    def set_time(self, time_s: float) -> None:
        """Tell all instances that are ready another time; for co-simulation they begin anew then."""
        if not self._table[calls.EXCHANGE]:
            self._table.view(np.float64)[calls.BEGINS] = time_s
            self._rows()[:, calls.READY] = 0
            return
        function = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_double)(self._address("SetTime"))
        for row in self._rows():
            if row[calls.READY]:
                function(int(row[calls.HANDLE]), time_s)

    def steps(self, states: Sequence[Scalar]) -> None:
        """Make it ready to be stepped, from these start states.

        Raises:
            ValueError: one line: the binary lacks a function.
        """
        self._references[0] = np.array([v.reference for v in states], np.uint32)
        self._table[calls.OF_STATES] = self._references[0].ctypes.data
        self._table[calls.STATES] = len(states)
        for name in TO_STEP:
            self._table[calls.SET_REALS + NAMES[self._version].index(name)] = self._address(name)
        self._rows()[:, calls.READY] = 0

    def _rows(self) -> np.ndarray:
        return self._table[calls.HEAD :].reshape(self._instances, -1)

    def _note(self, said: bytes | None) -> None:
        self.says = (said or b"").decode(errors="replace").strip()

    def _address(self, name: str) -> int:
        if not name:
            return 0
        try:
            function = getattr(self._library, self._prefix + name)
        except AttributeError:
            raise ValueError(f"its binary lacks {self._prefix}{name}; export it for model exchange") from None
        return ctypes.cast(function, ctypes.c_void_p).value or 0

    def _instance(self, description: Description, folder: Path, number: int) -> int:
        name, token = f"twinbench_{number}".encode(), description.token.encode()
        resources, empty = folder / "resources", ctypes.c_void_p(None)
        given: tuple[object, ...]
        if self._version == "2":
            make = self._library.fmi2Instantiate
            libc = ctypes.CDLL(None) if os.name != "nt" else ctypes.cdll.msvcrt
            parts = (ctypes.cast(part, ctypes.c_void_p).value for part in (libc.calloc, libc.free))
            self._callbacks = _Callbacks(self._log, *parts, None, None)
            given = (
                name,
                int(not description.exchange),
                token,
                resources.as_uri().encode(),
                ctypes.byref(self._callbacks),
                0,
                0,
            )
        else:
            where = f"{resources}{os.sep}".encode()
            no, none = ctypes.c_bool(False), ctypes.c_size_t(0)
            if description.exchange:
                make = self._library.fmi3InstantiateModelExchange
                given = (name, token, where, no, no, empty, self._log)
            else:
                make = self._library.fmi3InstantiateCoSimulation
                given = (name, token, where, no, no, no, no, empty, none, empty, self._log, empty)
        make.restype = ctypes.c_void_p
        handle = make(*given)
        if not handle:
            raise ValueError(f"makes no instance of itself{f': {self.says}' if self.says else ''}")
        return int(handle)

    def _tabled(self, description: Description, handles: Sequence[int]) -> np.ndarray:
        """Head and rows as ``calls`` has them, in words."""
        sizes = [len(references) for references in self._references[2:]]
        head = np.zeros(calls.HEAD, np.int64)
        exchange = bool(description.exchange)
        head[: calls.OF_STATES] = (
            int(self._version), exchange, len(handles), len(description.states), *sizes, description.indicators
        )  # fmt: skip
        head[calls.OF_STATES : calls.SET_REALS] = [references.ctypes.data for references in self._references]
        names = [name if name in OF_ALL or (exchange and name != "DoStep") else "" for name in NAMES[self._version]]
        head[calls.SET_REALS : calls.SET_REALS + len(names)] = [self._address(name) for name in names]
        rows = np.zeros((len(handles), calls.THETA + sizes[2]), np.int64)
        rows[:, calls.HANDLE] = handles
        return np.concatenate((head, rows.ravel()))
