"""A simulator's equations as object files: numba's machine code, which a C compiler links and no Python runs."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

from llvmlite import binding
from numba import carray, njit, types

from twinbench.physics.compile import Compiled, compiled
from twinbench.physics.fmu import calls
from twinbench.physics.simulator import Simulator

_NUMBERS = types.CPointer(types.float64)
ENTRY = types.void(_NUMBERS, _NUMBERS, _NUMBERS, _NUMBERS)
"""``entry(x, u, theta, out)``, where the numbers of each lie one behind the other."""

_WITHOUT_PYTHON: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Leave out the functions by which Python calls, which need Python."""


def object_files(simulator: Simulator) -> dict[str, bytes]:
    """Object files by the name of the one function that each offers: ``twinbench_rates`` and ``twinbench_readings``.

    They are position-independent and for any processor of this machine's kind.

    Raises:
        ValueError: one line: the equations run as plain Python only, are an FMU's, or hold addresses of this process.
    """
    who = f"simulator {simulator.name!r}"
    equations = _compiled(simulator)
    entries = {
        "twinbench_rates": _entry(equations.rhs, simulator, len(simulator.states)),
        "twinbench_readings": _entry(equations.output, simulator, len(simulator.outputs)),
    }
    return {name: _object_file(name, entry, who) for name, entry in entries.items()}


def _compiled(simulator: Simulator) -> Compiled:
    said = f"simulator {simulator.name!r} runs as plain Python"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            equations = compiled(simulator)
    except RuntimeWarning as warning:
        said, equations = str(warning), None
    if equations is None or not equations.native:
        raise ValueError(f"{said}; an FMU holds machine code only, so mend that first")
    return equations


def _entry(function: Callable[..., Any], simulator: Simulator, count: int) -> Any:
    """An equation with ``count`` results behind C's own arrays, compiled."""
    n_x, n_u, n_theta = (len(group) for group in (simulator.states, simulator.inputs, simulator.parameters))

    @njit(ENTRY, error_model="numpy", **_WITHOUT_PYTHON)
    def entry(x, u, theta, out):  # type: ignore[no-untyped-def]
        values = function(carray(x, (n_x,)), carray(u, (n_u,)), carray(theta, (n_theta,)))
        for i in range(count):
            out[i] = values[i]

    return entry


def _object_file(name: str, entry: Any, who: str) -> bytes:
    made = entry.get_compile_result(ENTRY)
    text = made.library.get_llvm_str()
    if calls.SYMBOL in text:
        raise ValueError(f"{who}: is an FMU, whose machine code is not ours to pass on; mend it where it was made")
    if made.library.has_dynamic_globals:
        raise ValueError(
            f"{who}: its equations hold an address of this process (a large array, or a function of another library); "
            "write what they need into them"
        )
    module = binding.parse_assembly(text)
    module.get_function(made.fndesc.llvm_func_name).name = name
    target = binding.Target.from_triple(module.triple)
    return bytes(target.create_target_machine(reloc="pic", codemodel="default", opt=2).emit_object(module))
