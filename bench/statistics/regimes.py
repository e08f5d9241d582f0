"""What a machine is going through at each tick: its operating point, and what has just changed."""

from __future__ import annotations

import numpy as np

from twinbench.bench.statistics.tracking import health_changes
from twinbench.data.batch import Array, Batch, Truth
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.machine import Machine

AFTER_HEALTH_S = 120.0
"""A change of health counts as fresh until so long after it is done: filters follow within a minute or two. Longer
dilutes what is hard with what is not."""
AFTER_LOAD_S = 60.0
"""The same for a change of load. The benchmark's loads hold for one to four minutes: with two minutes hardly any time
would be steady, with half a minute half of it is."""
HELD = 1e-6
"""Speed and valve are held where they move by less than this share of their value from one tick to the next. Ramps move
them by at least a thousandth of it; round-off is a millionth of a millionth."""


def splits_of(machine: Machine) -> dict[str, str]:
    """By name, what a machine's recordings are split into thirds by."""
    return dict(machine.regimes) or {name: name for name in machine.inputs}


def regimes_of(machine: Machine) -> dict[str, str]:
    """Every regime and what it is; the thirds are those of the whole split's samples, and the last four are a division
    of its own."""
    words = {name: _in_words(machine, along) for name, along in splits_of(machine).items()}
    moving = [machine.label(name) for name in machine.commands or machine.inputs]
    return {
        "all": "all samples",
        **{
            f"{name}_{part}": f"{which} third of {says}"
            for name, says in words.items()
            for part, which in (("low", "lowest"), ("middle", "middle"), ("high", "highest"))
        },
        "after_health": f"while a health parameter changes and {AFTER_HEALTH_S / 60:g} minutes after",
        "after_load": f"otherwise, while {' or '.join(moving)} move and {AFTER_LOAD_S / 60:g} minute after",
        "steady_before": "otherwise, before health has changed at all",
        "steady_after": "otherwise, once it has",
    }


def _in_words(machine: Machine, along: str) -> str:
    if along == "p_dis_bar/p_suc_bar":
        return "pressure ratio"
    return " over ".join(machine.label(name) for name in along.split("/"))


REGIMES = regimes_of(COMPRESSOR)
"""Those of the compressor."""

Changes = list[list[tuple[float, float]]]
"""Of each sequence, start and end of every change of health, seconds."""


def changes_of(truth: Batch, names: tuple[str, ...]) -> Changes:
    """The changes of health of some simulated sequences."""
    assert truth.truth is not None
    rows = (truth.truth.health[truth.names.index(name)] for name in names)
    return [[(c.start_s, c.end_s) for c in health_changes(truth.machine, truth.time_s, health)] for health in rows]


def regimes(machine: Machine, time_s: Array, truth: Truth, changes: Changes) -> dict[str, np.ndarray]:
    """Masks (B, M) of the samples in each of ``regimes_of``.

    Args:
        machine: whose.
        time_s: (M,) seconds, the stored ticks.
        truth: at those ticks, as ``truth_at`` gives it.
        changes: as ``changes_of`` gives them.
    """
    channels = np.concatenate([truth.inputs, truth.outputs], axis=-1)
    masks = {"all": np.ones(channels.shape[:2], dtype=bool)}
    for name, along in splits_of(machine).items():
        values = machine.along(along, channels)
        first, second = np.quantile(values, [1 / 3, 2 / 3])
        masks |= {
            f"{name}_low": values <= first,
            f"{name}_middle": (first < values) & (values <= second),
            f"{name}_high": second < values,
        }
    fresh, done = (np.zeros(channels.shape[:2], dtype=bool) for _ in range(2))
    for b, own in enumerate(changes):
        for start_s, end_s in own:
            fresh[b] |= (start_s <= time_s) & (time_s < end_s + AFTER_HEALTH_S)
            done[b] |= end_s + AFTER_HEALTH_S <= time_s
    moved = _since_moved(machine, time_s, truth.inputs) < AFTER_LOAD_S
    masks["after_health"] = fresh
    masks["after_load"] = ~fresh & moved
    masks["steady_before"] = ~fresh & ~moved & ~done
    masks["steady_after"] = ~fresh & ~moved & done
    return masks


def _since_moved(machine: Machine, time_s: Array, inputs: Array) -> Array:
    """(B, M) seconds since a command last moved; inf where none has."""
    held = inputs[..., [machine.inputs.index(name) for name in machine.commands or machine.inputs]]
    moves = np.zeros(held.shape[:2], dtype=bool)
    moves[:, 1:] = (np.abs(np.diff(held, axis=1)) > HELD * np.abs(held[:, 1:])).any(axis=-1)
    last_s = np.maximum.accumulate(np.where(moves, time_s, -np.inf), axis=1)
    return time_s - last_s
