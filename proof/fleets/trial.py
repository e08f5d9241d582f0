"""One fleet: what is said of it, beside what its verdicts say side by side, silence, and the ideal observer."""

from __future__ import annotations

import json
import tempfile
import time
from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from twinbench.common.store import key_of, write_text
from twinbench.common.versions import code_version
from twinbench.mismatch.fleet.asking import requests
from twinbench.mismatch.fleet.examine import examined
from twinbench.mismatch.fleet.verdict import Fleet
from twinbench.mismatch.report.explain import Request
from twinbench.proof.fleets.drawn import draw, write
from twinbench.proof.fleets.observer import Observed, observed
from twinbench.proof.kept import kept

ROOT = Path(__file__).resolve().parents[2]
WAYS = ("fleet", "verdicts side by side", "nobody is accused", "ideal observer")
"""Who says something of a fleet. Each machine's own verdict costs nothing more; to say that all is well, nothing."""
_CODE = ("twinbench.proof.fleets.trial", "twinbench.mismatch")


class Plan(NamedTuple):
    """Which fleets are drawn: from which seed, of how many machines, how many of them odd."""

    seed: int
    machines: int
    odd: int


def judged(fleet: int, plan: Plan, out: Path) -> None:
    """Ask one fleet and keep what was said, unless an earlier run did with the same code."""
    path = place(fleet, out)
    key = key_of(fleet=fleet, plan=list(plan), code=[code_version(m) for m in _CODE])
    if kept(path, key) is None:
        began = time.monotonic()
        rows = _judged(fleet, plan)
        write_text(path, json.dumps({"key": key, "seconds": round(time.monotonic() - began, 1), **rows}, indent=1))


def place(fleet: int, out: Path) -> Path:
    """Where a fleet's answers are kept."""
    return out / "fleets" / f"{fleet:03d}.json"


def _judged(fleet: int, plan: Plan) -> dict[str, Any]:
    drawn = draw(fleet, *plan)
    with tempfile.TemporaryDirectory(prefix="fleet-") as given:
        write(drawn, Path(given) / "machines")
        folders = sorted((Path(given) / "machines").iterdir())
        like = Request(str(ROOT / drawn.simulator), (), ())
        found = examined(requests(folders, like), Path(given) / "found").fleet
    seen = observed(drawn)
    said = {
        "fleet": _row([c.name for c in found.common if c.named], {o.machine: _own(o.effects) for o in found.odd}),
        "verdicts side by side": side_by_side(found),
        "nobody is accused": _row([], {}),
        "ideal observer": _row([drawn.shared] if seen.names else [], dict.fromkeys(seen.found, drawn.own)),
    }
    return {
        "fleet": fleet,
        "shared": drawn.shared,
        "class": list(seen.same),
        "own": drawn.own,
        "odd": list(drawn.odd),
        "machines": list(drawn.machines),
        "said": said,
        "odds": dict(found.odds),
        "says": found.says,
        "alike": {c.name: list(c.alike) for c in found.common if c.named},
        "observed": _numbers(seen),
    }


def _row(named: Collection[str], accused: dict[str, str]) -> dict[str, Any]:
    return {"named": sorted(named), "accused": accused}


def _own(effects: Sequence[tuple[str, float]]) -> str:
    return effects[0][0] if effects else ""


def _numbers(seen: Observed) -> dict[str, Any]:
    sqs = {name: round(sq, 1) for name, sq in seen.odd_sq.items()}
    return {"shared_sq": round(seen.shared_sq, 1), "told_sq": round(seen.told_sq, 1), "odd_sq": sqs}


def side_by_side(fleet: Fleet) -> dict[str, Any]:
    """Names that most verdicts have are shared; a machine is accused whose verdict has other names than is usual."""
    names = {
        machine: frozenset(f["mechanism"] for f in said.document["findings"] if f["mechanism"])
        for machine, said in fleet.machines.items()
    }
    counts = Counter(name for these in names.values() for name in these)
    most = [name for name, count in counts.items() if 2 * count > len(names)]
    usual = Counter(names.values()).most_common(1)[0][0]
    return _row(most, {machine: min(these - usual, default="") for machine, these in names.items() if these != usual})
