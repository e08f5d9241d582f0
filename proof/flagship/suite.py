"""The whole study: draw, seal, ask blindly, filter with what was mended, judge; resumable, with its tables."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from twinbench.common.cost import foretold, rates_of
from twinbench.common.errors import BadInput
from twinbench.common.progress import Progress
from twinbench.common.store import check_writable, key_of, write_text
from twinbench.common.versions import code_version, provenance
from twinbench.common.workers import side_by_side
from twinbench.data.batch import Batch
from twinbench.data.recording import truth_table
from twinbench.machines.compressor import HEALTH
from twinbench.mismatch.model import load_simulator
from twinbench.proof.concealed.gates import as_markdown
from twinbench.proof.concealed.seal import Sealed, check, seal
from twinbench.proof.flagship.ask import ANSWER, CALIBRATED, MODEL
from twinbench.proof.flagship.gates import WHOLE, draws_table, gate_table, read_draws
from twinbench.proof.flagship.judge import COLUMNS, names, shares
from twinbench.proof.flagship.measure import Errors, at_design_point, at_known_health, errors
from twinbench.proof.flagship.plant import UNKNOWN_SHARE, Item, Plant, draw
from twinbench.proof.flagship.record import HELD_OUT, PROOF, TRAINING, record

KNOWN_HEALTH, SENSORS_ALONE, TOLD = "known_health", "sensors_alone", "told"
ENGINES = (KNOWN_HEALTH, SENSORS_ALONE, TOLD)
"""The same engine, told more or less; each has its own gates. The first reads the health beside the sensors, as the
calibrated model that it is held against does; the second follows the health itself; the third is the first with a
catalogue of true effects alone, which shows how far mending gets without naming."""
DRAW_TIMEOUT_S = 3600.0
RARE_EVERY = 3
DRAWS_TABLE = "draws.csv"
EARLIER_DRAWS = Path("results") / "flagship"
"""The study that is asked for what a case costs, where the folder of results does not say it."""
_ROOT = Path(__file__).resolve().parents[2]


def plan(draws: int) -> list[Item]:
    """The cases of so many plants: as it is, with a poorer catalogue, the nominal model; some enriched and loose."""
    items = []
    for number in range(draws):
        rare = ["enriched", "loose"] if number % RARE_EVERY == RARE_EVERY - 1 else []
        items += [Item(cell, number) for cell in ("plain", "left_out", "nominal", *rare)]
    return items


def run(
    draws: int,
    seed: int,
    out: Path,
    console: Console,
    engines: Sequence[str] = (KNOWN_HEALTH,),
    jobs: int = 0,
    command: str = "",
) -> pd.DataFrame:
    """Write ``draws.csv``, ``draws.md``, ``gates.csv``, ``gates_ENGINE.md`` and ``manifest.json`` into ``out``.

    A case that an earlier run finished with the same code is kept.

    Args:
        engines: some of ENGINES.
        jobs: processes; as many as there are cores if 0.

    Returns:
        The gate table of the first engine.

    Raises:
        BadInput: no draw at all is wanted, an engine is unknown, or ``out`` cannot be written to.
    """
    if draws < 1:
        raise BadInput(f"--draws is {draws}, must be at least 1")
    for engine in engines:
        if engine not in ENGINES:
            raise BadInput(f"engine {engine!r} is not known; choose from {', '.join(ENGINES)}")
    began = time.time()
    out = out.absolute()
    check_writable(out)
    listed = [(item, e) for item in plan(draws) for e in engines if e == KNOWN_HEALTH or item.cell in WHOLE]
    todo = [(item, engine) for item, engine in listed if not _finished(_row_file(out, item, engine), item, seed)]
    if len(todo) < len(listed):
        console.print(f"{len(listed) - len(todo)} of {len(listed)} cases are there from an earlier run")
    rates = rates_of([folder / DRAWS_TABLE for folder in (out, EARLIER_DRAWS)], ("engine", "cell"))
    kinds = [(engine, item.cell) for item, engine in todo]
    console.print(foretold("case", kinds, rates), highlight=False, markup=False, soft_wrap=True)
    several = {f"case {item.name}, {engine}": (item, seed, out, engine) for item, engine in todo}
    with Progress(console) as progress, progress.stage("cases", len(todo)) as going:
        for _ in side_by_side(run_case, several, progress.say, out, jobs):
            going.step()
    return report(out, listed, seed, {"command": command, "wall_s": round(time.time() - began, 1)})


def run_case(item: Item, seed: int, out: Path, engine: str) -> None:
    """One case: publish the seal, ask the engine, and only then write the truth down and judge.

    Until then the truth is in this process's memory alone, and what other cases of the same plant left in
    ``out`` the engine's process cannot open.
    """
    plant = draw(item, seed)
    train, proof, held_out = (record(plant.simulator, part, seed, item.number) for part in (TRAINING, PROOF, HELD_OUT))
    sealed = seal(_truth(item, seed, plant))
    folder = _row_file(out, item, engine).parent
    for old in ("truth.json", "row.json"):  # parts of an earlier attempt must not be taken for this one's
        (folder / old).unlink(missing_ok=True)
    write_text(folder / "seal.json", json.dumps({"case": item.name, "sha256": sealed.digest}))
    with tempfile.TemporaryDirectory(prefix="flagship-") as given:
        verdict = ask(Path(given), train, proof, plant, engine, out)
        models = {n: load_simulator(str(Path(given) / n)) for n in (MODEL, CALIBRATED) if (Path(given) / n).is_file()}
        for name in models:
            write_text(folder / name, (Path(given) / name).read_text())
    write_text(folder / ANSWER, json.dumps(verdict, indent=1))
    write_text(folder / "truth.json", json.dumps({"salt": sealed.salt, "truth": sealed.truth}, indent=1))
    row = {
        "case": item.name,
        "cell": item.cell,
        "number": item.number,
        "engine": engine,
        "truth": "+".join(e.name for e in plant.effects),
        "without": "+".join(plant.without),
        "verdict": verdict["verdict"],
        "seconds": verdict["seconds"],
        **_judged(sealed, folder, verdict),
    }
    if item.cell in (*WHOLE, "loose") and len(models) == 2:
        nominal = (models[CALIBRATED], at_design_point(plant.simulator), at_known_health(train))
        measured: list[Errors] = [errors(m, train, held_out) for m in (plant.simulator, *nominal, models[MODEL])]
        row |= shares(measured[0], measured[1:-1], measured[-1])
    write_text(folder / "row.json", json.dumps({"key": _key(item, seed), "row": row}))


def ask(folder: Path, train: Batch, held_out: Batch, plant: Plant, engine: str, keep_out: Path) -> dict[str, Any]:
    """The engine's verdict on recordings in a folder of its own, from a process of its own."""
    told_health = engine != SENSORS_ALONE
    for batch in (train, held_out):
        assert batch.truth is not None
        for i, name in enumerate(batch.names):
            table = truth_table(batch.without_truth(), i)
            if told_health:
                table[list(HEALTH)] = batch.truth.health[i]
            table.to_csv(folder / f"{name}.csv", index=False, float_format="%.8g")
    case = {
        "train": train.names,
        "held_out": held_out.names,
        "health": told_health,
        "without": plant.without,
        "only": [e.name for e in plant.effects] if engine == TOLD else [],
        "constants": plant.constants,
        "tolerance": UNKNOWN_SHARE / np.sqrt(3.0),
    }
    (folder / "case.json").write_text(json.dumps(case))
    began = time.perf_counter()
    try:
        subprocess.run(
            [sys.executable, "-P", "-m", "twinbench.proof.flagship.ask", str(folder), str(keep_out)],
            cwd=_ROOT,
            check=True,
            timeout=DRAW_TIMEOUT_S,
            capture_output=True,
            text=True,
        )
        return dict(json.loads((folder / ANSWER).read_text()))
    except (subprocess.TimeoutExpired, subprocess.CalledProcessError) as error:
        said = (error.stderr or str(error)).strip().splitlines()[-1]
        return {"verdict": "failed", "says": said, "findings": [], "seconds": time.perf_counter() - began}


