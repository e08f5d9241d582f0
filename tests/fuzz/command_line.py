"""``python tests/fuzz``: what it takes, what it prints and writes."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from collections import Counter
from pathlib import Path

import pandas as pd

from fuzz.cases import SEED
from fuzz.commands import CASES, WAYS
from fuzz.fuzzing import outcomes, started
from fuzz.judge import BAD, GOOD, Outcome
from twinbench.common.jobs import cores

OUTCOMES, MANIFEST = "outcomes.csv", "manifest.json"
COLUMNS = ["command", "mutator", "n", *GOOD, *BAD]
FAST = {
    "estimate": 8, "mismatch": 2, "simulate": 8, "list": 10, "check": 5, "run": 2, "report": 5, "export": 8,
    "tune": 5, "look": 6, "fmu": 3, "record": 4, "replay": 8, "schema": 2,
}  # fmt: skip
"""Cases of each command that continuous integration has time for."""
FAST_LATENCY = 8
"""Of latency the one whose run is gone: an answer takes it half a minute, and has tests of its own."""


def main() -> int:
    a = _parser().parse_args()
    if a.index is not None:
        return one(a.command, a.index, a.seed)
    commands = [a.command] if a.command else list(WAYS)
    chosen = [(c, i) for c in commands for i in (fast(c) if a.fast else indices(c, a.cases))]
    begun = time.monotonic()
    found = []
    with started(a.seed) as fuzz:
        for outcome in outcomes(fuzz, chosen, a.jobs):
            found.append(outcome)
            if outcome.bad or a.verbose:
                print(described(outcome), flush=True)
    counts = Counter(o.kind for o in found)
    print(
        f"{len(found)} cases in {time.monotonic() - begun:.0f} s: "
        + ", ".join(f"{counts[k]} {k}" for k in (*GOOD, *BAD))
    )
    if a.out:
        write(a.out, found, a.seed, time.monotonic() - begun)
    return 1 if any(o.bad for o in found) else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python tests/fuzz", description="Mutated input for every command.")
    parser.add_argument("command", nargs="?", choices=tuple(WAYS), help="of this command only; others keep their rows")
    parser.add_argument("index", nargs="?", type=int, help="this case only: say what happened, and leave its folder")
    parser.add_argument("--cases", type=int, default=CASES, metavar="N", help=f"of each command (default: {CASES})")
    parser.add_argument("--fast", action="store_true", help="a few of each, spread over the mutators")
    parser.add_argument("--jobs", type=int, default=cores(), metavar="N", help="processes (default: all)")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--out", type=Path, metavar="DIR", help="write outcomes.csv and manifest.json into it")
    parser.add_argument("--verbose", action="store_true", help="a line for each case")
    return parser


def fast(command: str) -> list[int]:
    """Its cases in continuous integration."""
    return [FAST_LATENCY] if command == "latency" else indices(command, FAST[command])


def indices(command: str, cases: int) -> list[int]:
    """So many cases of a command: fewer than it has mutators are spread over them."""
    ways = len(WAYS[command])
    return [i * ways // cases for i in range(cases)] if cases < ways else list(range(cases))


def described(o: Outcome) -> str:
    """A case and what came of it in a line, with the command that repeats it."""
    case = o.case
    return (
        f"{o.kind:<11} {case.command} {case.index}: {case.mutator} ({case.expects}), {o.ended.seconds:.1f} s: "
        f"{o.why[:300]}" + (f"\n            again: python tests/fuzz {case.command} {case.index}" if o.bad else "")
    )


def one(command: str, index: int, seed: int) -> int:
    with started(seed) as fuzz:
        outcome = fuzz.outcome(command, index, keep=True)
        kept = Path.cwd() / f"fuzz-{command}-{index}"
        outcome.case.folder.rename(kept) if not kept.exists() else None
    print(f"cd {kept}; twinbench {shlex.join(outcome.case.arguments)}"[:3000])
    print(f"exit status {outcome.ended.status}")
    print(f"--- stdout\n{outcome.ended.out[-3000:]}\n--- stderr\n{outcome.ended.err[-6000:]}")
    print(described(outcome))
    return int(outcome.bad)


def write(out: Path, found: list[Outcome], seed: int, seconds: float) -> None:
    """``outcomes.csv``: how many cases of each command and mutator ended how; ``manifest.json``: with what.

    Commands that were not asked keep their rows, and what made them.
    """
    from twinbench.common.store import write_atomically, write_text
    from twinbench.common.versions import provenance

    table, made = _table(found), {}
    if (out / MANIFEST).is_file():
        made = json.loads((out / MANIFEST).read_text())["made"]
        kept = pd.read_csv(out / OUTCOMES).query("command not in @table.command")
        table = pd.concat([kept, table])
    about = {"command": "python " + shlex.join(sys.argv), "seed": seed, **provenance()}
    for command in dict.fromkeys(o.case.command for o in found):
        its = [o for o in found if o.case.command == command]
        made[command] = {"cases": len(its), "slowest_s": round(max(o.ended.seconds for o in its), 1), **about}
        made[command]["wall_s"] = round(seconds, 1)
    totals = {kind: int(table[kind].sum()) for kind in (*GOOD, *BAD)}
    ordered = table.sort_values("command", key=lambda names: names.map(list(WAYS).index), kind="stable")
    write_atomically(out / OUTCOMES, lambda path: ordered[COLUMNS].to_csv(path, index=False))
    whole = {"command": f"python tests/fuzz --out {out}", "totals": totals, "made": made}
    write_text(out / MANIFEST, json.dumps(whole, indent=2) + "\n")


def _table(found: list[Outcome]) -> pd.DataFrame:
    rows = pd.DataFrame([{"command": o.case.command, "mutator": o.case.mutator, "kind": o.kind} for o in found])
    table = rows.pivot_table(index=["command", "mutator"], columns="kind", aggfunc="size", fill_value=0, sort=False)
    table = table.reindex(columns=[*GOOD, *BAD], fill_value=0).reset_index()
    table.insert(2, "n", table[[*GOOD, *BAD]].sum(axis=1))
    return table
