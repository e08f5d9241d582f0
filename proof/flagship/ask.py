"""The engine's own process in the flagship study: it sees a case's folder of recordings and nothing else.

``python -m twinbench.proof.flagship.ask FOLDER KEEP_OUT`` reads ``case.json`` and the recordings in FOLDER and leaves
``answer.json``, ``model.toml`` (the mended nominal model) and ``calibrated.toml`` (the same without what was
found) there. First of all it gives up the right to look into KEEP_OUT, where the study's results are.

The recordings hold sensor columns. Where the engine is told the health, they hold its columns too.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from twinbench.common.orphans import end_with_parent
from twinbench.common.store import write_text
from twinbench.machines.compressor import HEALTH
from twinbench.physics.known_health import with_known_health
from twinbench.physics.simulator import Simulator
from twinbench.proof.blind import conceal

ANSWER, MODEL, CALIBRATED = "answer.json", "model.toml", "calibrated.toml"


def with_constants(simulator: Simulator, names: Sequence[str], tolerance: float) -> Simulator:
    """A simulator with constants that its owner knows to a tolerance only: they are calibrated within it."""
    from twinbench.mismatch.calibrate import PRIOR_SD

    return replace(
        simulator,
        calibrate=(*simulator.calibrate, *names),
        parameters=tuple(
            replace(v, scale=tolerance * v.nominal / PRIOR_SD) if v.name in names else v for v in simulator.parameters
        ),
    )


def answer(folder: Path) -> None:
    """Put the question to the engine and write down what it says."""
    from twinbench.mismatch import diagnose
    from twinbench.mismatch.model import load_simulator, model_toml, whole_catalogue
    from twinbench.mismatch.recordings import read_recordings

    case = json.loads((folder / "case.json").read_text())
    nominal = with_constants(load_simulator("nominal"), case["constants"], case["tolerance"])
    asked = with_known_health(nominal) if case["health"] else nominal
    parts = ([folder / f"{n}.csv" for n in case[part]] for part in ("train", "held_out"))
    train, held_out = (read_recordings(paths, asked) for paths in parts)
    no_sensor = tuple(f"@{name}" for name in HEALTH)  # none reads the health, so none is at fault
    catalogue = [m for m in whole_catalogue(asked) if m.name not in case["without"] and not m.name.endswith(no_sensor)]
    if case["only"]:  # an engine that is told
        catalogue = [m for m in catalogue if m.name in case["only"]]
    began = time.perf_counter()
    verdict = diagnose(asked, train, hold_out=held_out, catalogue=catalogue)
    seconds = time.perf_counter() - began
    before = verdict.diagnosis.before
    calibrated = {
        u.name: float(z) for u, z in zip(before.problem.unknowns, before.z, strict=True) if u.kind == "parameter"
    }
    write_text(folder / MODEL, model_toml("nominal", nominal, verdict.mechanisms, verdict.values, folder))
    write_text(folder / CALIBRATED, model_toml("nominal", nominal, (), calibrated, folder))
    write_text(folder / ANSWER, json.dumps(verdict.to_dict() | {"seconds": seconds}, indent=1))


if __name__ == "__main__":
    end_with_parent()
    conceal([Path(p) for p in sys.argv[2:]])
    answer(Path(sys.argv[1]))
