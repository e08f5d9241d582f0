"""Choose an estimator's settings on the validation sequences: every estimator gets the same number of trials."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pandas as pd
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState
from rich.console import Console

from twinbench.bench import cells
from twinbench.bench.evaluate import run as evaluate
from twinbench.bench.profile import Evaluation, Profile
from twinbench.bench.registry import find
from twinbench.bench.settings import check_settings, search_space
from twinbench.bench.statistics.scores import FORECAST_ERRORS, STATE_ERRORS, score
from twinbench.bench.statistics.summary import LIFE
from twinbench.common.errors import BadInput
from twinbench.common.progress import Progress
from twinbench.common.store import Store, check_writable, write_csv, write_text
from twinbench.common.versions import provenance
from twinbench.data.batch import ESTIMATED
from twinbench.methods.estimator import Estimator

ERRORS = ((LIFE,), STATE_ERRORS, FORECAST_ERRORS)
"""What a twin is for: to know a machine's health, to say what it does, and to say what it will do. The three count
alike; each is the mean of its metrics."""
COVERAGES = tuple(f"coverage_{name}_pct" for name in ESTIMATED)
HONEST_PCT = (90.0, 98.0)
"""Coverage of a quantity that costs nothing: calibration puts the rest right. A narrower band trades errors for widths
that are calibrated anyway; without one, intervals become so wrong that no factor serves every regime."""
COVERAGE_PENALTY = 0.05
"""Of one per cent that the ten quantities' coverage lies outside that band, in their mean: the share by which it makes
the errors worse. With twice as much some settings are chosen for their intervals alone, with none for their errors."""
FAILED = 1e6
"""Score of settings with which an estimator fails."""
MOST_TRIALS = 10_000
"""More is a slip of the finger."""
EVALUATION = Evaluation(stride=10)
TUNE_SEED = 0


def merit(means: dict[str, float]) -> float:
    """Geometric mean of ERRORS, with a penalty for wrong coverage.

    A geometric mean asks what share of each error is saved, and no unit decides. The penalty is a share of the errors
    and counts both ways: intervals that hold everything say nothing.

    Args:
        means: by metric, over the validation recordings.
    """
    errors = [np.mean([means[m] for m in metrics]) for metrics in ERRORS]
    low, high = HONEST_PCT
    outside = np.mean([max(low - means[m], means[m] - high, 0.0) for m in COVERAGES])
    return float(np.exp(np.mean(np.log(errors))) * (1.0 + COVERAGE_PENALTY * outside))


def searched(
    spec: str, profile: Profile, online: bool
) -> tuple[type[Estimator], dict[str, Any], dict[str, Sequence[Any]]]:
    """An estimator, its settings in the profile, and the ranges of those that are searched.

    Raises:
        BadInput: nothing to tune, or settings that the estimator does not have.
    """
    kind = find(spec)
    names = [name for name in kind.search_space if not online or name in kind.online]
    if not names:
        raise BadInput(f"{kind.name} has no search space, so nothing to tune; declare one in the class")
    check_settings([kind], profile)
    own = {**kind.settings, **profile.settings.get(kind.name, {})}
    return kind, own, {name: search_space(kind, name, own[name]) for name in names}


def tune(
    spec: str, profile: Profile, out: Path, trials: int, console: Console, command: str = "", online: bool = False
) -> str:
    """Try settings out of an estimator's search space until there are ``trials`` of them, earlier ones counted.

    The first trial is the profile's own settings. With ``online`` only those settings vary that act after training,
    so that one training serves all trials and may be as long as the benchmark's.

    Writes ``NAME.csv``, one row a trial, ``NAME.toml``, the best as a profile's section, and ``NAME.json``, what
    made them.

    Returns:
        What ``NAME.toml`` holds.

    Raises:
        BadInput: nothing to tune, settings that the estimator does not have, or ``out`` cannot be written to.
    """
    if not 1 <= trials <= MOST_TRIALS:
        raise BadInput(f"--trials is {trials}, must lie in [1, {MOST_TRIALS}]")
    kind, own, spaces = searched(spec, profile, online)
    check_writable(out)
    out.mkdir(parents=True, exist_ok=True)
    store = Store(out / "store")
    optuna.logging.set_verbosity(logging.WARNING)
    study = optuna.create_study(
        storage=JournalStorage(JournalFileBackend(str(out / f"{kind.name}.journal"))),
        study_name=cells.make_cell(spec, TUNE_SEED, replace(profile, seeds=(TUNE_SEED,))).fit,
        sampler=optuna.samplers.TPESampler(seed=TUNE_SEED, multivariate=True, n_startup_trials=max(4, trials // 4)),
        load_if_exists=True,
    )
    if not study.trials:
        study.enqueue_trial({name: own[name] for name in spaces})
    began = time.time()
    before = len(_finished(study))
    with Progress(console) as progress, progress.stage(f"tune {kind.name}", trials, min(before, trials)) as going:
        while len(_finished(study)) < trials:
            trial = study.ask()
            chosen = {name: _suggest(trial, name, kind.settings[name], space) for name, space in spaces.items()}
            means = _measure(spec, kind, replace(profile, seeds=(TUNE_SEED,)), chosen, store)
            for name, value in means.items():
                trial.set_user_attr(name, value)
            study.tell(trial, means["merit"])
            going.step(len(_finished(study)) - going.done)
    return _write(kind, study, out, {"command": command, "wall_s": round(time.time() - began, 1)})


def _finished(study: optuna.Study) -> list[optuna.trial.FrozenTrial]:
    return study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))


def _suggest(trial: optuna.Trial, name: str, default: Any, space: Sequence[float]) -> Any:
    if isinstance(space, list):
        return trial.suggest_categorical(name, space)
    low, high = space
    if isinstance(default, int):
        return trial.suggest_int(name, int(low), int(high), log=True)
    return trial.suggest_float(name, low, high, log=True)


def _measure(
    spec: str, kind: type[Estimator], profile: Profile, chosen: dict[str, Any], store: Store
) -> dict[str, Any]:
    """Merit of some settings on the validation sequences, and what it is made of."""
    own = {**profile.settings.get(kind.name, {}), **chosen}
    profile = replace(profile, settings={**profile.settings, kind.name: own})
    cell = cells.make_cell(spec, TUNE_SEED, profile)
    began = time.perf_counter()
    cells.ensure_data(store, profile, cell.data)
    outcome = cells.fit(store, profile, cell)
    if outcome.reason:
        return {"merit": FAILED, "failed": outcome.reason}
    validation = cells.load_split(store, cell.data).validation
    try:
        estimates = evaluate(cells.load_fit(store, cell), validation.without_truth(), EVALUATION, TUNE_SEED)
    except FloatingPointError as error:
        return {"merit": FAILED, "failed": str(error)}
    table = score(estimates, validation).groupby("metric")["value"].mean()
    means = {m: float(table[m]) for m in (*(m for metrics in ERRORS for m in metrics), *COVERAGES)}
    found = merit(means)
    if not np.isfinite(found):
        return {"merit": FAILED, "failed": "an error is no number"}
    return {"merit": found, **means, "seconds": round(time.perf_counter() - began, 1)}


def _write(kind: type[Estimator], study: optuna.Study, out: Path, facts: dict[str, Any]) -> str:
    done = _finished(study)
    table = pd.DataFrame([{"trial": t.number, **t.params, **t.user_attrs} for t in done])
    write_csv(out / f"{kind.name}.csv", table)
    best = {name: _rounded(value) for name, value in study.best_trial.params.items()}
    lines = [f"# The best of {len(done)} trials; merit {study.best_value:.4g}.", f"[settings.{kind.name}]"]
    section = "\n".join([*lines, *(f"{n} = {v!r}" for n, v in best.items())]) + "\n"
    write_text(out / f"{kind.name}.toml", section)
    about = {"estimator": kind.name, "trials": len(done), "seed": TUNE_SEED, **facts, **provenance()}
    write_text(out / f"{kind.name}.json", json.dumps(about, indent=2) + "\n")
    return section


def _rounded(value: Any) -> Any:
    return float(f"{value:.4g}") if isinstance(value, float) else value
