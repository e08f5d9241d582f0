"""What time gives: estimates that wait for later readings, and forecasts along a slope of health.

    python -m twinbench.bench.benchmarks.delay --profile paper --results results/paper --out results/delay

DeepONet-Kalman says of each time what it knows a while later, on fresh recordings of the run's population. Each half
of them is judged by the factors of the other half, found without a delay. Beside it stands the oracle, with and
without hindsight. A second table has forecasts, a third what the filter's own slopes say of its error.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

from twinbench.common.threads import pin

pin()

import pandas as pd  # noqa: E402  threads are pinned before NumPy is there

from twinbench.bench.benchmarks.coverage import fresh_halves  # noqa: E402
from twinbench.bench.benchmarks.delay_tables import LATER, delay_table, forecast_table, slope_table  # noqa: E402
from twinbench.bench.benchmarks.slopes import EVALUATION, FORECASTS, corrected  # noqa: E402
from twinbench.bench.cells import Cell, load_fit  # noqa: E402
from twinbench.bench.estimate.apply import Training, trained_cells  # noqa: E402
from twinbench.bench.estimate.delay import known_later  # noqa: E402
from twinbench.bench.estimates import Estimates  # noqa: E402
from twinbench.bench.evaluate import run as evaluate  # noqa: E402
from twinbench.bench.profile import load_profile  # noqa: E402
from twinbench.bench.report.provenance import write_tables  # noqa: E402
from twinbench.bench.report.table_formats import to_text  # noqa: E402
from twinbench.bench.roster import PROPOSED, REFERENCE  # noqa: E402
from twinbench.bench.statistics.conformal import factors  # noqa: E402
from twinbench.bench.statistics.scores import score  # noqa: E402
from twinbench.common.store import Store, write_csv, write_text  # noqa: E402
from twinbench.common.threads import pin_torch  # noqa: E402
from twinbench.common.versions import provenance  # noqa: E402
from twinbench.common.workers import side_by_side  # noqa: E402
from twinbench.data.batch import Batch  # noqa: E402

DELAY_SEED = 58217
"""Of the fresh recordings: of no other study, and nothing was chosen on them."""
DELAYS_S = (10.0, 30.0, 60.0, 120.0, 300.0)
HINDSIGHT = "oracle_smoother"

Halves = tuple[Batch, Batch]


def _scores(halves: Halves, seen: list[Estimates], row: str, own: list[Estimates] | None = None) -> pd.DataFrame:
    """Scores of both halves with column ``row``; intervals stretched by what the other half needs of ``own``."""
    stretch = [factors(estimates, half) for estimates, half in zip(own or seen, halves, strict=True)]
    parts = [
        score(replace(estimates, factors=others), half)
        for estimates, half, others in zip(seen, halves, reversed(stretch), strict=True)
    ]
    return pd.concat(parts, ignore_index=True).assign(row=row)


def judge_delays(store: Store, cell: Cell, halves: Halves) -> pd.DataFrame:
    """Scores of a trained estimator without and with each delay, columns ``sequence, metric, value, row``."""
    pin_torch()
    estimator, every = load_fit(store, cell), EVALUATION.stride
    seen = [evaluate(estimator, half.without_truth(), EVALUATION, cell.seed) for half in halves]
    tables = [_scores(halves, seen, cell.estimator)]
    for delay_s in DELAYS_S if estimator.delayed else ():
        later = [known_later(estimator, e, half, every, delay_s) for e, half in zip(seen, halves, strict=True)]
        tables.append(_scores(halves, later, f"{delay_s:g}{LATER}", seen))
    return pd.concat(tables, ignore_index=True)


def judge_slopes(store: Store, cell: Cell, halves: Halves) -> pd.DataFrame:
    """Scores of forecasts, and of health corrected by its own slopes, columns as above."""
    pin_torch()
    estimator = load_fit(store, cell)
    seen = [evaluate(estimator, half.without_truth(), EVALUATION, cell.seed) for half in halves]
    tables = []
    for name, foretold in FORECASTS.items():
        own = [foretold(estimator, e, half, cell.seed) for e, half in zip(seen, halves, strict=True)]  # type: ignore[arg-type]
        tables.append(_scores(halves, own, name, seen))
    own = [corrected(e, half) for e, half in zip(seen, halves, strict=True)]
    tables.append(_scores(halves, own, "corrected", seen))
    return pd.concat(tables, ignore_index=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--profile", default="quick")
    parser.add_argument("--results", type=Path, metavar="DIR")
    parser.add_argument("--recordings", type=int, default=60, metavar="N", help="fresh ones, both halves together")
    parser.add_argument("--out", type=Path, default=Path("results/delay"), metavar="DIR")
    a = parser.parse_args()
    store, cells = trained_cells(Training(a.profile, a.results), [PROPOSED, REFERENCE, HINDSIGHT])
    halves = fresh_halves(load_profile(a.profile), a.recordings // 2, DELAY_SEED)
    todo = {f"delays: {cell}": (store, cell, halves) for cell in cells}
    delays = pd.concat(list(side_by_side(judge_delays, todo, print)), ignore_index=True)
    ours = {f"slopes: {cell}": (store, cell, halves) for cell in cells if cell.estimator == PROPOSED}
    slopes = pd.concat(list(side_by_side(judge_slopes, ours, print)), ignore_index=True)
    write_csv(a.out / "delays.csv", delays)
    write_csv(a.out / "slopes.csv", slopes)
    shown = [delay_table(delays), forecast_table(slopes), slope_table(slopes)]
    write_tables(a.out, shown)
    about = {"profile": a.profile, "recordings": a.recordings, "seed": DELAY_SEED, "provenance": provenance()}
    write_text(a.out / "delay.json", json.dumps(about, indent=2) + "\n")
    print("\n".join(map(to_text, shown)))


if __name__ == "__main__":
    main()
