"""The whole suite: draw, seal, ask blindly, judge; resumable, in parallel, with its tables."""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from joblib import Parallel, delayed
from rich.console import Console

from bench.prove.engine import Engine
from bench.prove.gates import as_markdown, by, gate_table, misses, read_cases
from bench.prove.generate import Item, draw, write
from bench.prove.judge import COLUMNS, score
from bench.prove.plan import cases
from bench.prove.seal import seal
from bench.store import check_writable, key_of, write_text
from bench.versions import code_version, provenance
from data.errors import BadInput

ENGINES = {"twinbench": "mismatch:diagnose"}
ORACLE = "oracle"
"""An engine of this name is told which mechanisms there are, and its gain is what others are held against."""
TIMEOUT_S = 900.0
_ENGINES: dict[str, Engine] = {}
"""This worker's blind process."""


def run(
    n: int, seed: int, out: Path, console: Console, engines: Mapping[str, str] = ENGINES, jobs: int = 0,
    command: str = "",
) -> pd.DataFrame:  # fmt: skip
    """Run n cases on every engine; write ``cases.csv``, ``gates.csv``, ``misses.csv``, ``manifest.json`` into ``out``.

    A case that an earlier run finished with the same code is kept.

    Args:
        engines: by name, "module:function", called as ``mismatch.diagnose``; the oracle first if there is one.
        jobs: processes; as many as there are cores if 0.

    Returns:
        The gate table of the first engine that is not the oracle.

    Raises:
        BadInput: no case at all is wanted, or ``out`` cannot be written to.
    """
    if n < 1:
        raise BadInput(f"--cases is {n}, must be at least 1")
    began = time.time()
    out = out.absolute()
    check_writable(out)
    items = cases(n, seed)
    order = sorted(engines.items(), key=lambda pair: pair[0] != ORACLE)
    todo = [item for item in items if not _finished(out, item, seed, order)]
    if len(todo) < len(items):
        console.print(f"{len(items) - len(todo)} of {len(items)} cases are there from an earlier run")
    work = Parallel(n_jobs=jobs or os.cpu_count() or 1, return_as="generator_unordered")
    from bench.runner import bars

    try:
        with bars(console) as progress:
            task = progress.add_task("cases", total=len(todo))
            for _ in work(delayed(run_case)(item, seed, out, order) for item in todo):
                progress.advance(task)
    finally:
        if engine := _ENGINES.pop(str(out), None):  # this process worked too; a worker's ends with the worker
            engine.close()
    return report(out, items, seed, order, {"command": command, "wall_s": round(time.time() - began, 1)})


def run_case(item: Item, seed: int, out: Path, engines: Sequence[tuple[str, str]]) -> None:
    """One case: draw, publish the seal, ask every engine, and only then write truth and rows down.

    Until then the truth is in this process's memory alone.
    """
    case = draw(item, seed)
    sealed = seal(case.truth)
    folder = out / "cases" / item.case
    # Parts of an earlier attempt must not be taken for this one's.
    for old in folder.glob("row-*.json"):
        old.unlink()
    published = {"case": item.case, "sha256": sealed.digest, "of": "salt, newline, canonical JSON of the truth"}
    write_text(folder / "seal.json", json.dumps(published))
    answers = {}
    for name, engine in engines:
        with tempfile.TemporaryDirectory(prefix="case-") as given:
            write(case, Path(given))
            if name == ORACLE:
                told = case.public | {"only": [n for e in case.truth["effects"] for n in e["right"]]}
                (Path(given) / "case.json").write_text(json.dumps(told))
            answers[name] = _engine(out).ask(Path(given), engine, TIMEOUT_S)
        write_text(folder / f"verdict-{name}.json", json.dumps(answers[name], indent=1))
    write_text(folder / "truth.json", json.dumps({"salt": sealed.salt, "truth": sealed.truth}, indent=1))
    digest = json.loads((folder / "seal.json").read_text())["sha256"]
    oracle_gain = 1.0
    for name, engine in engines:
        row = score(sealed, digest, answers[name], name, oracle_gain)
        if name == ORACLE:
            oracle_gain = row["gain"]
        write_text(folder / f"row-{name}.json", json.dumps({"key": _key(item, seed, engine), "row": row}))


def report(
    out: Path, items: Sequence[Item], seed: int, engines: Sequence[tuple[str, str]], facts: Mapping[str, Any]
) -> pd.DataFrame:
    """Write the tables of finished cases; the first engine's gates, the oracle's aside."""
    rows, seals = [], {}
    for item in items:
        folder = out / "cases" / item.case
        rows += [json.loads((folder / f"row-{name}.json").read_text())["row"] for name, _ in engines]
        seals[item.case] = json.loads((folder / "seal.json").read_text())["sha256"]
    write_text(out / "cases.csv", pd.DataFrame(rows, columns=list(COLUMNS)).to_csv(index=False))
    table = read_cases(out / "cases.csv")
    gates = {name: gate_table(table[table["engine"] == name]) for name, _ in engines}
    write_text(out / "gates.csv", pd.concat([g.assign(engine=e) for e, g in gates.items()]).to_csv(index=False))
    write_text(out / "misses.csv", misses(table).to_csv(index=False))
    rates = by(table, ["engine", "machine", "severity", "background_pct"])
    write_text(out / "by_severity.csv", rates.to_csv(index=False))
    write_text(out / "seals.json", json.dumps(seals, indent=1) + "\n")
    first = next((name for name, _ in engines if name != ORACLE), ORACLE)
    write_text(out / "gates.md", as_markdown(gates[first]))
    manifest = {
        "cases": len(items), "seed": seed, "engines": dict(engines), "seal": key_of(**seals), **facts, **provenance(),
    }  # fmt: skip
    write_text(out / "manifest.json", json.dumps(manifest, indent=2) + "\n")
    return gates[first]


def _engine(out: Path) -> Engine:
    if str(out) not in _ENGINES:
        _ENGINES[str(out)] = Engine(out, out / f"engine-{os.getpid()}.log")
    return _ENGINES[str(out)]


def _finished(out: Path, item: Item, seed: int, engines: Sequence[tuple[str, str]]) -> bool:
    for name, engine in engines:
        try:
            part = json.loads((out / "cases" / item.case / f"row-{name}.json").read_text())
            if part["key"] != _key(item, seed, engine):
                return False
        except (OSError, ValueError, KeyError):
            return False
    return True


def _key(item: Item, seed: int, engine: str) -> str:
    """What a row depends on: the item, the seed, the generator's, the judge's and the engine's code."""
    return key_of(
        item=list(item.__dict__.values()), seed=seed, engine=engine, suite=code_version("bench.prove.suite"),
        code=code_version(engine.partition(":")[0]),
    )  # fmt: skip
