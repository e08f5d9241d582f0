"""Is a verdict the same when the simulator is an FMU, and how long does it take?

    python -m twinbench.proof.fmu_verdicts --out results/fmu

Concealed tanks and motors are recorded: sound ones, and ones with an effect of severity 1. The engine diagnoses each
twice: with the simulator as a Python file, and with the FMU that ``twinbench fmu`` writes of it. Both are told the
same. An FMU has no shared flows, so the Python file goes without them. Times are processor time of one thread, the
compiled code already there.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
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
from twinbench.mismatch import diagnose  # noqa: E402
from twinbench.mismatch.recordings import read_recordings  # noqa: E402
from twinbench.physics.compose import plain_rhs  # noqa: E402
from twinbench.physics.fmu import as_simulator  # noqa: E402
from twinbench.physics.fmu.write import write_fmu  # noqa: E402
from twinbench.physics.simulator import Simulator  # noqa: E402
from twinbench.proof.command import refusing  # noqa: E402
from twinbench.proof.concealed.generate import Item, draw, write  # noqa: E402
from twinbench.proof.concealed.machines import MACHINES  # noqa: E402
from twinbench.proof.twins import simulator_of  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
AS_BOTH = ("two_tanks", "motor")
SEVERITY = 1.0
COLUMNS = ("machine", "effect", "verdict", "named", "same_verdict", "furthest_size_pct", "python_s", "fmu_s", "ratio")


def twins(spec: str, values: dict[str, float], calibrate: Sequence[str], folder: Path) -> tuple[Simulator, Simulator]:
    """A twin as Python and as FMU, told the same."""
    found = simulator_of(spec, {}).with_values(**values)
    plain = replace(
        found, rhs=plain_rhs(found), fluxes=(), flux=None, balance=None, calibrate=tuple(calibrate), drifts=()
    )
    write_fmu(plain, folder / "twin.fmu")
    return plain, replace(
        as_simulator.simulator_of(folder / "twin.fmu"), calibrate=plain.calibrate, drifts=plain.drifts
    )


def compared(machine: str, effects: tuple[str, ...], seed: int) -> dict[str, Any]:
    """A row of COLUMNS."""
    item = Item("fmu", "mechanism" if effects else "clean", machine, effects, SEVERITY)
    case = draw(item, seed, MACHINES, observed=False)
    public = case.public
    answers = []
    with tempfile.TemporaryDirectory(prefix="fmu-") as given:
        write(case, Path(given))
        for twin in twins(public["simulator"], public["values"], public["calibrate"], Path(given)):
            files = [Path(given) / f"{name}.csv" for name in (*public["train"], *public["held_out"])]
            recordings = read_recordings(files, twin)
            fitted, held = recordings[: len(public["train"])], recordings[len(public["train"]) :]
            diagnose(twin, fitted, hold_out=held)  # what is compiled for this machine is compiled now
            began = time.process_time()
            verdict = diagnose(twin, fitted, hold_out=held).to_dict()
            answers.append((time.process_time() - began, verdict))
    (python_s, by_python), (fmu_s, by_fmu) = answers
    return {
        "machine": machine,
        "effect": "+".join(effects),
        "verdict": by_python["verdict"],
        "named": "+".join(_named(by_python)),
        "same_verdict": by_python["verdict"] == by_fmu["verdict"] and _named(by_python) == _named(by_fmu),
        "furthest_size_pct": _apart(by_python, by_fmu),
        "python_s": python_s,
        "fmu_s": fmu_s,
        "ratio": fmu_s / python_s,
    }


def summary(table: pd.DataFrame) -> str:
    """What a page shows: a row for each machine."""
    lines = [
        "| machine | cases | same verdict | FMU, in times of Python: median | at most |",
        "|---|---:|---:|---:|---:|",
    ]
    for machine, rows in table.groupby("machine", sort=False):
        same, ratio = int(rows["same_verdict"].sum()), rows["ratio"]
        lines.append(f"| {machine} | {len(rows)} | {same} | {ratio.median():.2f} | {ratio.max():.2f} |")
    return "\n".join(lines) + "\n"


def _named(verdict: dict[str, Any]) -> list[str]:
    return sorted(f["mechanism"] or f["port"] for f in verdict["findings"])


def _apart(one: dict[str, Any], other: dict[str, Any]) -> float:
    """How far the two verdicts' calibrated parameters are from each other at most, in per cent."""
    pairs = ((one["parameters"][name]["after"], other["parameters"][name]["after"]) for name in one["parameters"])
    return max((100.0 * abs(a - b) / max(abs(a), abs(b), sys.float_info.min) for a, b in pairs), default=0.0)


@refusing("twinbench.proof.fmu_verdicts")
def main(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m twinbench.proof.fmu_verdicts", description=__doc__)
    parser.add_argument("--seed", type=int, default=7, help="of the machines")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "fmu", help="for the tables")
    asked = parser.parse_args(arguments)
    out = asked.out.absolute()
    check_writable(out)
    cases = [(name, effects) for name in AS_BOTH for effects in ((), *((e.name,) for e in MACHINES[name].effects))]
    rows = []
    with Progress(Console(stderr=True)) as progress, progress.stage("cases", len(cases)) as going:
        for name, effects in cases:
            rows.append(compared(name, effects, asked.seed))
            going.step()
    table = pd.DataFrame(rows, columns=list(COLUMNS)).round(
        {"furthest_size_pct": 6, "python_s": 2, "fmu_s": 2, "ratio": 2}
    )
    write_text(out / "verdicts.csv", table.to_csv(index=False))
    write_text(out / "verdicts.md", summary(table))
    write_manifest(out, f"python -m twinbench.proof.fmu_verdicts --seed {asked.seed}", asked.seed)
    print(table.to_string(index=False))
    return 0


if __name__ == "__main__":
    sys.exit(main())
