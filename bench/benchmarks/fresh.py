"""Studies of trained estimators on fresh recordings: how one is asked for, its two halves, and what it leaves.

Each half of the recordings is judged by the factors that the other half's intervals need.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from twinbench.bench.estimates import Estimates
from twinbench.bench.profile import load_profile
from twinbench.bench.report.provenance import write_tables
from twinbench.bench.report.table_formats import Table, to_text
from twinbench.bench.statistics.conformal import factors
from twinbench.common.store import write_csv, write_text
from twinbench.common.versions import provenance
from twinbench.data.batch import Array, Batch
from twinbench.data.benchmark import simulate_benchmark
from twinbench.machines.load import load_machine

Halves = tuple[Batch, Batch]


def parser(says: str, name: str, recordings: int) -> argparse.ArgumentParser:
    """What every study takes: whose networks, how many recordings and where to.

    Args:
        says: what the study is for.
        name: of its folder under ``results/``.
        recordings: of both halves together, if none are asked for.
    """
    made = argparse.ArgumentParser(description=says)
    made.add_argument("--profile", default="quick", help="whose population and networks (default: quick)")
    made.add_argument("--results", type=Path, metavar="DIR", help="the run in which the estimators are trained")
    made.add_argument(
        "--recordings", type=int, default=recordings, metavar="N", help="fresh ones, both halves together"
    )
    made.add_argument("--out", type=Path, default=Path("results") / name, metavar="DIR")
    return made


def fresh_halves(asked: argparse.Namespace, seed: int) -> Halves:
    """Two halves of as many recordings of the profile's population as were asked for."""
    profile, each = load_profile(asked.profile), asked.recordings // 2
    design = replace(profile.data, seed=seed, n_train=1, n_validation=1, n_calibration=each, n_test=each, n_single=0)
    split = simulate_benchmark(design, profile.corruption, load_machine(profile.machine))
    return split.calibration, split.test


def factors_of_the_other(seen: Sequence[Estimates], halves: Halves) -> list[Array]:
    """Of each half, the factors (n,), dimensionless, that the other half's intervals need."""
    return [factors(estimates, half) for estimates, half in zip(seen, halves, strict=True)][::-1]


def leave(
    asked: argparse.Namespace, name: str, seed: int, numbers: Mapping[str, pd.DataFrame], tables: Sequence[Table]
) -> None:
    """Write a study's numbers and tables, with what made them, and print the tables."""
    for file, frame in numbers.items():
        write_csv(asked.out / file, frame)
    write_tables(asked.out, tables)
    about = {"profile": asked.profile, "recordings": asked.recordings, "seed": seed, "provenance": provenance()}
    write_text(asked.out / f"{name}.json", json.dumps(about, indent=2) + "\n")
    print("\n".join(map(to_text, tables)))
