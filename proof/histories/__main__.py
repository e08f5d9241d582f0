"""Judge what is said of sizes over time: ``python -m twinbench.proof.histories --cases 36 --seed 7``.

Sizes that stay, grow evenly or leap are hidden in simulated machines, in turn. The engine is told the effect's name:
what is judged is what it says of its size. Beside it stands an ideal observer, who knows the truth's equations, its
noise, and when the change began. Shares stand beside their 95 % intervals (Clopper and Pearson).
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console
from scipy.stats import binomtest

from twinbench.common.errors import BadInput
from twinbench.common.progress import Progress
from twinbench.common.store import check_writable, write_text
from twinbench.common.versions import write_manifest
from twinbench.mismatch.asked import Asked
from twinbench.mismatch.mixture import Z90
from twinbench.mismatch.model import whole_catalogue
from twinbench.mismatch.walk import examine
from twinbench.proof.command import refusing
from twinbench.proof.histories.drawn import KINDS, Drawn, draw
from twinbench.proof.twins import simulator_of

ROOT = Path(__file__).resolve().parents[2]
WITHIN = 0.15
"""Share by which a rate or a step may be off; an ideal observer can if half of its errors are smaller."""
MEDIAN_SD = 0.6745
"""Half of a Gaussian's errors are smaller than so many sds."""
ACCUSED = 0.05
"""A size that stays is accused if staying has a smaller probability."""
BOTH = "ramp or step"
"""What a row of the table calls all that change."""
HELD = {"interval holds": "holds", "onset's interval holds": "since_holds", "ideal observer's holds": "ideal_holds"}
"""Columns of the table that tell how often an interval holds the truth, by columns of the cases."""


@refusing("twinbench.proof.histories")
def main(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m twinbench.proof.histories", description=__doc__)
    parser.add_argument("--cases", type=int, default=36, help="cases to draw, a third of each kind (default: 36)")
    parser.add_argument("--seed", type=int, default=1, help="of the draws (default: 1, the seed for development)")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "histories", help="for the tables")
    asked = parser.parse_args(arguments)
    if asked.cases < len(KINDS):
        raise BadInput(f"--cases is {asked.cases}, must be at least {len(KINDS)}: one of each kind")
    out = asked.out.absolute()
    check_writable(out)
    rows = []
    with Progress(Console(stderr=True)) as progress, progress.stage("cases", asked.cases) as going:
        for case in range(asked.cases):
            rows.append(judged(case, asked.seed))
            going.step()
    table = pd.DataFrame(rows)
    told = summary(table)
    write_text(out / "cases.csv", table.to_csv(index=False, float_format="%.4g"))
    write_text(out / "histories.csv", told.to_csv(index=False, float_format="%.3g"))
    write_text(out / "histories.md", to_markdown(told))
    command = f"python -m twinbench.proof.histories --cases {asked.cases} --seed {asked.seed}"
    write_manifest(out, command, asked.seed, cpu_s=round(float(table["seconds"].sum())))
    print(told.to_string(index=False, float_format="%.3g"))
    return 0


def judged(case: int, seed: int) -> dict[str, Any]:
    """One case drawn, asked and scored."""
    drawn, began = draw(case, seed), time.process_time()
    told = _asked(drawn)
    course = drawn.course
    row = {
        "case": case,
        "machine": drawn.machine.name,
        "effect": drawn.effect.name,
        "kind": course.kind,
        "change": course.change,
        "since_s": course.since_s,
        "ideal_sd": drawn.ideal_sd,
        "ideal_holds": np.nan if course.kind == "constant" else float(abs(drawn.ideal_off) <= Z90 * drawn.ideal_sd),
        "seconds": time.process_time() - began,
        "told": told["pattern"] if told else "",
        "constant": told["probability"]["constant"] if told else np.nan,
    }
    right = told is not None and told["pattern"] == course.kind
    if course.kind == "constant" or not right or told is None:
        none = dict.fromkeys(("holds", "off_s", "since_holds"), np.nan)
        return {**row, "error": np.nan if course.kind == "constant" else 1.0, **none}
    value = told["rate_per_s"] if course.kind == "ramp" else told["change"]
    truth, since = course.told * drawn.size, told["since"]
    return {
        **row,
        "error": abs(value["value"] / truth - 1.0),
        "holds": float(value["low"] <= truth <= value["high"]),
        "off_s": since["time_s"] - course.since_s,
        "since_holds": float(since["earliest"]["time_s"] <= course.since_s <= since["latest"]["time_s"]),
    }


def _asked(drawn: Drawn) -> dict[str, Any] | None:
    """What the engine says of the size, told the effect's name; None if nothing."""
    machine = drawn.machine
    simulator = simulator_of(machine.simulator, machine.network)
    simulator = replace(simulator.with_values(**machine.values), calibrate=tuple(machine.calibrate), drifts=())
    catalogue = [m for m in whole_catalogue(simulator, (), machine.period_s) if m.name == drawn.effect.name]
    found = examine(Asked(simulator, drawn.learnt, drawn.held, catalogue)).histories
    return found[0].plain if found else None


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """By kind: how often it was told as such, how far off, how often intervals hold the truth.

    Of a share, "from" and "to" are its 95 % interval.
    """
    kinds = [*dict.fromkeys(rows["kind"]), BOTH]
    found = []
    for kind in kinds:
        some = rows[rows["kind"] != "constant"] if kind == BOTH else rows[rows["kind"] == kind]
        can = some[(MEDIAN_SD * some["ideal_sd"] <= WITHIN) & (kind != "constant")]
        row = {
            "kind": kind,
            "cases": len(some),
            "effect found": float((some["told"] != "").mean()),
            "told as such": float((some["told"] == some["kind"]).mean()),
            "constant below 0.05": float((some["constant"] < ACCUSED).mean()),
            "ideal observer can": len(can),
            "median error where it can": float(can["error"].median()) if len(can) else np.nan,
            "median off, s": float(some["off_s"].abs().median()),
        }
        for name, column in HELD.items():
            row |= dict(zip((name, f"{name}, from", f"{name}, to"), _share(some[column].dropna()), strict=True))
        found.append(row)
    return pd.DataFrame(found)


def _share(held: pd.Series) -> tuple[float, float, float]:
    """How many of some hold, 1 or 0 each, with the 95 % interval of that share."""
    if not len(held):
        return np.nan, np.nan, np.nan
    told = binomtest(int(held.sum()), len(held))
    within = told.proportion_ci(0.95, "exact")
    return float(told.statistic), float(within.low), float(within.high)


def to_markdown(told: pd.DataFrame) -> str:
    """What a page shows of the summary."""
    head = ["kind", "cases", "told as such", "accused", "median error", *HELD]
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---|" * (len(head) - 1)]
    for row in told.to_dict("records"):
        cells = [row["kind"], f"{row['cases']}", f"{row['told as such']:.2f}", f"{row['constant below 0.05']:.2f}"]
        error = row["median error where it can"]
        cells.append("" if np.isnan(error) else f"{100.0 * error:.1f} %")
        for name in HELD:
            share, low, high = (row[key] for key in (name, f"{name}, from", f"{name}, to"))
            cells.append("" if np.isnan(share) else f"{share:.2f} ({low:.2f} to {high:.2f})")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
