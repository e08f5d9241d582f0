"""The whole chain: data → fit → estimate → scores → latency → report. Resumable at any moment."""

from __future__ import annotations

import contextlib
import logging
import operator
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from rich.console import Console

from twinbench.bench import cells, robustness, run_files, scenes
from twinbench.bench.cells import Cell, Outcome
from twinbench.bench.cost import foretold
from twinbench.bench.earlier import Earlier, read_earlier, what_differs
from twinbench.bench.latency import estimators as latency
from twinbench.bench.profile import Profile
from twinbench.bench.registry import discover, find
from twinbench.bench.report.table_formats import Table
from twinbench.bench.report.words import names_of
from twinbench.bench.report.write import write_report
from twinbench.bench.roster import ABLATION, TRUE_START, is_ablation, label, ordered
from twinbench.bench.settings import check_settings
from twinbench.bench.statistics.health import true_start_held
from twinbench.bench.statistics.scores import score
from twinbench.common.errors import BadInput
from twinbench.common.filespec import join_spec, split_spec
from twinbench.common.progress import Progress
from twinbench.common.store import Store, check_writable, sweep
from twinbench.common.workers import side_by_side
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.load import load_machine

log = logging.getLogger(__name__)

Key = Callable[[Cell], str]
FIT: Key = operator.attrgetter("fit")
ESTIMATES: Key = operator.attrgetter("estimates")


class Finished(NamedTuple):
    """How a run ended: the cells that failed while the others went on, and how the estimators compare."""

    failed: list[Outcome]
    comparison: Table


@dataclass(frozen=True)
class Wanted:
    """What of a profile is to be run.

    Attributes:
        only: the estimators to run; all if left out. All of them begin a new comparison where that in the folder is of
            other recordings.
        ablations: each of them without each of its parts, too.
        harder: under the conditions of ``data.disturb``, too.
        resume: finished cells of an earlier run are kept.
    """

    only: tuple[str, ...] = ()
    ablations: bool = False
    harder: bool = False
    resume: bool = True


def run(
    profile: Profile,
    out: Path,
    wanted: Wanted = Wanted(),
    command: str = "",
    console: Console | None = None,
) -> Finished:
    """Run a profile into ``out``, beside what is there. Rows of estimators that are not run stay.

    It is run in processes of this machine, or on the cluster that ``common.cluster.working_on`` names.

    Raises:
        BadInput: an unknown estimator or setting, a folder that cannot be written to, or some estimators alone
            for a folder with a comparison on other recordings.
    """
    console = console or Console(stderr=True)
    store = Store(out / "store")
    load_machine(profile.machine)  # tried before anything is written
    todo = plan(profile, wanted.only, wanted.ablations)
    before = _before(out, profile, todo[0].data, bool(wanted.only), wanted.resume)
    check_writable(out)
    sweep(out)
    if not wanted.resume:
        _forget(store, profile, todo if wanted.only else None)
    _say_plan(console, profile, todo, store, out, before)
    with Progress(console) as progress:
        ran = _chain(_Stages(progress, out), store, profile, todo, wanted.harder)
    ran = replace(ran, command=command, unchanged=before.unchanged(todo) if wanted.resume else set())
    run_files.write(out, before, store, ran)
    return Finished(ran.failed, write_report(out))


