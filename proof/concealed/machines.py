"""The concealed machines by name: those written by hand, and those drawn at random from a seed."""

from __future__ import annotations

from twinbench.proof.concealed.compressor import MACHINE as COMPRESSOR
from twinbench.proof.concealed.heat_exchanger import MACHINE as HEAT_EXCHANGER
from twinbench.proof.concealed.lumped import named, random_machines
from twinbench.proof.concealed.machine import Machine
from twinbench.proof.concealed.motor import MACHINE as MOTOR
from twinbench.proof.concealed.tanks import MACHINE as TANKS

MACHINES = {m.name: m for m in (COMPRESSOR, MOTOR, TANKS, HEAT_EXCHANGER)}
"""Those written by hand."""
AT_RANDOM = 24
"""Machines drawn for a suite: six of each domain."""


def machines(seed: int, random: int = AT_RANDOM) -> dict[str, Machine]:
    """All by name; the same seed gives the same random ones.

    Args:
        random: how many are drawn.
    """
    return MACHINES | random_machines(seed, random)


def machine_of(name: str, seed: int) -> Machine:
    """One of them; no other is drawn for it."""
    return MACHINES[name] if name in MACHINES else named(name, seed)
