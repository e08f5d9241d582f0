"""What calibrated intervals hold by quantity and regime, and errors, over many more recordings than a run tests on.

    python -m twinbench.bench.benchmarks.coverage --profile paper --results results/paper --out results/coverage

Coverage of few recordings scatters by some per cent. So fresh ones are simulated, of the same population as the
run's: each half of them is judged by the factors of the other half. Beside it stands what an exact posterior of a
small case holds in the same regimes. Errors on so many recordings tell apart what a run leaves open.
"""

from __future__ import annotations

from dataclasses import replace

from twinbench.common.threads import pin

pin()

import pandas as pd  # noqa: E402  threads are pinned before NumPy is there

from twinbench.bench.benchmarks import exact_posterior  # noqa: E402
from twinbench.bench.benchmarks.coverage_tables import errors_table, exact_table, right_pairs  # noqa: E402
from twinbench.bench.benchmarks.fresh import Halves, factors_of_the_other, fresh_halves, leave, parser  # noqa: E402
from twinbench.bench.calibrate import EVALUATION  # noqa: E402
from twinbench.bench.cells import Cell, load_fit  # noqa: E402
from twinbench.bench.estimate.apply import Training, trained_cells  # noqa: E402
from twinbench.bench.evaluate import run as evaluate  # noqa: E402
from twinbench.bench.report.tables import calibrated_regimes  # noqa: E402
from twinbench.bench.roster import PROPOSED, REFERENCE  # noqa: E402
from twinbench.bench.statistics.coverage import coverage_by_regime, coverage_table  # noqa: E402
from twinbench.bench.statistics.regimes import regimes_of  # noqa: E402
from twinbench.bench.statistics.scores import score  # noqa: E402
from twinbench.bench.statistics.subject import subject_of  # noqa: E402
from twinbench.bench.statistics.summary import LIFE  # noqa: E402
from twinbench.common.store import Store  # noqa: E402
from twinbench.common.threads import pin_torch  # noqa: E402
from twinbench.common.workers import side_by_side  # noqa: E402

SEED = 77031
"""Of the fresh recordings: of no other study, and nothing was chosen on them."""


def judge(store: Store, cell: Cell, halves: Halves) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Of one trained estimator: coverage, as ``coverage_by_regime`` gives it, with columns ``estimator, seed``; scores,
    as ``score`` gives them, with its name in a column ``row``."""
    pin_torch()
    estimator = load_fit(store, cell)
    seen = [evaluate(estimator, half.without_truth(), EVALUATION, cell.seed) for half in halves]
    parts = [
        coverage_by_regime(replace(estimates, factors=others), half)
        for estimates, half, others in zip(seen, halves, factors_of_the_other(seen, halves), strict=True)
    ]
    scores = pd.concat([score(e, half) for e, half in zip(seen, halves, strict=True)], ignore_index=True)
    coverage = pd.concat(parts, ignore_index=True).assign(estimator=cell.estimator, seed=cell.seed)
    return coverage, scores.assign(row=cell.estimator)


def main() -> None:
    options = parser((__doc__ or "").splitlines()[0], "coverage", recordings=300)
    options.add_argument("--only", nargs="+", default=["deeponet_kalman", "oracle", "pinn_ukf"], metavar="NAME")
    asked = options.parse_args()
    store, cells = trained_cells(Training(asked.profile, asked.results), asked.only)
    halves = fresh_halves(asked, SEED)
    parts = list(side_by_side(judge, {str(cell): (store, cell, halves) for cell in cells}, print))
    coverage, scores = (pd.concat(tables, ignore_index=True) for tables in zip(*parts, strict=True))
    table, subject = coverage_table(coverage), subject_of(halves[0].machine)
    errors = scores[scores["metric"].isin([*subject.state_errors, LIFE])]
    exact = exact_posterior.table(SEED)
    shown = [right_pairs(table), calibrated_regimes(table, regimes_of(halves[0].machine)), exact_table(exact)]
    if {PROPOSED, REFERENCE} <= set(scores["row"]):
        shown.append(errors_table(scores, subject))
    leave(asked, "coverage", SEED, {"coverage.csv": table, "errors.csv": errors}, shown)


if __name__ == "__main__":
    main()