@dataclass
class _Stages:
    """The parts of a run, each over all its items, and the seconds that each took."""

    progress: Progress
    out: Path
    walls: dict[str, float] = field(default_factory=dict)

    def over(self, name: str, work: Any, *arguments: Any) -> list[Any]:
        """``work`` on each of the last argument's items, as they finish."""
        *common, items = arguments
        results = []
        with self.timed(name), self.progress.stage(name, len(items)) as going:
            # Recordings, which are simulated as one item, are named by no more than their key.
            several = {name if isinstance(item, str) else f"{name}: {item}": (*common, item) for item in items}
            for result in side_by_side(work, several, self.progress.say, self.out):
                results.append(result)
                going.step()
                if isinstance(result, Outcome):
                    log.info("%s: %s: %s", name, result.cell, result.reason or "done")
        return results

    @contextlib.contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Keep what the block took."""
        start = time.perf_counter()
        yield
        self.walls[name] = round(time.perf_counter() - start, 2)


def _chain(stages: _Stages, store: Store, profile: Profile, todo: list[Cell], harder: bool) -> run_files.Ran:
    """Data, training, estimates, scores, scenes, harder conditions, latency."""
    stages.over("simulate", cells.ensure_data, store, profile, [todo[0].data])
    # Cells that differ in what works online share their training; seeds of who draws nothing share all.
    learners = _once(todo, FIT)
    failed = _failures(stages.over("train", cells.fit, store, profile, learners), todo, FIT)
    ready = _without(todo, failed)
    runs = _once(ready, ESTIMATES)
    failed += _failures(stages.over("estimate", cells.estimate, store, profile, runs), ready, ESTIMATES)
    good = _without(ready, failed)
    tables = stages.over("score", _score, store, good)
    if good:
        tables.append(_true_start(store, good[0]))
    papers = profile.machine == COMPRESSOR.name  # scenes are those of its figures
    takes = scenes.takes(good, profile) if profile.scenes and papers else []
    if takes:
        stages.over("simulate scenes", scenes.ensure_recordings, store, profile, [takes[0].recordings])
        failed += [o for o in stages.over("scenes", scenes.attempt, store, takes) if o.reason]
    trials = robustness.trials(good, profile) if harder else []
    if trials:
        failed += [o for o in stages.over("robustness", robustness.attempt, store, profile, trials) if o.reason]
    with stages.timed("latency"):  # serial, after everything else: timings are never taken beside other work
        first = cells.of_first_seed(good, profile)
        timings, untimed = latency.measure(store, profile.latency.updates, first, stages.progress)
    return run_files.Ran(
        profile=profile,
        command="",
        todo=todo,
        learners=learners,
        runs=runs,
        good=good,
        failed=sorted(failed + untimed, key=lambda o: (o.cell.estimator, o.cell.seed)),
        tables=tables,
        takes=takes,
        trials=trials,
        timings=timings,
        walls=stages.walls,
        unchanged=set(),
    )


def _before(out: Path, profile: Profile, data_key: str, some: bool, resume: bool) -> Earlier:
    """What earlier runs left in ``out``, as far as this one adds to it.

    Raises:
        BadInput: only some estimators are to run, and cannot be compared with those that are there.
    """
    if not some and not resume:
        return Earlier()
    try:
        before = read_earlier(out)
    except BadInput:
        if some:
            raise
        return Earlier()
    differs = what_differs(before, profile, data_key)
    if differs and some:
        raise BadInput(
            f"the comparison in {out} is of other recordings or another profile ({differs}); give this run a folder "
            f"of its own, for example --out {out.with_name(f'{out.name}_more')}"
        )
    return Earlier() if differs else before


def _forget(store: Store, profile: Profile, todo: list[Cell] | None) -> None:
    """Remove what those cells left, or everything."""
    if todo is None:
        store.clear()
        return
    left = [(kind, key) for c in todo for kind, key in (("data", c.data), ("fit", c.fit), ("estimate", c.estimates))]
    left += [(scenes.KIND, t.key) for t in scenes.takes(todo, profile)]
    left += [(robustness.KIND, t.key) for t in robustness.trials(todo, profile)]
    for kind, key in left:
        store.forget(kind, key)


def plan(profile: Profile, only: tuple[str, ...], ablations: bool = False) -> list[Cell]:
    """The cells of a run, longest training first.

    Raises:
        BadInput: an unknown estimator, a setting that an estimator does not have, or two of one name.
    """
    kinds = {_absolute(spec): find(spec) for spec in only or discover()}
    names = [kind.name for kind in kinds.values()]
    for kind in kinds.values():
        if names.count(kind.name) > 1:
            raise BadInput(f"two of the estimators are named {kind.name!r}; rename one of them")
    check_settings(kinds.values(), profile)
    if ablations:
        whole = {spec if spec == k.name else join_spec(split_spec(spec)[0], k.__name__): k for spec, k in kinds.items()}
        parts = [f"{spec}{ABLATION}{part}" for spec, k in whole.items() for part in k.ablations]
        kinds |= {spec: find(spec) for spec in parts}
    planned = [cells.make_cell(spec, seed, profile) for spec in kinds for seed in profile.seeds]
    work = {c.estimator: {**kinds[c.spec].settings, **dict(c.settings)}.get("iterations", 0) for c in planned}
    place = ordered(work)
    return sorted(planned, key=lambda c: (-work[c.estimator], place.index(c.estimator), c.seed))


def _absolute(spec: str) -> str:
    """A file's path that still holds in a worker process."""
    file, name = split_spec(spec)
    return join_spec(Path(file).resolve(), name) if file else spec


