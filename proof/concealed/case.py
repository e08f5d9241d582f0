"""One case of the suite: draw it, publish its seal, ask the engines blindly, and open the seal.

Answers are kept. They are scored each time that they are read, so a new judge asks no engine again.
"""

from __future__ import annotations

import json
import os
import platform
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from twinbench.common.store import key_of, write_text
from twinbench.common.versions import code_version, source_version
from twinbench.proof.concealed.engine import Engine
from twinbench.proof.concealed.engines import ORACLE
from twinbench.proof.concealed.generate import Case, Item, draw, write
from twinbench.proof.concealed.judge import score
from twinbench.proof.concealed.seal import Sealed, canonical, seal

CASE_TIMEOUT_S = 900.0
UNDRAWN = "undrawn.json"
_PROCESSES: dict[tuple[str, str], Engine] = {}
"""This worker's blind processes, by the folder they are kept out of and checkout: each compiles once for all cases."""


def run_case(item: Item, seed: int, out: Path, engines: Mapping[str, str], asked: Sequence[str]) -> int:
    """Ask some engines about a case, then write its truth down.

    While an engine runs the truth is in this process's memory alone. A machine that diverges as it is drawn is no case:
    it is left out, before any engine was asked.

    Args:
        engines: by name, all that are to answer.
        asked: those of them that have not answered yet.

    Returns:
        How many were asked.
    """
    folder = out / "cases" / item.case
    try:
        case = draw(item, seed)
    except FloatingPointError as error:
        write_text(folder / UNDRAWN, json.dumps({"key": _drawn_by(item, seed), "says": str(error)}))
        return len(asked)
    sealed, is_new = _sealed(case, folder)
    asked = list(engines) if is_new else asked
    for name in asked:
        with tempfile.TemporaryDirectory(prefix="case-") as given:
            write(case, Path(given))
            if name == ORACLE:
                told = case.public | {"only": [e["name"] for e in case.truth["effects"]]}
                (Path(given) / "case.json").write_text(json.dumps(told))
            engine, _, checkout = engines[name].partition("@")
            answer = _process(out, checkout).ask(Path(given), engine, CASE_TIMEOUT_S)
        answered = {"key": _key(item, seed, engines[name]), "answer": answer}
        write_text(_answer_file(out, item, name), json.dumps(answered, indent=1))
    write_text(folder / "truth.json", json.dumps({"salt": sealed.salt, "truth": sealed.truth}, indent=1))
    return len(asked)


def missing(item: Item, seed: int, out: Path, engines: Mapping[str, str]) -> list[str]:
    """Engines that have not answered this case by the code as it is."""
    folder = out / "cases" / item.case
    if undrawn(item, seed, out):
        return []
    if not (folder / "truth.json").is_file():
        return list(engines)
    found = []
    for name, engine in engines.items():
        try:
            known = _read(_answer_file(out, item, name))["key"] == _key(item, seed, engine)
        except (OSError, ValueError, KeyError):
            known = False
        found += [] if known else [name]
    return found


def undrawn(item: Item, seed: int, out: Path) -> str:
    """Why a case could not be drawn by the generator as it is; empty if it could, or was not tried."""
    path = out / "cases" / item.case / UNDRAWN
    known = _read(path) if path.is_file() else {"key": ""}
    return str(known["says"]) if known["key"] == _drawn_by(item, seed) else ""


def _drawn_by(item: Item, seed: int) -> str:
    return key_of(
        item=list(item.__dict__.values()), seed=seed, code=[code_version("twinbench.proof.concealed.generate")]
    )


def row(item: Item, seed: int, out: Path, name: str) -> dict[str, Any]:
    """An engine's row of a finished case, scored by the judge as it is."""
    sealed = Sealed(**_read(out / "cases" / item.case / "truth.json"))
    return score(sealed, digest(out, item), _read(_answer_file(out, item, name))["answer"], name, seed)


def digest(out: Path, item: Item) -> str:
    """What was published of a case's truth."""
    return str(_read(out / "cases" / item.case / "seal.json")["sha256"])


def close(out: Path) -> None:
    """End this process's own blind processes of a folder; a worker's end with the worker, or with its next folder."""
    for place in [place for place in _PROCESSES if place[0] == str(out)]:
        _PROCESSES.pop(place).close()


def _sealed(case: Case, folder: Path) -> tuple[Sealed, bool]:
    """The case sealed; and is the seal new? A finished case keeps its seal, and its truth leaves the disk for now."""
    path = folder / "truth.json"
    try:
        sealed = Sealed(**_read(path))
        known = sealed.digest == _read(folder / "seal.json")["sha256"]
        known = known and canonical(sealed.truth) == canonical(case.truth)
    except (OSError, ValueError, KeyError, TypeError):
        known = False
    path.unlink(missing_ok=True)
    if known:
        return sealed, False
    # Parts of an earlier attempt must not be taken for this one's.
    for old in folder.glob("verdict-*.json"):
        old.unlink()
    sealed = seal(case.truth)
    published = {"case": case.item.case, "sha256": sealed.digest, "of": "salt, newline, canonical JSON of the truth"}
    write_text(folder / "seal.json", json.dumps(published))
    return sealed, True


def _process(out: Path, checkout: str) -> Engine:
    place = str(out), checkout
    for other in {kept for kept, _ in _PROCESSES} - {str(out)}:  # a cluster's worker outlives a command
        close(Path(other))
    if place not in _PROCESSES:
        elsewhere = Path(checkout).resolve() if checkout else None
        _PROCESSES[place] = Engine(out, out / f"engine-{platform.node()}-{os.getpid()}.log", elsewhere)
    return _PROCESSES[place]


def _key(item: Item, seed: int, engine: str) -> str:
    """What an answer depends on: the item, the seed, the generator's and the engine's code."""
    function, _, checkout = engine.partition("@")
    code = [code_version("twinbench.proof.concealed.generate")]
    if checkout:
        code += [source_version(Path(checkout).resolve())]
    else:
        code += [code_version("twinbench.proof.blind"), code_version(function.partition(":")[0])]
    return key_of(item=list(item.__dict__.values()), seed=seed, engine=function, code=code)


def _answer_file(out: Path, item: Item, name: str) -> Path:
    return out / "cases" / item.case / f"verdict-{name}.json"


def _read(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text()))
