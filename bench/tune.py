"""Choose an estimator's settings on the validation sequences: every estimator gets the same number of trials."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Mapping, Sequence
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
from twinbench.bench.statistics.scores import score
from twinbench.bench.statistics.subject import Subject, subject_of
from twinbench.bench.statistics.summary import LIFE
from twinbench.common.errors import BadInput
from twinbench.common.progress import Progress
from twinbench.common.store import Store, check_writable, write_csv, write_text
from twinbench.common.versions import provenance
from twinbench.machines.load import load_machine, machine_at
from twinbench.methods.estimator import Estimator

FAILED = 1e6
"""Score of settings with which an estimator fails."""
MOST_TRIALS = 10_000
"""More is a slip of the finger."""
EVALUATION = Evaluation(stride=10)
TUNE_SEED = 0


def errors_of(subject: Subject) -> tuple[tuple[str, ...], ...]:
    """What a twin is for: to know a machine's health, to say what it does, and to say what it will do.

    The three count alike; each is the mean of its metrics.
    """
    return (LIFE,), subject.state_errors, subject.forecast_errors


def coverages_of(subject: Subject) -> tuple[str, ...]:
    """Noted, and not chosen by: every quantity's intervals are calibrated afterwards, on other recordings.

    Settings that err least came out with intervals as narrow, and as even over the regimes, as settings whose own
    intervals hold.
    """
    return tuple(f"coverage_{q.name}_pct" for q in subject.quantities)


def merit(subject: Subject, means: Mapping[str, float]) -> float:
    """Geometric mean of ``errors_of``: it asks what share of each is saved, and no unit decides.

    Args:
        subject: what is estimated.
        means: by metric, over the validation recordings.
    """
    errors = [np.mean([means[m] for m in metrics]) for metrics in errors_of(subject)]
    return float(np.exp(np.mean(np.log(errors))))


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
    subject = subject_of(load_machine(profile.machine))
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
            study.tell(trial, _merit_of(subject, means))
            going.step(len(_finished(study)) - going.done)
    return _write(kind, subject, study, out, {"command": command, "wall_s": round(time.time() - began, 1)})


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
    """What the merit of some settings on the validation sequences is made of, or why they failed."""
    own = {**profile.settings.get(kind.name, {}), **chosen}
    profile = replace(profile, settings={**profile.settings, kind.name: own})
    cell = cells.make_cell(spec, TUNE_SEED, profile)
    began = time.perf_counter()
    cells.ensure_data(store, profile, cell.data)
    outcome = cells.fit(store, profile, cell)
    if outcome.reason:
        return {"failed": outcome.reason}
    validation = cells.load_split(store, cell).validation
    try:
        estimates = evaluate(cells.load_fit(store, cell), validation.without_truth(), EVALUATION, TUNE_SEED)
    except FloatingPointError as error:
        return {"failed": str(error)}
    table = score(estimates, validation).groupby("metric")["value"].mean()
    subject = subject_of(machine_at(profile.machine))
    wanted = (*(m for metrics in errors_of(subject) for m in metrics), *coverages_of(subject))
    means = {m: float(table[m]) for m in wanted}
    if not np.isfinite(merit(subject, means)):
        return {"failed": "an error is no number"}
    return {**means, "seconds": round(time.perf_counter() - began, 1)}


def _write(kind: type[Estimator], subject: Subject, study: optuna.Study, out: Path, facts: dict[str, Any]) -> str:
    done = _finished(study)
    merits = [_merit_of(subject, t.user_attrs) for t in done]
    rows = zip(done, merits, strict=True)
    table = pd.DataFrame([{"trial": t.number, **t.params, "merit": value, **_measured(t)} for t, value in rows])
    write_csv(out / f"{kind.name}.csv", table)
    first = int(np.argmin(merits))
    best = {name: _rounded(value) for name, value in done[first].params.items()}
    lines = [f"# The best of {len(done)} trials; merit {merits[first]:.4g}.", f"[settings.{kind.name}]"]
    section = "\n".join([*lines, *(f"{n} = {v!r}" for n, v in best.items())]) + "\n"
    write_text(out / f"{kind.name}.toml", section)
    about = {"estimator": kind.name, "trials": len(done), "seed": TUNE_SEED, **facts, **provenance()}
    write_text(out / f"{kind.name}.json", json.dumps(about, indent=2) + "\n")
    return section


def _merit_of(subject: Subject, measured: Mapping[str, Any]) -> float:
    return FAILED if "failed" in measured else merit(subject, measured)


def _measured(trial: optuna.trial.FrozenTrial) -> dict[str, Any]:
    """What was measured; a journal may hold the merit that counted when it was written."""
    return {name: value for name, value in trial.user_attrs.items() if name != "merit"}


def _rounded(value: Any) -> Any:
    return float(f"{value:.4g}") if isinstance(value, float) else value
