"""How long each trained estimator takes over the test recordings with the cores of this machine shared between them.

    python -m twinbench.bench.benchmarks.evaluation --profile paper --results results/paper_time

As many processes as there are cores step a share of the recordings each in lockstep, forecasts included, as ``twinbench
run`` does with all of them in one. Wall time of the second pass: the first, over a few samples, starts the processes
and compiles.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

from twinbench.common.threads import pin

pin()

import joblib  # noqa: E402  threads are pinned before NumPy is there
import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402

from twinbench.bench.cells import Cell, load_fit, load_split  # noqa: E402
from twinbench.bench.estimate.apply import Training, trained_cells  # noqa: E402
from twinbench.bench.evaluate import run as evaluate  # noqa: E402
from twinbench.bench.profile import Evaluation, load_profile  # noqa: E402
from twinbench.common.jobs import cores  # noqa: E402
from twinbench.common.store import Store, write_csv, write_text  # noqa: E402
from twinbench.common.threads import pin_torch  # noqa: E402
from twinbench.common.versions import provenance  # noqa: E402

FIRST_SAMPLES = 2400
"""Of the first pass: a minute's forecasts and a minute before."""


def _part(store: Store, cell: Cell, evaluation: Evaluation, sequences: list[int], samples: int | None) -> None:
    pin_torch()
    batch = load_split(store, cell).test.select(sequences, slice(samples)).without_truth()
    evaluate(load_fit(store, cell), batch, evaluation, cell.seed)


def measure(store: Store, cells: list[Cell], evaluation: Evaluation) -> pd.DataFrame:
    """Columns estimator, recordings, samples, wall_s."""
    count, samples = load_split(store, cells[0]).test.measured.shape[:2]
    jobs = min(cores(), count)
    shares = [share.tolist() for share in np.array_split(np.arange(count), jobs)]
    rows = []
    with joblib.Parallel(n_jobs=jobs) as parallel:
        for cell in cells:
            for length in (FIRST_SAMPLES, None):
                begun = time.perf_counter()
                parallel(joblib.delayed(_part)(store, cell, evaluation, share, length) for share in shares)
                wall_s = time.perf_counter() - begun
            rows.append((cell.estimator, count, samples, round(wall_s, 1)))
    return pd.DataFrame(rows, columns=["estimator", "recordings", "samples", "wall_s"])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--profile", default="quick")
    parser.add_argument("--results", type=Path, metavar="DIR")
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"), metavar="DIR")
    a = parser.parse_args()
    store, cells = trained_cells(Training(a.profile, a.results), [])
    about = {"processes": cores(), "profile": a.profile, "provenance": provenance()}  # the load before, not our own
    table = measure(store, cells, load_profile(a.profile).evaluation)
    write_csv(a.out / "evaluation.csv", table)
    write_text(a.out / "evaluation.json", json.dumps(about, indent=2) + "\n")
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
