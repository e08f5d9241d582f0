"""What a run will cost, told before it starts: what each training and evaluation took in an earlier run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from twinbench.bench.cells import Cell
from twinbench.bench.earlier import read_earlier
from twinbench.bench.profile import Profile
from twinbench.bench.registry import find
from twinbench.bench.roster import ABLATION
from twinbench.common.errors import BadInput
from twinbench.common.store import Store
from twinbench.machines.compressor import COMPRESSOR

REFERENCE = Path("results") / "paper"
"""The run whose costs are asked where the folder of results knows none."""
STAGES = {"fit": "training", "estimate": "evaluation"}


@dataclass(frozen=True)
class Known:
    """What an earlier run cost.

    Attributes:
        cpu_s: processor time by estimator and stage, the mean over its seeds.
        profile: of that run, as its manifest has it.
    """

    folder: Path
    cpu_s: Mapping[tuple[str, str], float]
    profile: Mapping[str, Any]

    def of(self, stage: str, cell: Cell, profile: Profile) -> float | None:
        """What a cell's stage will take, in s, if it goes with the number of iterations or recordings; None: unknown.

        An ablation counts as the whole where it has no row of its own.
        """
        names = (cell.estimator, cell.estimator.partition(ABLATION)[0])
        took = next((self.cpu_s[name, stage] for name in names if (name, stage) in self.cpu_s), None)
        if took is None or self.profile.get("machine", COMPRESSOR.name) != profile.machine:
            return None
        try:
            usual = find(cell.spec).settings | self.profile["settings"].get(names[1], {})
            size = _size(stage, self.profile["data"], usual)
            return took / size * _size(stage, asdict(profile)["data"], usual | dict(cell.settings))
        except (LookupError, TypeError, ValueError, ZeroDivisionError):  # the profile of other code, or a damaged one
            return None


def known(folder: Path) -> Known | None:
    """The costs of the run in a folder; None where there is none, or it is damaged."""
    try:
        earlier = read_earlier(folder)
        table = earlier.rows("cost.csv", ())
        means = pd.to_numeric(table["cpu_s"]).groupby([table["estimator"], table["stage"]]).mean().dropna()
        cpu_s = {(str(name), str(stage)): float(s) for (name, stage), s in means.items()}
        return Known(folder, cpu_s, earlier.manifest["profile"])
    except (BadInput, LookupError):
        return None


def foretold(todo: Sequence[Cell], profile: Profile, store: Store, out: Path) -> str:
    """One line: what is to be trained and evaluated, and about how many minutes that takes one core."""
    left = list(_left(todo, store))
    if not left:
        return "to do: nothing is left to train or evaluate"
    counts = {says: sum(stage == name for name, _ in left) for stage, says in STAGES.items()}
    folders = dict.fromkeys([out, REFERENCE])
    sources = [costs for costs in map(known, folders) if costs]
    found = [_first(sources, *part, profile) for part in left]
    line = "to do: " + " and ".join(f"{n} {says}{'s' if n > 1 else ''}" for says, n in counts.items() if n)
    if not any(found):
        return f"{line}; their cost is not known: no cost.csv of them in {' or '.join(map(str, folders))}"
    by = dict.fromkeys(str(costs.folder / "cost.csv") for _, costs in filter(None, found))
    minutes = sum(s for s, _ in filter(None, found)) / 60.0
    about = f"about {minutes:,.0f} core-minutes" if minutes >= 1.5 else "about a core-minute at most"
    line += f", {about} by {' and '.join(by)}"
    return line + (f"; the cost of {found.count(None)} is not known" if None in found else "")


def _first(sources: Sequence[Known], stage: str, cell: Cell, profile: Profile) -> tuple[float, Known] | None:
    """What a part takes, in s, and who says so."""
    said = ((costs.of(stage, cell, profile), costs) for costs in sources)
    return next(((s, costs) for s, costs in said if s is not None), None)


def _left(todo: Sequence[Cell], store: Store) -> Iterator[tuple[str, Cell]]:
    """Each training and evaluation that the store does not hold, once where cells share it."""
    for stage, keys in (("fit", {c.fit: c for c in todo}), ("estimate", {c.estimates: c for c in todo})):
        yield from ((stage, cell) for key, cell in keys.items() if not store.has(stage, key))


def _size(stage: str, data: Mapping[str, float], settings: Mapping[str, Any]) -> float:
    """What a stage's cost goes with: iterations of training, or minutes of recordings."""
    if stage == "fit" and "iterations" in settings:
        return float(settings["iterations"])
    parts = ("n_train",) if stage == "fit" else ("n_test", "n_single", "n_calibration")
    return sum(data[part] for part in parts) * (data["minutes"] - data["warmup_minutes"])
