"""What calibrated intervals hold by quantity and regime, and errors, over many more recordings than a run tests on.

    python -m twinbench.bench.benchmarks.coverage --profile paper --results results/paper --out results/coverage

Coverage of few recordings scatters by some per cent. So fresh ones are simulated, of the same population as the
run's: each half of them is judged by the factors of the other half. Beside it stands what an exact posterior of a
small case holds in the same regimes. Errors on so many recordings tell apart what a run leaves open.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from twinbench.common.threads import pin

pin()

import pandas as pd  # noqa: E402  threads are pinned before NumPy is there

from twinbench.bench.benchmarks import exact_posterior  # noqa: E402
from twinbench.bench.benchmarks.coverage_tables import errors_table, exact_table, right_pairs  # noqa: E402
from twinbench.bench.calibrate import EVALUATION  # noqa: E402
from twinbench.bench.cells import Cell, load_fit  # noqa: E402
from twinbench.bench.estimate.apply import Training, trained_cells  # noqa: E402
from twinbench.bench.estimates import Estimates  # noqa: E402
from twinbench.bench.evaluate import run as evaluate  # noqa: E402
from twinbench.bench.profile import Profile, load_profile  # noqa: E402
from twinbench.bench.report.provenance import write_tables  # noqa: E402
from twinbench.bench.report.table_formats import to_text  # noqa: E402
from twinbench.bench.report.tables import calibrated_regimes  # noqa: E402
from twinbench.bench.roster import PROPOSED, REFERENCE  # noqa: E402
from twinbench.bench.statistics.conformal import factors  # noqa: E402
from twinbench.bench.statistics.coverage import coverage_by_regime, coverage_table  # noqa: E402
from twinbench.bench.statistics.regimes import regimes_of  # noqa: E402
from twinbench.bench.statistics.scores import score  # noqa: E402
from twinbench.bench.statistics.subject import subject_of  # noqa: E402
from twinbench.bench.statistics.summary import LIFE  # noqa: E402
from twinbench.common.store import Store, write_csv, write_text  # noqa: E402
from twinbench.common.threads import pin_torch  # noqa: E402
from twinbench.common.versions import provenance  # noqa: E402
from twinbench.common.workers import side_by_side  # noqa: E402
from twinbench.data.batch import Array, Batch  # noqa: E402
from twinbench.data.benchmark import simulate_benchmark  # noqa: E402
from twinbench.machines.load import load_machine  # noqa: E402

SEED = 77031
"""Of the fresh recordings: of no other study, and nothing was chosen on them."""


def fresh_halves(profile: Profile, each: int, seed: int = SEED) -> tuple[Batch, Batch]:
    """Two sets of so many recordings of the profile's population."""
    design = replace(profile.data, seed=seed, n_train=1, n_validation=1, n_calibration=each, n_test=each, n_single=0)
    split = simulate_benchmark(design, profile.corruption, load_machine(profile.machine))
    return split.calibration, split.test


def factors_of_the_other(seen: Sequence[Estimates], halves: Sequence[Batch]) -> list[Array]:
    """Of each half, the factors (n,), dimensionless, that the other half's intervals need."""
    return [factors(estimates, half) for estimates, half in zip(seen, halves, strict=True)][::-1]


def judge(store: Store, cell: Cell, halves: tuple[Batch, Batch]) -> tuple[pd.DataFrame, pd.DataFrame]:
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
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--profile", default="quick")
    parser.add_argument("--results", type=Path, metavar="DIR")
    parser.add_argument("--only", nargs="+", default=["deeponet_kalman", "oracle", "pinn_ukf"], metavar="NAME")
    parser.add_argument("--recordings", type=int, default=300, metavar="N", help="fresh ones, both halves together")
    parser.add_argument("--out", type=Path, default=Path("results/coverage"), metavar="DIR")
    a = parser.parse_args()
    store, cells = trained_cells(Training(a.profile, a.results), a.only)
    halves = fresh_halves(load_profile(a.profile), a.recordings // 2)
    parts = list(side_by_side(judge, {str(cell): (store, cell, halves) for cell in cells}, print))
    coverage, scores = (pd.concat(tables, ignore_index=True) for tables in zip(*parts, strict=True))
    table, subject = coverage_table(coverage), subject_of(halves[0].machine)
    exact = exact_posterior.table(SEED)
    write_csv(a.out / "coverage.csv", table)
    write_csv(a.out / "errors.csv", scores[scores["metric"].isin([*subject.state_errors, LIFE])])
    shown = [right_pairs(table), calibrated_regimes(table, regimes_of(halves[0].machine)), exact_table(exact)]
    if {PROPOSED, REFERENCE} <= set(scores["row"]):
        shown.append(errors_table(scores, subject))
    write_tables(a.out, shown)
    about = {"profile": a.profile, "recordings": a.recordings, "seed": SEED, "provenance": provenance()}
    write_text(a.out / "coverage.json", json.dumps(about, indent=2) + "\n")
    print("\n".join(map(to_text, shown)))


if __name__ == "__main__":
    main()
