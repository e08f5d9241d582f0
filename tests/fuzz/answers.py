"""The answers of each command, read back from what it wrote: are they finite, in range, and what do they say?"""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn
from xml.etree import ElementTree

import numpy as np
import pandas as pd
from helpers import documents

from fuzz.given import TANK
from fuzz.worker import Ended
from twinbench.bench.cli.mismatch_status import STATUS
from twinbench.bench.replay.record import Record
from twinbench.machines.compressor import COMPRESSOR, ESTIMATED, HEALTH

EQUAL = 1e-6
"""Relative difference of numbers that are the same: parsing and unpacking cost a digit at most."""


class Nonsense(Exception):
    """The answer is one that nobody should be given."""


@dataclass(frozen=True)
class Answer:
    """What a command said.

    Attributes:
        told: it says that something is wrong.
        numbers: all that has to be equal for equal input.
        intervals: (low, high) by name, for input that is nearly equal.
    """

    says: str
    told: bool
    numbers: Any
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)

    def same_as(self, other: Answer) -> None:
        """Raises Nonsense unless the two say the same."""
        if self.told != other.told:
            raise Nonsense(f"another verdict than for equal input: {self.says}; there {other.says}")
        if where := difference(self.numbers, other.numbers):
            raise Nonsense(f"other numbers than for equal input: {where}")

    def near(self, other: Answer) -> None:
        """Raises Nonsense unless the intervals overlap."""
        if self.told != other.told:
            return
        for name, (low, high) in self.intervals.items():
            there = other.intervals[name]
            if low > there[1] or high < there[0]:
                raise Nonsense(
                    f"{name} is {low:.4g} to {high:.4g}, for nearly equal input {there[0]:.4g} to {there[1]:.4g}"
                )


def difference(a: Any, b: Any, where: str = "") -> str:
    """Where two nested values differ by more than EQUAL; empty if nowhere."""
    if isinstance(a, dict) and isinstance(b, dict):
        if set(a) != set(b):
            return f"{where}: {sorted(set(a) ^ set(b))[:3]}"
        return next((d for key in a if (d := difference(a[key], b[key], f"{where}/{key}"))), "")
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        if len(a) != len(b):
            return f"{where}: {len(a)} and {len(b)} entries"
        return next(
            (d for i, (x, y) in enumerate(zip(a, b, strict=True)) if (d := difference(x, y, f"{where}/{i}"))), ""
        )
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        if a.shape != b.shape:
            return f"{where}: shapes {a.shape} and {b.shape}"
        off = ~np.isclose(a, b, rtol=EQUAL, atol=EQUAL * np.nanmax(np.abs(b), initial=0.0), equal_nan=True)
        return f"{where}: {a[off].flat[0]} and {b[off].flat[0]}" if off.any() else ""
    if isinstance(a, float) and isinstance(b, float):
        return "" if np.isclose(a, b, rtol=1e-3, equal_nan=True) else f"{where}: {a} and {b}"
    return "" if a == b else f"{where}: {a!r} and {b!r}"


def strict_json(text: str) -> Any:
    """JSON as every reader takes it: no NaN, no infinity."""

    def refuse(word: str) -> NoReturn:
        raise Nonsense(f"its JSON holds {word}")

    return json.loads(text, parse_constant=refuse)


def need(holds: Any, otherwise: str) -> None:
    if not holds:
        raise Nonsense(otherwise)


def numbers_of(path: Path) -> dict[str, np.ndarray]:
    """A table's columns but for the clock, all finite."""
    table = pd.read_csv(path) if path.suffix == ".csv" else pd.read_parquet(path)
    need(len(table) > 0, f"{path.name} has no rows")
    columns = {c: table[c].to_numpy(dtype=float) for c in table if c != "time_s"}
    for name, values in columns.items():
        need(np.isfinite(values).all(), f"{path.name}: {name} is not finite")
    return columns


def status(ended: Ended, *documented: int) -> None:
    need(ended.status in documented, f"exit status {ended.status}")


def estimate(folder: Path, ended: Ended) -> Answer:
    status(ended, 0)
    summaries = sorted(folder.rglob("*.summary.json"))
    need(summaries, "exit status 0 and no summary")
    summary = strict_json(summaries[0].read_text())
    documents.check("summary", summary)
    (table,) = summaries[0].parent.glob("*.estimates.csv")
    columns = numbers_of(table)
    for name in ESTIMATED:
        low, value, high = columns[f"{name}_low"], columns[name], columns[f"{name}_high"]
        need(((low <= value) & (value <= high)).all(), f"{name} is not inside its interval")
        if name in HEALTH:
            h = HEALTH.index(name)
            need(
                (low >= COMPRESSOR.coordinates.low[h] - 1e-6).all()
                and (high <= COMPRESSOR.coordinates.high[h] + 1e-6).all(),
                f"{name} leaves its physical range",
            )
    intervals = {name: (columns[f"{name}_low"][-1], columns[f"{name}_high"][-1]) for name in HEALTH}
    return Answer(summary["says"], bool(remarks(summary)), columns, intervals)


