"""The whole suite: every case on every engine, resumable, in parallel, with its tables."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from twinbench.common.cost import foretold, rates_of
from twinbench.common.errors import BadInput
from twinbench.common.progress import Progress
from twinbench.common.store import check_writable, key_of, write_text
from twinbench.common.style import svg
from twinbench.common.versions import provenance
from twinbench.common.workers import side_by_side
from twinbench.proof.concealed.case import close, digest, missing, row, run_case, undrawn
from twinbench.proof.concealed.engines import ENGINES, MAIN, ORACLE
from twinbench.proof.concealed.figures import power_figure, reliability_figure
from twinbench.proof.concealed.findings import read_cases, stated
from twinbench.proof.concealed.fits import fits, fits_as_markdown, limit_sq
from twinbench.proof.concealed.gates import as_markdown, engine_table, engines_as_markdown, gate_table, misses
from twinbench.proof.concealed.generate import Item
from twinbench.proof.concealed.judge import COLUMNS
from twinbench.proof.concealed.paired import paired_as_markdown, paired_table
from twinbench.proof.concealed.plan import cases
from twinbench.proof.concealed.power import outcomes, power, reliability

CASES_TABLE = "cases.csv"
EARLIER = (Path("results") / "proof", Path("results") / "opponents")
"""Studies that are asked for what an answer costs, where the folder of results does not say it."""
_Plan = Sequence[tuple[Item, Mapping[str, str]]]
"""Cases, and the engines that get each of them."""


@dataclass(frozen=True)
class Study:
    """Which cases are drawn, and who is asked about them.

    Attributes:
        n: cases.
        engines: by name, "module:function", called as ``mismatch.diagnose``.
        opponent_cases: so many cases, spread over the plan, for all but our engine and the oracle; all if None.
    """

    n: int
    seed: int
    engines: Mapping[str, str] = field(default_factory=lambda: {"twinbench": ENGINES["twinbench"]})
    opponent_cases: int | None = None


def run(study: Study, out: Path, console: Console, jobs: int = 0, command: str = "") -> pd.DataFrame:
    """Run all cases on every engine; write ``cases.csv``, ``gates.csv``, ``misses.csv`` and ``manifest.json``.

    They go into ``out``. ``engines.csv`` and ``engines.md`` hold the engines side by side. What an earlier run finished
    with the same code is kept, engine by engine.

    Args:
        jobs: processes; as many as there are cores if 0.

    Returns:
        The gate table of the first engine that is not the oracle.

    Raises:
        BadInput: no case at all is wanted, or ``out`` cannot be written to.
    """
    plan, seed = planned(study), study.seed
    began = time.time()
    out = out.absolute()
    check_writable(out)
    todo = [(item, asked, left) for item, asked in plan if (left := missing(item, seed, out, asked))]
    if len(todo) < len(plan):
        console.print(f"{len(plan) - len(todo)} of {len(plan)} cases are there from an earlier run")
    several = {f"case {item.case}": (item, seed, out, asked, left) for item, asked, left in todo}
    # Cases differ in how many engines they ask, so answers count.
    answers = sum(len(left) for *_, left in todo)
    rates = rates_of([folder / CASES_TABLE for folder in (out, *EARLIER)], ("engine", "machine"))
    kinds = [(engine, item.machine) for item, _, left in todo for engine in left]
    console.print(foretold("answer", kinds, rates), highlight=False, markup=False, soft_wrap=True)
    try:
        with Progress(console) as progress, progress.stage("answers", answers) as going:
            for done, asked in enumerate(side_by_side(run_case, several, progress.say, out, jobs), 1):
                going.step(asked)
                going.says = f"{done} of {len(todo)} cases"
    finally:
        close(out)
    facts = {"command": command, "opponent_cases": study.opponent_cases, "wall_s": round(time.time() - began, 1)}
    return report(out, plan, seed, study.engines, facts)


def planned(study: Study) -> _Plan:
    """Which engines get which cases; a case that none gets is left out."""
    n, engines = study.n, study.engines
    few = n if study.opponent_cases is None else study.opponent_cases
    for option, value in (("--cases", n), ("--opponent-cases", few)):
        if value < 1:
            raise BadInput(f"{option} is {value}, must be at least 1")
    main = {name: engine for name, engine in engines.items() if name in MAIN}
    shared = set(np.linspace(0, n - 1, min(few, n)).round())
    plan = [(item, engines if i in shared else main) for i, item in enumerate(cases(n, study.seed))]
    return [(item, asked) for item, asked in plan if asked]


def report(out: Path, plan: _Plan, seed: int, engines: Mapping[str, str], facts: Mapping[str, Any]) -> pd.DataFrame:
    """Score finished cases and write their tables; the first engine's gates, the oracle's aside."""
    left_out = {item.case: says for item, _ in plan if (says := undrawn(item, seed, out))}
    plan = [(item, asked) for item, asked in plan if item.case not in left_out]
    rows = [row(item, seed, out, name) for item, asked in plan for name in asked]
    seals = {item.case: digest(out, item) for item, _ in plan}
    write_text(out / "seals.json", json.dumps(seals, indent=1) + "\n")
    gates = tables(out, pd.DataFrame(rows, columns=list(COLUMNS)), list(engines))
    manifest = {
        "cases": len(plan),
        "undrawn": left_out,
        "seed": seed,
        "engines": dict(engines),
        "seal": key_of(**seals),
        **facts,
        **provenance(),
    }
    write_text(out / "manifest.json", json.dumps(manifest, indent=2) + "\n")
    return gates


def tables(out: Path, rows: pd.DataFrame, engines: Sequence[str]) -> pd.DataFrame:
    """Write ``cases.csv`` and every table and figure that is made of it; the first engine's gates, the oracle's aside.

    Args:
        rows: with ``COLUMNS``.
    """
    write_text(out / CASES_TABLE, rows.to_csv(index=False))
    table = read_cases(out / CASES_TABLE)
    gates = {name: gate_table(table[table["engine"] == name]) for name in engines}
    write_text(out / "gates.csv", pd.concat([g.assign(engine=e) for e, g in gates.items()]).to_csv(index=False))
    write_text(out / "misses.csv", misses(table).to_csv(index=False))
    curves = power(table)
    write_text(out / "power.csv", curves.to_csv(index=False))
    write_text(out / "outcomes.csv", outcomes(table).to_csv(index=False))
    once = table[table["engine"] == table["engine"].iloc[0]]
    nearest = fits(once)
    write_text(out / "fits.csv", nearest.to_csv(index=False))
    write_text(out / "fits.md", fits_as_markdown(nearest, limit_sq(once)))
    trust = {name: reliability(stated(table[table["engine"] == name])) for name in engines}
    every = pd.concat([bins.assign(engine=name) for name, bins in trust.items()])
    write_text(out / "reliability.csv", every.to_csv(index=False))
    first = next((name for name in engines if name != ORACLE), ORACLE)
    write_text(out / "gates.md", as_markdown(gates[first]))
    write_text(out / "power.svg", svg(power_figure(curves[curves["engine"] == first])))
    write_text(out / "reliability.svg", svg(reliability_figure(trust[first])))
    compared = engine_table(table)
    write_text(out / "engines.csv", compared.to_csv(index=False))
    write_text(out / "engines.md", engines_as_markdown(compared))
    if len(engines) > 1:
        paired = paired_table(table, first)
        write_text(out / "paired.csv", paired.to_csv(index=False))
        write_text(out / "paired.md", paired_as_markdown(paired, first))
    return gates[first]
