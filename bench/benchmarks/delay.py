"""What time gives: estimates that wait for later readings, and forecasts along a slope of health.

    python -m twinbench.bench.benchmarks.delay --profile paper --results results/paper --out results/delay

DeepONet-Kalman says of each time what it knows a while later, on fresh recordings of the run's population. Each half
of them is judged by the factors of the other half, found without a delay. Beside it stands the oracle, with and
without hindsight. A second table has forecasts, a third what the filter's own slopes say of its error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

from twinbench.common.threads import pin

pin()

import pandas as pd  # noqa: E402  threads are pinned before NumPy is there

from twinbench.bench.benchmarks.delay_tables import LATER, delay_table, forecast_table, slope_table  # noqa: E402
from twinbench.bench.benchmarks.fresh import Halves, factors_of_the_other, fresh_halves, leave, parser  # noqa: E402
from twinbench.bench.benchmarks.slopes import EVALUATION, with_slopes  # noqa: E402
from twinbench.bench.cells import Cell, load_fit  # noqa: E402
from twinbench.bench.estimate.apply import Training, trained_cells  # noqa: E402
from twinbench.bench.estimate.delay import known_later  # noqa: E402
from twinbench.bench.estimates import Estimates  # noqa: E402
from twinbench.bench.evaluate import run as evaluate  # noqa: E402
from twinbench.bench.roster import PROPOSED, REFERENCE  # noqa: E402
from twinbench.bench.statistics.scores import score  # noqa: E402
from twinbench.common.store import Store  # noqa: E402
from twinbench.common.threads import pin_torch  # noqa: E402
from twinbench.common.workers import side_by_side  # noqa: E402
from twinbench.data.batch import Array  # noqa: E402
from twinbench.methods.deeponet_kalman.method import DeepONetKalman  # noqa: E402

DELAY_SEED = 58217
"""Of the fresh recordings: of no other study, and nothing was chosen on them."""
DELAYS_S = (10.0, 30.0, 60.0, 120.0, 300.0)
"""Each has a row; they reach from what causes of a step are weighed for to a sixth of a recording."""
HINDSIGHT = "oracle_smoother"
"""The reference that has the whole recording."""


def _scores(halves: Halves, seen: Sequence[Estimates], stretch: Sequence[Array], row: str) -> pd.DataFrame:
    """Scores of both halves with column ``row``; the intervals of each are stretched by its factors."""
    parts = [
        score(replace(estimates, factors=others), half)
        for estimates, half, others in zip(seen, halves, stretch, strict=True)
    ]
    return pd.concat(parts, ignore_index=True).assign(row=row)


def judge_delays(store: Store, cell: Cell, halves: Halves) -> pd.DataFrame:
    """Scores of a trained estimator without and with each delay, columns ``sequence, metric, value, row``."""
    pin_torch()
    estimator, every = load_fit(store, cell), EVALUATION.stride
    seen = [evaluate(estimator, half.without_truth(), EVALUATION, cell.seed) for half in halves]
    stretch = factors_of_the_other(seen, halves)
    tables = [_scores(halves, seen, stretch, cell.estimator)]
    for delay_s in DELAYS_S if estimator.delayed else ():
        later = [known_later(estimator, e, half, every, delay_s) for e, half in zip(seen, halves, strict=True)]
        tables.append(_scores(halves, later, stretch, f"{delay_s:g}{LATER}"))
    return pd.concat(tables, ignore_index=True)


def judge_slopes(store: Store, cell: Cell, halves: Halves) -> pd.DataFrame:
    """Scores of forecasts, and of health corrected by its own slopes, columns as above."""
    pin_torch()
    estimator = cast(DeepONetKalman, load_fit(store, cell))
    seen = [evaluate(estimator, half.without_truth(), EVALUATION, cell.seed) for half in halves]
    stretch = factors_of_the_other(seen, halves)
    rows = [with_slopes(estimator, estimates, half) for estimates, half in zip(seen, halves, strict=True)]
    tables = [_scores(halves, [row[name] for row in rows], stretch, name) for name in rows[0]]
    return pd.concat(tables, ignore_index=True)


def main() -> None:
    asked = parser((__doc__ or "").splitlines()[0], "delay", recordings=60).parse_args()
    store, cells = trained_cells(Training(asked.profile, asked.results), [PROPOSED, REFERENCE, HINDSIGHT])
    halves = fresh_halves(asked, DELAY_SEED)
    todo = {f"delays: {cell}": (store, cell, halves) for cell in cells}
    delays = pd.concat(list(side_by_side(judge_delays, todo, print)), ignore_index=True)
    ours = {f"slopes: {cell}": (store, cell, halves) for cell in cells if cell.estimator == PROPOSED}
    slopes = pd.concat(list(side_by_side(judge_slopes, ours, print)), ignore_index=True)
    shown = [delay_table(delays), forecast_table(slopes), slope_table(slopes)]
    leave(asked, "delay", DELAY_SEED, {"delays.csv": delays, "slopes.csv": slopes}, shown)


if __name__ == "__main__":
    main()
