"""Naive simulators against public recordings of real machines: verdicts, errors before and after, figures.

``python -m twinbench.proof.real_recordings --recordings FOLDER`` writes ``results/real_recordings/`` and the results
into ``docs/real_recordings.md``, which also says what FOLDER must hold; the simulators are in ``examples/``.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from twinbench.common.documents import to_json
from twinbench.common.page import write_bytes
from twinbench.common.store import sha256_of, write_text
from twinbench.common.style import png, settle
from twinbench.common.versions import provenance
from twinbench.data.look.whole import look
from twinbench.data.look.words import told
from twinbench.mismatch import Verdict, diagnose
from twinbench.mismatch.model import load_simulator
from twinbench.mismatch.recordings import read_recordings
from twinbench.mismatch.report.figures import draw
from twinbench.mismatch.report.replays import replays
from twinbench.proof.command import refusing

ROOT = Path(__file__).resolve().parents[1]
RESULTS, PAGE = ROOT / "results" / "real_recordings", ROOT / "docs" / "real_recordings.md"


class Case(NamedTuple):
    """A recorded machine and the simulator that somebody in a hurry would write of it.

    Attributes:
        learnt, held_out: recordings in FOLDER; without ``held_out`` the end of the only one is held out.
        settling_s: errors are told without the first seconds too, as the benchmark's rules want it.
    """

    name: str
    simulator: str
    learnt: str
    held_out: str = ""
    settling_s: float = 0.0


CASES = (
    Case("cascaded_tanks", "cascaded_tanks.py", "cascaded_tanks/train.csv", "cascaded_tanks/test.csv", 200.0),
    Case("air_chamber_a", "air_chamber.py", "air_chamber/chamber_a.csv"),
    Case("air_chamber_b", "air_chamber.py", "air_chamber/chamber_b.csv"),
    Case("air_chamber_tight", "air_chamber.py", "air_chamber/chamber_tight.csv"),
    Case("train_compressor", "train_compressor.py", "train_compressor/apu.csv"),
)


def examine(case: Case, folder: Path) -> Verdict:
    """The engine's verdict on a case.

    Raises:
        BadInput: a recording is not in ``folder``.
    """
    simulator = load_simulator(str(ROOT / "examples" / case.simulator))
    parts = ([folder / path] if path else [] for path in (case.learnt, case.held_out))
    learnt, held_out = (read_recordings(paths, simulator) for paths in parts)
    return diagnose(simulator, learnt, hold_out=held_out)


def errors(case: Case, verdict: Verdict) -> Iterator[dict[str, Any]]:
    """Root mean square errors of the calibrated and of the mended simulator, one row per part and output."""
    outputs = verdict.diagnosis.simulator.outputs
    for replay in replays(verdict.diagnosis):
        since_s = replay.track.block_time_s - replay.track.time_s[0]
        for from_s in sorted({0.0, case.settling_s if replay.held_out else 0.0}):
            rows = since_s >= from_s
            before = _rms(replay.before[rows])
            after = _rms((replay.before if replay.after is None else replay.after)[rows])
            for i, v in enumerate(outputs):
                yield {
                    "case": case.name,
                    "part": "held out" if replay.held_out else "learnt",
                    "from_s": from_s,
                    "channel": v.name,
                    "unit": v.unit,
                    "rmse_before": before[i],
                    "rmse_after": after[i],
                }


def _rms(residuals: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.nanmean(residuals**2, axis=0)))


def run(folder: Path, out: Path, command: str) -> None:
    """Examine every case and write verdicts, errors, figures and a manifest into ``out``."""
    cases: list[dict[str, Any]] = []
    rows: list[dict[str, Any]] = []
    digests: dict[str, str] = {}
    for case in CASES:
        began = time.perf_counter()
        verdict = examine(case, folder)
        cases.append(
            {
                "case": case.name,
                "verdict": verdict.verdict,
                "named": "+".join(name for f in verdict.findings for name in f.names),
                "stand_ins": "+".join(verdict.diagnosis.stand_ins),
                "seconds": round(time.perf_counter() - began, 1),
            }
        )
        rows += errors(case, verdict)
        digests |= {p: sha256_of(folder / p) for p in (case.learnt, case.held_out) if p}
        write_text(out / case.name / "verdict.json", to_json(verdict.to_dict()) + "\n")
        write_text(out / case.name / "says.md", said(verdict.to_dict()))
        write_text(out / case.name / "look.md", looked(case, folder))
        for drawing in itertools.islice(draw(verdict), 2):  # the held-out part, the learnt part
            if drawing.figure is not None:
                settle(drawing.figure)
                write_bytes(out / case.name / f"{drawing.name}.png", png(drawing.figure))
    write_text(out / "cases.csv", pd.DataFrame(cases).to_csv(index=False))
    write_text(out / "errors.csv", pd.DataFrame(rows).to_csv(index=False, float_format="%.6g"))
    manifest = {"command": command, "recordings_sha256": digests, "provenance": provenance()}
    write_text(out / "manifest.json", json.dumps(manifest, indent=2) + "\n")


def said(verdict: Mapping[str, Any]) -> str:
    """What the verdict says first, as a page quotes it.

    Args:
        verdict: as ``verdict.json`` holds it.
    """
    return f"> {verdict['says']}\n"


def looked(case: Case, folder: Path) -> str:
    """What ``twinbench look`` prints of the recording that is learnt from, as a page shows it.

    Raises:
        BadInput: it is not in ``folder``.
    """
    return "\n".join(["```text", *told(look(folder / case.learnt)), "```"]) + "\n"


def filled(page: str, results: Path) -> str:
    """A page with what came out of each case between its marks, ``<!-- NAME -->`` and ``<!-- end -->``."""
    cases = pd.read_csv(results / "cases.csv", index_col="case")
    table = pd.read_csv(results / "errors.csv")
    for name in cases.index:
        verdict = json.loads((results / name / "verdict.json").read_text())
        rows = to_markdown(table[table["case"] == name])
        figure = f"![{name}: measured and simulated](../results/real_recordings/{name}/fit_held_out.png)"
        points = "\n".join(f"> - {point}" for point in verdict["points"])
        text = f"> {verdict['says']}\n>\n{points}\n\n{rows}\n{figure}"
        text += f"\n\nVerdict: {verdict['verdict']}, after {cases.loc[name, 'seconds']:.0f} s."
        head, mark, rest = page.partition(f"<!-- {name} -->\n")
        page = f"{head}{mark}{text}\n<!-- end -->{rest.partition('<!-- end -->')[2]}"
    return page


def to_markdown(table: pd.DataFrame) -> str:
    """The errors of one case."""
    lines = ["| part | output | RMSE before | RMSE after |", "|---|---|---:|---:|"]
    for row in table.to_dict("records"):
        part = f"{row['part']}, from {row['from_s']:g} s" if row["from_s"] else row["part"]
        before, after = (f"{row[key]:.3g} {row['unit']}" for key in ("rmse_before", "rmse_after"))
        lines.append(f"| {part} | {row['channel']} | {before} | {after} |")
    return "\n".join(lines) + "\n"


@refusing("real_recordings")
def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--recordings", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--out", type=Path, metavar="DIR", help="results/real_recordings, and then the page is filled")
    a = parser.parse_args(arguments)
    run(a.recordings, a.out or RESULTS, "python -m twinbench.proof.real_recordings --recordings FOLDER")
    if a.out is None:
        write_text(PAGE, filled(PAGE.read_text(encoding="utf-8"), RESULTS))
    return 0


if __name__ == "__main__":
    sys.exit(main())
