"""Equations made into machine code, one by one."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, types
from numba.core.errors import NumbaError

from twinbench.common.filespec import USER_FILE

VECTOR = types.Array(types.float64, 1, "C")
EQUATION = VECTOR(VECTOR, VECTOR, VECTOR)
FUNCTION = types.FunctionType(EQUATION)
"""A compiled equation as an argument: loops over equations compile once for all simulators."""


@functools.cache
def jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function compiled on first call; the same function twice compiles once."""
    function = _native(function)
    return function if hasattr(function, "py_func") else njit(error_model="numpy")(function)


def _native(function: Any) -> Any:
    """What to compile: of an equation that ``physics.source`` wrote, the one that calls compiled functions."""
    return function.native() if hasattr(function, "native") else function


class _Argument(types.WrapperAddressProtocol):  # type: ignore[misc]
    """A compiled equation that numba types by its signature alone."""

    def __init__(self, equation: Any) -> None:
        self._equation = equation  # keeps the machine code alive
        made = equation.get_compile_result(EQUATION)
        self._address = made.library.get_pointer_to_function(made.fndesc.llvm_cfunc_wrapper_name)

    def __wrapper_address__(self) -> int:
        return int(self._address)

    def signature(self) -> Any:
        return EQUATION


@functools.cache
def as_argument(equation: Callable[..., Any]) -> Any:
    """An equation of ``compiled`` as an argument for compiled loops without an explicit signature.

    Passed as it is, every equation is a type of its own: each loop would compile again for it, in
    every process.
    """
    return _Argument(equation) if hasattr(equation, "get_compile_result") else equation


def equation(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile to the one signature; a tuple as the result is accepted too."""
    source = _native(function)
    source = getattr(source, "py_func", source)
    # Closures may hold other compiled functions, which the disk cache cannot key; twinbench.physics.native can.
    # A user's file goes by a name of ours here, under which another process would look for it in vain.
    own_file = (source.__module__ or "").startswith(USER_FILE)
    cache = source.__closure__ is None and not source.__code__.co_filename.startswith("<") and not own_file
    try:
        return njit(EQUATION, error_model="numpy", cache=cache)(source)
    except NumbaError:
        inner = jit(function)

        def as_array(x: Any, u: Any, theta: Any) -> Any:
            return np.array(inner(x, u, theta))

        return njit(EQUATION, error_model="numpy")(as_array)
