"""The concealed machines with recordings short enough for tests."""

from __future__ import annotations

from dataclasses import replace

from twinbench.data.scenario import stream
from twinbench.proof.concealed.machine import Machine
from twinbench.proof.concealed.machines import MACHINES
from twinbench.proof.concealed.severity import Take, Yardstick

SHORT = {
    name: replace(m, seconds={"train": (0.2 * m.seconds["train"][0],) * 3, "held": (0.2 * m.seconds["held"][0],)})
    for name, m in MACHINES.items()
}


def measured(machine: Machine, seed: int = 8) -> Yardstick:
    """A yardstick on a nominal machine: two recordings to learn from and one held out."""
    lengths = {"train_1": machine.seconds["train"][0], "train_2": machine.seconds["train"][0]}
    lengths["held_1"] = machine.seconds["held"][0]
    takes = [
        Take(name, 1000.0 * i, machine.operate(stream(seed, machine.name, name), seconds, name.partition("_")[0]))
        for i, (name, seconds) in enumerate(lengths.items())
    ]
    return Yardstick(machine, takes, machine.p(exponent=2.0))
