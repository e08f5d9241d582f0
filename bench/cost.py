"""What a run or a comparison will cost, told before it starts, by what its parts took in an earlier run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from twinbench.bench.cells import Cell
from twinbench.bench.manifest import read_manifest
from twinbench.bench.profile import Profile
from twinbench.bench.registry import find
from twinbench.bench.results import cost_of
from twinbench.bench.roster import ABLATION
from twinbench.common.cost import in_words
from twinbench.common.errors import BadInput
from twinbench.common.store import Store
from twinbench.machines.compressor import COMPRESSOR

COST_TABLE = "cost.csv"
REFERENCE = Path("results") / "paper"
"""The run whose costs are asked where the folder of results knows none."""
STAGES = {"fit": "training", "estimate": "evaluation"}


def foretold(todo: Sequence[Cell], profile: Profile, store: Store, out: Path) -> str:
    """One line: what is to be trained and evaluated, and about how many minutes that takes one core."""
    # Cells that share a part have it made once.
    parts = {("fit", cell.fit): cell for cell in todo} | {("estimate", cell.estimates): cell for cell in todo}
    left = [(stage, cell) for (stage, key), cell in parts.items() if not store.has(stage, key)]
    if not left:
        return "to do: nothing is left to train or evaluate"
    counts = Counter(STAGES[stage] for stage, _ in left)
    line = "to do: " + " and ".join(f"{n} {says}{'s' if n > 1 else ''}" for says, n in counts.items())
    rates = {folder: _rates(folder, todo, profile.machine) for folder in dict.fromkeys([out, REFERENCE])}
    took_s, unknown = dict[Path, float](), 0
    for stage, cell in left:
        name = stage, _whole(cell)
        by = next((folder for folder in rates if name in rates[folder]), None)
        if by is None:
            unknown += 1
        else:
            took_s[by] = took_s.get(by, 0.0) + rates[by][name] * _size(stage, cell, asdict(profile))
    if not took_s:
        return f"{line}; their cost is not known: no {COST_TABLE} of them in {' or '.join(map(str, rates))}"
    return line + in_words({folder / COST_TABLE: s for folder, s in took_s.items()}, unknown)


def of_comparison(found: Sequence[Cell], profile: Profile, folder: Path, minutes: float) -> str:
    """One line: over how many minutes of recordings estimators are to run, and about how long that takes one core.

    Args:
        profile: with which they were trained, in ``folder``.
        minutes: of the recordings, all together; the run's recordings for calibration come on top.
    """
    data = profile.data
    minutes += data.n_calibration * (data.minutes - data.warmup_minutes)
    rates = _rates(folder, found, profile.machine)
    known = [rates["estimate", _whole(cell)] for cell in found if ("estimate", _whole(cell)) in rates]
    line = f"to do: {len(found)} estimators, each over {minutes:,.0f} min of recordings"
    if not known:
        return f"{line}; the cost is not known: {folder / COST_TABLE} has none of them"
    return line + in_words({folder / COST_TABLE: minutes * sum(known)}, len(found) - len(known))


def _rates(folder: Path, todo: Sequence[Cell], machine: str) -> dict[tuple[str, str], float]:
    """What each stage of an estimator took in the run of a folder, in s of processor time by unit of ``_size``.

    Means over seeds; empty where there is no run of this machine, or it is damaged.
    """
    try:
        profile = read_manifest(folder / "manifest.json")["profile"]
        if profile.get("machine", COMPRESSOR.name) != machine:
            return {}
        table = cost_of(folder)
        took_s = table.groupby(["stage", "estimator"])["cpu_s"].mean().dropna()
        whole = {_whole(cell): cell for cell in todo}
        return {
            (stage, name): s / _size(stage, whole[name], profile)
            for stage, name, s in took_s.reset_index().to_numpy()
            if name in whole
        }
    except (BadInput, LookupError, TypeError, ValueError, ZeroDivisionError):
        return {}


def _whole(cell: Cell) -> str:
    """The estimator; an ablation counts as the whole."""
    return cell.estimator.partition(ABLATION)[0]


def _size(stage: str, cell: Cell, profile: Mapping[str, Any]) -> float:
    """What a stage's cost goes with: iterations of training, or minutes of recordings."""
    settings = find(cell.spec).settings | profile["settings"].get(_whole(cell), {})
    if stage == "fit" and "iterations" in settings:
        return float(settings["iterations"])
    data = profile["data"]
    parts = ("n_train",) if stage == "fit" else ("n_test", "n_single", "n_calibration")
    return float(sum(data[part] for part in parts) * (data["minutes"] - data["warmup_minutes"]))