def remarks(summary: dict[str, Any]) -> Any:
    """What an estimate's summary has against its recording."""
    return summary.get("remarks") or summary.get("usable") is False


def simulate(folder: Path, ended: Ended) -> Answer:
    status(ended, 0)
    tables = [p for p in sorted(folder.rglob("*")) if p.suffix in (".csv", ".parquet") and ".simulated." in p.name]
    need(tables, "exit status 0 and no table")
    return Answer("simulated", False, [numbers_of(path) for path in tables])


AGREES = ("consistent", "parameter change")


def mismatch(folder: Path, ended: Ended) -> Answer:
    status(ended, *STATUS.values())
    (path,) = folder.rglob("verdict.json")
    verdict = strict_json(path.read_text())
    documents.check("verdict", verdict)
    found = verdict["verdict"]
    need(ended.status == STATUS[found], f"exit status {ended.status}, and the verdict is {found}")
    for f in verdict["findings"]:
        need(f["probability"] is None or 0.0 <= f["probability"] <= 1.0, f"a probability of {f['probability']}")
    beside = ("model.toml", "sizes.csv", "report.html", "report.pdf")
    need(all(path.with_name(name).is_file() for name in beside), "files are missing")
    says = verdict["says"]
    for share in re.findall(r"(-?[\d.]+) %", says):
        need(-1e3 < float(share) <= 100.0, f"{share} % in: {says}")
    need(not re.search(r"\b(nan|inf)\b", says), f"nan or inf in: {says}")
    return Answer(
        f"{verdict['verdict']}: {says}",
        verdict["verdict"] not in AGREES,
        {"verdict": verdict["verdict"], "values": verdict["parameters"]},
    )


def listed(folder: Path, ended: Ended) -> Answer:
    status(ended, 0)
    if not ended.out.lstrip().startswith(("[", "{")):
        need(ended.out.strip() and "nan" not in ended.out.split(), "nothing printed, or nan in it")
        return Answer("a table", False, ended.out)
    rows = strict_json(ended.out)
    need(
        not any(re.search(r"= -?(nan|inf)\b", str(row.get("parameter"))) for row in rows),
        "a typical value that is no number",
    )
    return Answer(f"{len(rows)} rows", False, rows)


def check(folder: Path, ended: Ended) -> Answer:
    status(ended, 0, 1)
    if not ended.out.lstrip().startswith("["):
        need(" checks, " in ended.out, "no result printed")
        return Answer("a table", ended.status == 1, ended.out)
    rows = strict_json(ended.out)
    failed = [row["name"] for row in rows if row["status"] == "fail"]
    need(bool(failed) == (ended.status == 1), "exit status and result disagree")
    return Answer(f"{len(failed)} of {len(rows)} failed", bool(failed), [(row["name"], row["status"]) for row in rows])


def run(folder: Path, ended: Ended) -> Answer:
    status(ended, 0, 1)
    if ended.status == 1:
        need("failed" in ended.out + ended.err, "exit status 1, and no word of what failed")
        return Answer("failed", True, {})
    (path,) = folder.rglob("scores.csv")
    scores = pd.read_csv(path, keep_default_na=False, na_values=[""])
    strict_json(path.with_name("manifest.json").read_text())
    need(path.with_name("report.html").is_file(), "no report")
    health = scores[scores["metric"] == "parameter_error_pct"]["value"].to_numpy(dtype=float)
    need(len(health) and np.isfinite(health).all(), "exit status 0, and scores that are no numbers")
    return Answer("run", False, scores["value"].to_numpy(dtype=float))


def report(folder: Path, ended: Ended) -> Answer:
    status(ended, 0)
    (path,) = folder.rglob("report.html")
    page = path.read_text(encoding="utf-8")
    need(page.rstrip().endswith("</html>"), "report.html is cut short")
    need("<script>alert" not in page, "text of a table runs as a script")
    for table in path.parent.glob("tables/*.csv"):
        need(table.stat().st_size > 0, f"{table.name} is empty")
    tables = {t.name: t.read_text() for t in sorted(path.parent.glob("tables/*.csv"))}
    return Answer("report", False, tables)


