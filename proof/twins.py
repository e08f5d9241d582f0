"""The twin of a case: from a package, from a file beside this folder, or from a network's description."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from twinbench.mismatch.model import load_simulator
from twinbench.physics.simulator import Simulator
from twinbench.proof.lumped.twin import LUMPED, twin_of

ROOT = Path(__file__).resolve().parents[1]
"""Holds ``examples/``, in a checkout and in a wheel."""


def simulator_of(where: str, network: Mapping[str, Any]) -> Simulator:
    """The simulator, the same one whenever it is asked for, so that it is compiled once.

    Args:
        where: ``package.module:NAME``, ``folder/file.py:NAME``, or LUMPED.
        network: in the last case, what ``Network.to_json`` wrote.
    """
    return twin_of(network) if where == LUMPED else _loaded(where)


@cache
def _loaded(where: str) -> Simulator:
    return load_simulator(str(ROOT / where) if ".py" in where else where)