def _once(todo: list[Cell], key: Key) -> list[Cell]:
    """The first cell of each key."""
    return list({key(c): c for c in todo[::-1]}.values())[::-1]


def _failures(outcomes: list[Outcome], todo: list[Cell], key: Key) -> list[Outcome]:
    """Outcomes that failed, for every cell that shares what failed."""
    lost = {key(o.cell): o for o in outcomes if o.reason}
    return [replace(lost[key(c)], cell=c) for c in todo if key(c) in lost]


def _without(todo: list[Cell], failed: list[Outcome]) -> list[Cell]:
    lost = {o.cell for o in failed}
    return [c for c in todo if c not in lost]


def _score(store: Store, cell: Cell) -> pd.DataFrame:
    table = score(cells.load_estimates(store, cell), cells.load_split(store, cell).test)
    return table.assign(estimator=cell.estimator, seed=cell.seed)


def _true_start(store: Store, cell: Cell) -> pd.DataFrame:
    """The row that cannot be had, at the ticks of a cell's estimates; all seeds would have the same."""
    time_s = cells.load_estimates(store, cell).time_s
    table = true_start_held(cells.load_split(store, cell).test, time_s)
    return table.assign(estimator=TRUE_START, seed=cell.seed)


def who(todo: list[Cell]) -> str:
    """Names of the estimators that cells are of; of ablations their number beside whole methods, else their names."""
    names = {c.estimator for c in todo}
    parts = {name for name in names if is_ablation(name)}
    several = f", and {len(parts)} ablation{'' if len(parts) == 1 else 's'}" if parts < names and parts else ""
    return names_of(map(label, ordered(names - parts or parts))) + several


def _say_plan(console: Console, profile: Profile, todo: list[Cell], store: Store, out: Path, before: Earlier) -> None:
    """What is about to happen, for whoever just pressed Enter."""
    data = profile.data
    done = sum(store.has("estimate", c.estimates) for c in todo)
    others = before.others({c.estimator for c in todo})
    beside = ordered(name for name in others if not is_ablation(name))
    console.print(
        f"profile {profile.name}: {who(todo)}"
        f"\nseeds {', '.join(map(str, profile.seeds))}\n"
        f"trained on {data.n_train} simulated recordings of {data.minutes:g} min, tuned on {data.n_validation}, "
        f"calibrated on {data.n_calibration}, "
        f"tested on {data.n_test + data.n_single} others\n{foretold(todo, profile, store, out)}\n"
        f"results in {out}"
        + (f"; {done} of {len(todo)} cells are there from an earlier run" if done else "")
        + (f"; beside {names_of(map(label, beside))}, whose rows stay" if beside else ""),
        highlight=False,
        markup=False,
        soft_wrap=True,
    )