def export(folder: Path, ended: Ended) -> Answer:
    status(ended, 0)
    (graph,) = folder.rglob("operator.onnx")
    with np.load(graph.with_name("filter.npz"), allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    need(not any(np.isnan(a).any() for a in arrays.values() if a.dtype.kind == "f"), "the filter holds NaN")
    return Answer("exported", False, {})


def latency(folder: Path, ended: Ended) -> Answer:
    status(ended, 0, 1)
    if ended.status == 1:
        need("failed" in ended.out + ended.err, "exit status 1, and no word of what failed")
        return Answer("failed", True, {})
    (path,) = folder.rglob("out/latency.csv")
    p50 = pd.read_csv(path)["p50_us"]
    need(len(p50) and (p50 > 0).all() and np.isfinite(p50).all(), "times that are no times")
    return Answer("timed", False, {})


def tune(folder: Path, ended: Ended) -> Answer:
    status(ended, 0)
    return Answer("tuned", False, {})


SEEN = ("readings", "lost", "low", "median", "high", "distinct", "noise", "moves", "swings")
"""Of a channel, what is the same in whatever file it stands."""


def look(folder: Path, ended: Ended) -> Answer:
    status(ended, 0)
    if not ended.out.lstrip().startswith("{"):
        need(" rows over " in ended.out, "nothing told")
        return Answer("a table", False, ended.out)
    seen = strict_json(ended.out)
    need(seen["last_s"] >= seen["first_s"], "it ends before it begins")
    for file in seen["files"]:
        need((folder / file).read_bytes().startswith(b"\x89PNG"), f"{file} is no picture")
    channels = seen["channels"]
    for name, channel in channels.items():
        need(channel["readings"] <= seen["samples"], f"{name} has more readings than there are rows")
        need(channel["lost"] is None or 0.0 <= channel["lost"] <= 1.0, f"{name} has lost {channel['lost']}")
        if channel["readings"]:
            need(channel["low"] <= channel["median"] <= channel["high"], f"the median of {name} is not between")
    its = {c: {key: channels[c][key] for key in SEEN} for c in TANK.channels if c in channels}
    return Answer(f"{len(channels)} channels", False, its)


def told_file(folder: Path, ended: Ended) -> Path:
    """The one file that a command says it wrote, after whatever a user's code printed."""
    return folder / ended.out.splitlines()[-1]


def fmu(folder: Path, ended: Ended) -> Answer:
    status(ended, 0)
    with zipfile.ZipFile(told_file(folder, ended)) as archive:
        need(archive.testzip() is None, "the FMU is damaged")
        described = ElementTree.fromstring(archive.read("modelDescription.xml"))
        binaries = [name for name in archive.namelist() if name.startswith("binaries/") and not name.endswith("/")]
        need(binaries and all(archive.read(name).startswith(b"\x7fELF") for name in binaries), "it has no binary")
    variables = [
        {"name": v.get("name"), "causality": v.get("causality"), "start": v.get("start") or v[0].get("start")}
        for v in described.iter("ScalarVariable")
    ]
    need(variables and len({v["name"] for v in variables}) == len(variables), "no variables, or names twice")
    starts = [float(v["start"]) for v in variables if v["start"]]
    need(np.isfinite(starts).all(), "a start that is no number")
    return Answer("written", False, variables)


def record(folder: Path, ended: Ended) -> Answer:
    status(ended, 0)
    made = Record.load(told_file(folder, ended))
    need(len(made.time_s) > 0, "a record of no tick")
    kept = {name: made.said[name] for name in ("mean", "low", "high")}
    for name, values in kept.items():
        need(np.isfinite(values).all(), f"{name} is not finite")
    need(((kept["low"] <= kept["mean"]) & (kept["mean"] <= kept["high"])).all(), "an estimate outside its interval")
    return Answer(f"{len(made.time_s)} ticks", False, kept)


def replay(folder: Path, ended: Ended) -> Answer:
    status(ended, 0, 1)
    if not ended.out.lstrip().startswith("{"):
        need(" ticks, equal" in ended.out or "differs from tick" in ended.out, "no result printed")
        return Answer("a line", ended.status == 1, ended.out)
    said = strict_json(ended.out)
    need(said["passed"] == (ended.status == 0), "exit status and result disagree")
    need(said["equal"] == (said["first_tick"] is None), "equal, and a tick that differs")
    return Answer("equal" if said["equal"] else "differs", not said["equal"], said["first_tick"])


def schema(folder: Path, ended: Ended) -> Answer:
    status(ended, 0)
    return Answer("a schema", False, strict_json(ended.out)["$schema"])


ANSWERS: dict[str, Callable[[Path, Ended], Answer]] = {
    "estimate": estimate, "simulate": simulate, "mismatch": mismatch, "list": listed, "check": check, "run": run,
    "report": report, "export": export, "latency": latency, "tune": tune, "look": look, "fmu": fmu, "record": record,
    "replay": replay, "schema": schema,
}  # fmt: skip
