"""No process outlives the one that it works for, however that one ends. Standard library alone."""

from __future__ import annotations

import os
import threading
import time

LOOK_S = 0.5
"""How often a process looks whether its parent is still there: so long it may outlive it."""


def end_with_parent(parent: int | None = None) -> None:
    """From now on this process ends soon after its parent has, even if that was killed.

    Args:
        parent: the parent's process id; None: whoever it is now.
    """
    parent = os.getppid() if parent is None else parent

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(LOOK_S)
        os._exit(1)

    # Windows keeps naming a parent that has gone; there this sees nothing.
    threading.Thread(target=watch, name="watches its parent", daemon=True).start()
