"""Choose an estimator's settings on the validation sequences: every estimator gets the same number of trials."""

from __future__ import annotations

import json
import logging
import shlex
import time
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pandas as pd
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, Trial, TrialState
from rich.console import Console

from twinbench.bench import cells
from twinbench.bench.evaluate import run as evaluate
from twinbench.bench.profile import Evaluation, Profile, load_profile
from twinbench.bench.registry import find
from twinbench.bench.settings import check_settings, search_space
from twinbench.bench.statistics.scores import score
from twinbench.bench.statistics.subject import Subject, subject_of
from twinbench.bench.statistics.summary import LIFE
from twinbench.common.cost import Rates, foretold, rates_of
from twinbench.common.errors import BadInput
from twinbench.common.progress import Progress
from twinbench.common.store import Store, check_writable, write_csv, write_text
from twinbench.common.versions import provenance
from twinbench.common.workers import side_by_side
from twinbench.machines.load import load_machine, machine_at
from twinbench.methods.estimator import Estimator

FAILED = 1e6
"""Score of settings with which an estimator fails."""
MOST_TRIALS = 10_000
"""More is a slip of the finger."""
EVALUATION = Evaluation(stride=10)
TUNE_SEED = 0
TUNING = "tuning"
"""The profile of a command that names none."""
EARLIER_ROUNDS = Path("results") / "tuning"
"""Where rounds are that are asked for what a trial costs."""

_Asked = tuple[str, int]
"""An estimator's name, and a trial's number."""
_Searched = tuple[type[Estimator], dict[str, Any], dict[str, Sequence[Any]]]
"""An estimator, its settings in the profile, and the ranges of those that are searched."""


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


def _searched(spec: str, profile: Profile, online: bool) -> _Searched:
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


@dataclass(frozen=True)
class _Search:
    """The trials of one estimator.

    Attributes:
        own: its settings in the profile.
        spaces: what is searched, and where.
        randomly: so many trials are drawn at random; each later one learns from all before it.
    """

    spec: str
    kind: type[Estimator]
    own: Mapping[str, Any]
    spaces: Mapping[str, Sequence[Any]]
    study: optuna.Study
    randomly: int

    @property
    def finished(self) -> list[FrozenTrial]:
        return self.study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))

    def ask(self, trials: int) -> list[tuple[Trial, dict[str, Any]]]:
        """The next trials, of ``trials`` in all, and their settings: those that no other's outcome decides.

        The first is alone: others may share its training.
        """
        done = len(self.finished)
        count = max(min(self.randomly, trials) - done, 1) if done else 1
        asked = [self.study.ask() for _ in range(count if done < trials else 0)]
        defaults = self.kind.settings
        return [(t, {n: _suggest(t, n, defaults[n], space) for n, space in self.spaces.items()}) for t in asked]


def tune(
    specs: Sequence[str],
    profile: Profile,
    out: Path,
    trials: int,
    console: Console,
    command: str = "",
    online: bool = False,
) -> list[str]:
    """Try settings out of estimators' search spaces until each has had ``trials`` of them, earlier ones counted.

    The first trial is the profile's own settings. With ``online`` only those settings vary that act after training,
    so that one training serves all trials and may be as long as the benchmark's. Trials that do not learn from each
    other are done side by side: the random ones, and those of different estimators.

    Writes ``NAME.csv``, one row a trial, ``NAME.toml``, the best as a profile's section, and ``NAME.json``, what
    made them.

    Returns:
        What each ``NAME.toml`` holds.

    Raises:
        BadInput: nothing to tune, settings that the estimator does not have, or ``out`` cannot be written to.
    """
    if not 1 <= trials <= MOST_TRIALS:
        raise BadInput(f"--trials is {trials}, must lie in [1, {MOST_TRIALS}]")
    found = [(spec, _searched(spec, profile, online)) for spec in specs]  # bad input is told before anything is made
    profile = replace(profile, seeds=(TUNE_SEED,))
    subject = subject_of(load_machine(profile.machine))
    check_writable(out)
    out.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(logging.WARNING)
    searches = {search.kind.name: search for search in (_search(*one, profile, out, trials) for one in found)}
    began, store, key = time.time(), Store(out / "store"), cells.data_key(profile)
    done = sum(min(len(search.finished), trials) for search in searches.values())
    left = [(name,) for name, search in searches.items() for _ in range(trials - len(search.finished))]
    rates = rates_of_trials(list(searches), profile, out, online)
    console.print(foretold("trial", left, rates), highlight=False, markup=False, soft_wrap=True)
    with Progress(console) as progress, progress.stage("tune", trials * len(searches), done) as going:
        list(side_by_side(cells.ensure_data, {"simulate": (store, profile, key)}, progress.say, out))
        while asked := {(name, t.number): (t, own) for name, s in searches.items() for t, own in s.ask(trials)}:
            several = {
                f"tune: {name}, trial {number}": ((name, number), searches[name].spec, _set(profile, name, own), store)
                for (name, number), (_, own) in asked.items()
            }
            for (name, number), means in side_by_side(_measure, several, progress.say, out):
                trial, _ = asked[name, number]
                for metric, value in means.items():
                    trial.set_user_attr(metric, value)
                searches[name].study.tell(trial, _merit_of(subject, means))
                going.step()
    facts = {"command": command, "wall_s": round(time.time() - began, 1)}
    return [_write(search, subject, out, facts) for search in searches.values()]


