"""How estimators bear harder conditions: a trial is a trained estimator under one condition of ``data.disturb``."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import pandas as pd

from twinbench.bench import cells
from twinbench.bench.cells import Cell, Outcome
from twinbench.bench.estimates import Estimates
from twinbench.bench.evaluate import run as evaluate
from twinbench.bench.profile import Evaluation, Profile
from twinbench.bench.results import HARDER
from twinbench.bench.roster import PROPOSED, is_ablation
from twinbench.bench.statistics.scores import score
from twinbench.bench.statistics.subject import PAPERS, Subject, subject_of
from twinbench.common.store import Store, key_of
from twinbench.common.versions import code_version
from twinbench.data.batch import Batch
from twinbench.data.benchmark import DesignConfig
from twinbench.data.disturb import FAULT_BEGINS_S, UNDISTURBED, Condition, conditions, simulate_condition
from twinbench.machines.load import machine_at

COLUMNS = list(HARDER)


def metrics_of(subject: Subject) -> tuple[str, ...]:
    """The scores that are kept of a trial."""
    rest = ("health_life_pct", "parameter_error_pct", "coverage95_pct", "nis_ratio")
    return (*subject.state_errors, *subject.forecast_errors, *rest)


def afterwards_of(subject: Subject) -> dict[str, str]:
    """Scores of the time after a fault, and what they are called."""
    named = {f"{o.key}_nrmse_pct": f"{o.key}_after_pct" for o in subject.outputs}
    return named | {"health_life_pct": "health_after_fault_pct"}


METRICS = metrics_of(PAPERS)
"""Those of the compressor."""
RECOVERY_S = 60.0
"""After a fault's end an estimate has so long to be as good again as without the fault."""
KIND, SUFFIX = "trial", ".csv"
TREATMENTS = ("trust_alone", "extrapolation_alone", "no_trust")
"""Ablations of the proposed method that treat loads beyond the envelope otherwise."""
EVALUATION = Evaluation(stride=10)


@dataclass(frozen=True)
class Trial:
    """One estimator under one condition, and the key of its scores in the store."""

    cell: Cell
    condition: Condition
    key: str

    def __str__(self) -> str:
        return f"{self.cell}, {self.condition.name}"


def trials(done: Sequence[Cell], profile: Profile) -> list[Trial]:
    """Every condition for every estimator with every seed, once where seeds share what they learnt.

    The proposed method's other treatments of the envelope are tried on that. All trials of one condition follow each
    other: to simulate it takes longer than most estimators do.
    """
    found, whole = [], [cell for cell in done if not is_ablation(cell.estimator)]
    ours = [cell for cell in whole if cell.estimator == PROPOSED]
    treated = [cells.make_cell(f"{cell.spec}:{name}", cell.seed, profile) for cell in ours for name in TREATMENTS]
    for condition in (UNDISTURBED, *conditions(machine_at(profile.machine))):
        tried = [*whole, *treated] if condition.group == "envelope" else whole
        found += [_trial(cell, condition, profile) for cell in tried]
    return list({t.key: t for t in found[::-1]}.values())[::-1]


def _trial(cell: Cell, condition: Condition, profile: Profile) -> Trial:
    code = [code_version("twinbench.data.disturb"), code_version("twinbench.bench.robustness")]
    online = cells.online(cell)
    key = key_of(fit=cell.fit, online=online, condition=asdict(condition), design=asdict(profile.data), code=code)
    return Trial(cell, condition, key)


def attempt(store: Store, profile: Profile, trial: Trial) -> Outcome:
    """Run a trial unless it is done, and keep its scores."""

    def work() -> Callable[[Path], None]:
        batch = _sequences(profile.data, trial.condition, trial.cell.machine)
        estimator = cells.load_fit(store, trial.cell)
        estimates = evaluate(estimator, batch.without_truth(), EVALUATION, trial.cell.seed)
        table = scores_under(estimates, batch, trial)
        return lambda path: table.to_csv(path, index=False)

    outcome = cells.attempt(store, KIND, trial.cell, trial.key, work, SUFFIX)
    return replace(outcome, stage=f"robustness: {trial.condition.name}")


@functools.lru_cache(maxsize=1)
def _sequences(config: DesignConfig, condition: Condition, machine: str) -> Batch:
    return simulate_condition(config, condition, machine_at(machine))


def finished(store: Store, planned: Sequence[Trial]) -> list[pd.DataFrame]:
    """The scores of those trials that did not fail, columns COLUMNS."""
    return [pd.read_csv(store.path(KIND, t.key, SUFFIX)) for t in planned if store.has(KIND, t.key, SUFFIX)]


def scores_under(estimates: Estimates, batch: Batch, trial: Trial) -> pd.DataFrame:
    """Scores of one trial, sequence by sequence, with those of the time after any fault."""
    table = score(estimates, batch)
    kept = metrics_of(subject_of(batch.machine))
    table = pd.concat([table[table["metric"].isin(kept)], _afterwards(estimates, batch)], ignore_index=True)
    cell, condition = trial.cell, trial.condition
    table = table.assign(estimator=cell.estimator, seed=cell.seed, group=condition.group, condition=condition.name)
    return table[COLUMNS]


def _afterwards(estimates: Estimates, batch: Batch) -> pd.DataFrame:
    """Errors from RECOVERY_S after the end of the longest fault on, as ``..._after_pct``."""
    longest = max(c.fault.seconds for c in conditions(batch.machine) if c.fault is not None)
    late = estimates.time_s >= min(FAULT_BEGINS_S, 0.5 * estimates.time_s[-1]) + longest + RECOVERY_S
    if not late.any():
        return pd.DataFrame(columns=["sequence", "metric", "value"])
    ticks = {f: getattr(estimates, f)[:, late] for f in ("mean", "low", "high", "nis", "nis_dof", "flags")}
    table = score(replace(estimates, time_s=estimates.time_s[late], **ticks), batch)
    called = afterwards_of(subject_of(batch.machine))
    return table[table["metric"].isin(called)].replace({"metric": called})
