"""The twin of a case: from a package, from a file beside this folder, or from a network's description."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from twinbench.mismatch.model import load_simulator
from twinbench.physics.simulator import Mechanism, Simulator
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


def left(catalogue: Sequence[Mechanism], without: Sequence[str]) -> tuple[Mechanism, ...]:
    """The catalogue less some names, and less what can become one of them: it is the same thing in a wider form."""
    out = set(without)
    families = {m.contains or m.name for m in catalogue if m.name in out}
    return tuple(m for m in catalogue if m.name not in out and (m.contains or m.name) not in families)