def rates_of_trials(names: Sequence[str], profile: Profile, out: Path, online: bool) -> Rates:
    """What a trial of each took in a folder, or else in earlier rounds of the same profile and kind.

    Args:
        names: of estimators.
        out: the folder.
        online: only settings that act after training are searched.
    """
    rounds = [out, *(folder for folder in sorted(EARLIER_ROUNDS.glob("*")) if folder.resolve() != out.resolve())]
    found: dict[Path, dict[Hashable, float]] = {}
    for name in names:
        for folder in rounds:
            if folder == out or _alike(folder / f"{name}.json", profile, online):
                table = folder / f"{name}.csv"
                known = rates_of([table], ())[table]
                found[table] = {(name,): known[()]} if known else {}
    return found


def _alike(about: Path, profile: Profile, online: bool) -> bool:
    """Were an earlier round's trials of the same profile, and with the same kind of settings searched?"""
    try:
        words = shlex.split(json.loads(about.read_text())["command"])
        name = words[words.index("--profile") + 1] if "--profile" in words else TUNING
        if "--machine" in words or name != profile.name or ("--online" in words) != online:
            return False
        return load_profile(name).machine == profile.machine
    except (OSError, LookupError, TypeError, ValueError):
        return False


def _search(spec: str, what: _Searched, profile: Profile, out: Path, trials: int) -> _Search:
    """An estimator's trials, with what an earlier run left of them; what that one had not finished comes first."""
    kind, own, spaces = what
    randomly = max(4, trials // 4)
    study = optuna.create_study(
        storage=JournalStorage(JournalFileBackend(str(out / f"{kind.name}.journal"))),
        study_name=cells.make_cell(spec, TUNE_SEED, profile).fit,
        sampler=optuna.samplers.TPESampler(seed=TUNE_SEED, multivariate=True, n_startup_trials=randomly),
        load_if_exists=True,
    )
    for left in study.get_trials(states=(TrialState.RUNNING,)):
        study.enqueue_trial(left.params)
        study.tell(left.number, state=TrialState.FAIL)
    if not study.trials:
        study.enqueue_trial({name: own[name] for name in spaces})
    return _Search(spec, kind, own, spaces, study, randomly)


def _suggest(trial: Trial, name: str, default: Any, space: Sequence[float]) -> Any:
    if isinstance(space, list):
        return trial.suggest_categorical(name, space)
    low, high = space
    if isinstance(default, int):
        return trial.suggest_int(name, int(low), int(high), log=True)
    return trial.suggest_float(name, low, high, log=True)


def _measure(asked: _Asked, spec: str, profile: Profile, store: Store) -> tuple[_Asked, dict[str, Any]]:
    """What the merit of a profile's settings on the validation sequences is made of, or why they failed."""
    cell = cells.make_cell(spec, TUNE_SEED, profile)
    began = time.perf_counter()
    outcome = cells.fit(store, profile, cell)
    if outcome.reason:
        return asked, {"failed": outcome.reason}
    validation = cells.load_split(store, cell).validation
    try:
        estimates = evaluate(cells.load_fit(store, cell), validation.without_truth(), EVALUATION, TUNE_SEED)
    except FloatingPointError as error:
        return asked, {"failed": str(error)}
    table = score(estimates, validation).groupby("metric")["value"].mean()
    subject = subject_of(machine_at(profile.machine))
    wanted = (*(m for metrics in errors_of(subject) for m in metrics), *coverages_of(subject))
    means = {m: float(table[m]) for m in wanted}
    if not np.isfinite(merit(subject, means)):
        return asked, {"failed": "an error is no number"}
    return asked, {**means, "seconds": round(time.perf_counter() - began, 1)}


def _set(profile: Profile, name: str, own: Mapping[str, Any]) -> Profile:
    """The profile with other settings of an estimator."""
    return replace(profile, settings={**profile.settings, name: {**profile.settings.get(name, {}), **own}})


def _write(search: _Search, subject: Subject, out: Path, facts: dict[str, Any]) -> str:
    kind, done = search.kind, search.finished
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


def _measured(trial: FrozenTrial) -> dict[str, Any]:
    """What was measured; a journal may hold the merit that counted when it was written."""
    return {name: value for name, value in trial.user_attrs.items() if name != "merit"}


def _rounded(value: Any) -> Any:
    return float(f"{value:.4g}") if isinstance(value, float) else value
