"""Machine code that is loaded, not compiled just now: the two are not the same to the last bit.

Where numba compiles, each function is made machine code by itself, and callers are linked to that. What it leaves for
the next process is each caller in one piece with all that it calls, where sums may be in another order.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba.core.event import install_recorder

from twinbench.common.workers import in_new_process


def with_loaded_code(work: Callable[..., Any], *arguments: Any) -> Any:
    """Do the work; if anything was compiled meanwhile, do it again in a new process, which finds that code.

    Args:
        work: a function of a module, which leaves nothing behind.
        arguments: its own.
    """
    with install_recorder("numba:compile") as compiled:
        found = work(*arguments)
    return in_new_process(work, *arguments) if compiled.buffer else found
