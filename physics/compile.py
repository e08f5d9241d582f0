"""Compile a simulator's equations once; run them as plain Python where numba cannot."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba.core.errors import NumbaError, UnsupportedBytecodeError

from twinbench.physics.compose import plain_rhs
from twinbench.physics.jit import equation
from twinbench.physics.simulator import Simulator


class Compiled(NamedTuple):
    """A simulator's equations, ready for the loops of ``physics.integrate``."""

    rhs: Callable[..., Any]
    output: Callable[..., Any]
    native: bool  # False: plain Python, because numba could not compile them


@functools.cache
def compiled(simulator: Simulator) -> Compiled:
    """Compile ``rhs`` and ``output``; a function numba refuses still works, slowly, with a warning."""
    rhs, output = plain_rhs(simulator), simulator.output
    try:
        return Compiled(equation(rhs), equation(output), True)
    except (NumbaError, UnsupportedBytecodeError) as error:
        reason = str(error).strip().splitlines()[0]
        warnings.warn(
            f"simulator {simulator.name!r} runs as plain Python, some 100 times slower: numba says {reason}",
            RuntimeWarning,
            stacklevel=2,
        )
        return Compiled(_python(rhs), _python(output), False)


def _python(function: Callable[..., Any]) -> Callable[..., Any]:
    def call(x: Any, u: Any, theta: Any) -> Any:
        return np.asarray(function(x, u, theta), dtype=np.float64)

    return call
