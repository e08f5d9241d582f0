"""Where the training of an estimator spends its time, function by function.

    python -m twinbench.bench.benchmarks.training_profile --only deeponet_kalman gru_kf --out results/benchmarks

Trains on the paper profile's recordings for so many iterations under Python's own profiler and lists the functions in
which most time was spent, in themselves, not in what they call. Work in other threads, as the mended EKF's search
has it, shows as waiting for a lock.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import pstats
from pathlib import Path

from twinbench.common.threads import pin

pin()

import pandas as pd  # noqa: E402  threads are pinned before NumPy is there

from twinbench.bench.profile import load_profile  # noqa: E402
from twinbench.bench.registry import find  # noqa: E402
from twinbench.common.store import write_csv, write_text  # noqa: E402
from twinbench.common.threads import pin_torch  # noqa: E402
from twinbench.common.versions import provenance  # noqa: E402
from twinbench.data.benchmark import Split, simulate_benchmark  # noqa: E402

MOST_FUNCTIONS = 12
"""Functions that are listed of each."""


def profile(spec: str, split: Split, iterations: int) -> pd.DataFrame:
    """Columns estimator, function, calls, own_s, share; the costliest first."""
    kind = find(spec)
    settings = {"iterations": iterations} if "iterations" in kind.settings else {}
    estimator, profiler = kind(split.train.machine, **settings), cProfile.Profile()
    profiler.runcall(estimator.fit, split.train, split.validation, 0)
    found = pstats.Stats(profiler).stats  # type: ignore[attr-defined]
    rows = [(kind.name, _name(*where), calls, own) for where, (_, calls, own, _, _) in found.items()]
    table = pd.DataFrame(rows, columns=["estimator", "function", "calls", "own_s"])
    table["share"] = table["own_s"] / table["own_s"].sum()
    return table.nlargest(MOST_FUNCTIONS, "own_s").round({"own_s": 2, "share": 3})


def _name(file: str, _: int, function: str) -> str:
    return function if file == "~" else f"{Path(file).stem}.{function}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", nargs="+", default=["deeponet_kalman", "gru_kf", "nominal_ekf_mended"])
    parser.add_argument("--iterations", type=int, default=600, metavar="N")
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"), metavar="DIR")
    a = parser.parse_args()
    pin_torch()
    paper = load_profile("paper")
    split = simulate_benchmark(paper.data, paper.corruption)
    table = pd.concat([profile(spec, split, a.iterations) for spec in a.only])
    write_csv(a.out / "training_profile.csv", table)
    about = {"iterations": a.iterations, "profile": paper.name, "provenance": provenance()}
    write_text(a.out / "training_profile.json", json.dumps(about, indent=2) + "\n")
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
