"""How long a verdict takes on long recordings: ``python -m twinbench.proof.speed`` asks for some, and times them.

Machines are drawn as for the proof, with one effect as large as it commonly is, and recorded for longer. A log that is
read less often is the same recording with rows left out. Times are processor time of one thread, once the compiled
code is there.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from twinbench.common.threads import pin

pin()

import pandas as pd  # noqa: E402  threads are pinned before NumPy is there
from rich.console import Console  # noqa: E402

from twinbench.common.progress import Progress  # noqa: E402
from twinbench.common.store import check_writable, write_text  # noqa: E402
from twinbench.common.versions import write_manifest  # noqa: E402
from twinbench.proof.blind import answer  # noqa: E402
from twinbench.proof.command import refusing  # noqa: E402
from twinbench.proof.concealed.engines import ENGINES  # noqa: E402
from twinbench.proof.concealed.generate import Case, Item, draw, write  # noqa: E402
from twinbench.proof.concealed.machine import Machine  # noqa: E402
from twinbench.proof.concealed.machines import MACHINES  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
EFFECTS = {"compressor": "suction_valve_loss", "motor": "coulomb_friction@omega_rad_s"}
"""The effect that each machine is recorded with. The compressor is stiff, the motor is not."""
MINUTES = {"train": (25.0,) * 4, "held": (25.0,)}
EVERY = (1, 4, 20)
"""Of so many rows one is kept: 20, 5 and 1 a second."""
COLUMNS = ("machine", "effect", "rate_Hz", "recordings", "minutes", "verdict", "named", "seconds")


def measured(machine: Machine, effect: str, minutes: Mapping[str, Sequence[float]], seed: int) -> list[dict[str, Any]]:
    """A row of COLUMNS for each rate.

    Args:
        minutes: length of each recording, of those to learn from (``train``) and those held out (``held``).
    """
    longer = replace(machine, seconds={part: tuple(60.0 * m for m in each) for part, each in minutes.items()})
    item = Item("speed", "mechanism", machine.name, (effect,), severity=1.0, background_pct=0.0)
    case = draw(item, seed, {machine.name: longer}, observed=False)
    _asked(case, EVERY[-1])  # what is compiled for this machine is compiled now
    rows = []
    for every in EVERY:
        seconds, verdict = _asked(case, every)
        rows.append({
            "machine": machine.name,
            "effect": effect,
            "rate_Hz": 1.0 / machine.period_s / every,
            "recordings": len(minutes["train"]),
            "minutes": sum(minutes["train"]),
            "verdict": verdict["verdict"],
            "named": "+".join(f["mechanism"] for f in verdict["findings"] if f["mechanism"]),
            "seconds": seconds,
        })  # fmt: skip
    return rows


def _asked(case: Case, every: int) -> tuple[float, dict[str, Any]]:
    """Seconds of processor time that a verdict takes where one row in so many is kept; the verdict."""
    tables = {name: table.iloc[::every] for name, table in case.tables.items()}
    with tempfile.TemporaryDirectory(prefix="speed-") as folder:
        write(replace(case, tables=tables), Path(folder))
        began = time.process_time()
        verdict = answer(Path(folder), ENGINES["twinbench"])
        return time.process_time() - began, verdict


@refusing("twinbench.proof.speed")
def main(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m twinbench.proof.speed", description=__doc__)
    parser.add_argument("--seed", type=int, default=7, help="of the machines")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "speed", help="for the table")
    asked = parser.parse_args(arguments)
    out = asked.out.absolute()
    check_writable(out)
    rows = []
    with Progress(Console(stderr=True)) as progress, progress.stage("machines", len(EFFECTS)) as going:
        for name, effect in EFFECTS.items():
            rows += measured(MACHINES[name], effect, MINUTES, asked.seed)
            going.step()
    table = pd.DataFrame(rows, columns=list(COLUMNS)).round({"seconds": 1})
    write_text(out / "speed.csv", table.to_csv(index=False))
    command = f"python -m twinbench.proof.speed --seed {asked.seed}"
    write_manifest(out, command, asked.seed)
    print(table.to_string(index=False))
    return 0


if __name__ == "__main__":
    sys.exit(main())