def report(out: Path, listed: Sequence[tuple[Item, str]], seed: int, facts: Mapping[str, Any]) -> pd.DataFrame:
    """Write the tables of finished cases; the first engine's gates."""
    files = [_row_file(out, item, engine) for item, engine in listed]
    rows = [json.loads(file.read_text())["row"] for file in files]
    write_text(out / DRAWS_TABLE, pd.DataFrame(rows, columns=list(COLUMNS)).to_csv(index=False))
    table = read_draws(out / DRAWS_TABLE)
    engines = list(dict.fromkeys(engine for _, engine in listed))
    gates = {engine: gate_table(table[table["engine"] == engine]) for engine in engines}
    write_text(out / "gates.csv", pd.concat([g.assign(engine=e) for e, g in gates.items()]).to_csv(index=False))
    for engine in engines:
        write_text(out / f"gates_{engine}.md", as_markdown(gates[engine]))
    write_text(out / "draws.md", draws_table(table))
    seals = {f.parent.name: json.loads(f.with_name("seal.json").read_text())["sha256"] for f in files}
    manifest = {
        "cases": len(listed),
        "seed": seed,
        "engines": engines,
        "seals": seals,
        "seal": key_of(**seals),
        **facts,
        **provenance(),
    }
    write_text(out / "manifest.json", json.dumps(manifest, indent=2) + "\n")
    return gates[engines[0]]


def _truth(item: Item, seed: int, plant: Plant) -> dict[str, Any]:
    parameters = {v.name: v.nominal for v in plant.simulator.parameters}
    effects = [{"name": e.name, "sizes": {e.parameter: [e.true, e.absent]}} for e in plant.effects]
    return {"case": item.name, "seed": seed, "effects": effects, "parameters": parameters}


def _judged(sealed: Sealed, folder: Path, verdict: Mapping[str, Any]) -> dict[str, str]:
    return names(check(sealed, json.loads((folder / "seal.json").read_text())["sha256"]), verdict)


def _row_file(out: Path, item: Item, engine: str) -> Path:
    return out / "cases" / f"{item.name}-{engine}" / "row.json"


def _finished(file: Path, item: Item, seed: int) -> bool:
    try:
        return bool(json.loads(file.read_text())["key"] == _key(item, seed))
    except (OSError, ValueError, KeyError):
        return False


def _key(item: Item, seed: int) -> str:
    """What a row depends on: the case, the seed, the study's and the engine's code."""
    parts = ("plant", "record", "measure", "judge", "ask")
    return key_of(case=item.name, seed=seed, code=[code_version(f"twinbench.proof.flagship.{part}") for part in parts])
