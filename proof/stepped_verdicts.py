"""What is told with an FMU that can only be stepped?

    python -m twinbench.proof.stepped_verdicts --out results/fmu/stepped

Concealed tanks are recorded: sound ones, ones with a faulty sensor or input, and ones with an effect in a balance, each
of severity 1. The engine gets the twin as an FMU for co-simulation that does not tell its rates. An effect in a balance
is none of the candidates then. What is named in its place is wrong.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
import zipfile
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
from twinbench.mismatch import diagnose  # noqa: E402
from twinbench.mismatch.model import whole_catalogue  # noqa: E402
from twinbench.mismatch.recordings import read_recordings  # noqa: E402
from twinbench.mismatch.verdict import CONSISTENT, PARAMETERS  # noqa: E402
from twinbench.physics.fmu import as_simulator  # noqa: E402
from twinbench.physics.fmu.write import write_fmu  # noqa: E402
from twinbench.physics.simulator import Simulator  # noqa: E402
from twinbench.proof.command import refusing  # noqa: E402
from twinbench.proof.concealed.faults import faults, parts  # noqa: E402
from twinbench.proof.concealed.generate import Item, draw, write  # noqa: E402
from twinbench.proof.concealed.machines import MACHINES  # noqa: E402
from twinbench.proof.twins import simulator_of  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
MACHINE = "two_tanks"
SOUND = {"clean": 4, "parameters": 4}
"""Sound cases: with the twin's parameters, and with others."""
TWICE = 2
"""Cases of each effect in a balance: a wrong name in its place is what matters most."""
FAULTS = ("bias", "gain", "lag", "delay", "drift", "saturation")
"""Those that are drawn. Sensors that stand still or move in steps are found before anything is weighed."""
SEVERITY = 1.0
KINDS = ("sound", "sensor or input", "balance")
OUTCOMES = ("right", "no name", "wrong name", "nothing")
"""Nothing wrong is told of a sound machine; a fault is named, alone or in a set; of an effect in a balance it is told
that something is there without a name. "Nothing" is told where something is wrong."""
AGREES = (CONSISTENT, PARAMETERS)
"""Verdicts by which nothing is missing."""
COLUMNS = ("case", "kind", "effect", "verdict", "named", "outcome", "seconds")
RATES = r"\s*<ModelExchange\b[^>]*/>|\s*<Derivatives>.*?</Derivatives>| derivative=\"\d+\""


def plan() -> list[Item]:
    """The cases."""
    machine = MACHINES[MACHINE]
    items = [Item(f"{cell}_{k}", cell, MACHINE) for cell, many in SOUND.items() for k in range(many)]
    wrong = [(e.name, e.name, "sensor") for e in faults(machine) if parts(e)[0] in FAULTS]
    wrong += [(f"{e.name}_{k}", e.name, "mechanism") for e in machine.effects for k in range(TWICE)]
    return [*items, *(Item(case, cell, MACHINE, (name,), SEVERITY) for case, name, cell in wrong)]


def only_stepped(spec: str, values: Mapping[str, float], calibrate: Sequence[str], folder: Path) -> Simulator:
    """A twin as an FMU for co-simulation that does not tell its rates."""
    write_fmu(simulator_of(spec, {}).with_values(**values), folder / "whole.fmu")
    with zipfile.ZipFile(folder / "whole.fmu") as whole, zipfile.ZipFile(folder / "twin.fmu", "w") as archive:
        for name in whole.namelist():
            content = whole.read(name)
            if name == "modelDescription.xml":
                content = re.sub(RATES, "", content.decode(), flags=re.S).encode()
            archive.writestr(name, content)
    return replace(as_simulator.simulator_of(folder / "twin.fmu"), calibrate=tuple(calibrate))


def told(item: Item, seed: int) -> dict[str, Any]:
    """A row of COLUMNS."""
    public, tables = (case := draw(item, seed, MACHINES, observed=False)).public, case.tables
    with tempfile.TemporaryDirectory(prefix="stepped-") as given:
        write(case, Path(given))
        twin = only_stepped(public["simulator"], public["values"], public["calibrate"], Path(given))
        recordings = {name: read_recordings([Path(given) / f"{name}.csv"], twin)[0] for name in tables}
        began = time.process_time()
        learnt, held = ([recordings[name] for name in public[part]] for part in ("train", "held_out"))
        verdict = diagnose(twin, learnt, hold_out=held).to_dict()
    offered = {m.name for m in whole_catalogue(twin)}
    kind = KINDS[0] if not item.effects else KINDS[1] if offered.issuperset(item.effects) else KINDS[2]
    named = [{f["mechanism"], *f["indistinguishable_from"]} for f in verdict["findings"] if f["mechanism"]]
    return {
        "case": item.case,
        "kind": kind,
        "effect": "+".join(item.effects),
        "verdict": verdict["verdict"],
        "named": "+".join("|".join(sorted(names)) for names in named),
        "outcome": outcome(kind, item.effects, named, verdict["verdict"]),
        "seconds": time.process_time() - began,
    }


def outcome(kind: str, effects: Sequence[str], named: Sequence[set[str]], verdict: str) -> str:
    """One of OUTCOMES.

    Args:
        named: the names of each finding that has any.
        verdict: its word.
    """
    if named:
        right = kind == "sensor or input" and len(named) == 1 and not named[0].isdisjoint(effects)
        return "right" if right else "wrong name"
    if verdict not in AGREES:
        return "right" if kind == "balance" else "no name"
    return "right" if kind == "sound" else "nothing"


def summary(table: pd.DataFrame) -> str:
    """What a page shows: a row for each kind of case."""
    lines = [f"| what is wrong | cases | {' | '.join(OUTCOMES)} |", f"|---{'|---:' * (1 + len(OUTCOMES))}|"]
    for kind in KINDS:
        rows = table[table["kind"] == kind]
        counts = [int((rows["outcome"] == one).sum()) for one in OUTCOMES]
        lines.append(f"| {kind} | {len(rows)} | {' | '.join(map(str, counts))} |")
    return "\n".join(lines) + "\n"


@refusing("twinbench.proof.stepped_verdicts")
def main(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m twinbench.proof.stepped_verdicts", description=__doc__)
    parser.add_argument("--seed", type=int, default=7, help="of the machines")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "fmu" / "stepped", help="for the tables")
    asked = parser.parse_args(arguments)
    out = asked.out.absolute()
    check_writable(out)
    items, rows = plan(), []
    with Progress(Console(stderr=True)) as progress, progress.stage("cases", len(items)) as going:
        for item in items:
            rows.append(told(item, asked.seed))
            going.step()
    table = pd.DataFrame(rows, columns=list(COLUMNS)).round({"seconds": 2})
    write_text(out / "verdicts.csv", table.to_csv(index=False))
    write_text(out / "verdicts.md", summary(table))
    write_manifest(out, f"python -m twinbench.proof.stepped_verdicts --seed {asked.seed}", asked.seed)
    print(table.to_string(index=False))
    print(summary(table))
    return 0


if __name__ == "__main__":
    sys.exit(main())
