"""The whole chain: data → fit → estimate → scores → latency → report. Resumable at any moment."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pandas as pd
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from bench import cells, latency
from bench.cells import Cell, Outcome
from bench.profile import Profile
from bench.registry import discover, find
from bench.roster import ordered
from bench.scores import DEFINITIONS, score
from bench.store import Store, write_atomically, write_text
from bench.versions import provenance
from data.errors import BadInput

Jobs = Callable[[list[Any]], Iterator[Any]]


def run(
    profile: Profile,
    out: Path,
    only: tuple[str, ...] = (),
    resume: bool = True,
    backend: str = "local",
    scheduler: str = "",
    command: str = "",
    console: Console | None = None,
) -> list[Outcome]:
    """Run a profile into ``out``; finished cells of an earlier run are kept unless ``resume`` is False.

    Returns:
        The cells that failed; they are in ``failures.csv`` too, and the others went on.

    Raises:
        BadInput: an unknown estimator or setting, a folder that cannot be written to.
    """
    console = console or Console(stderr=True)
    store = Store(out / "store")
    todo = plan(profile, only)
    names = {c.estimator for c in todo}
    if not resume:
        store.clear()
    write_text(out / ".writable", "")
    (out / ".writable").unlink()
    walls: dict[str, float] = {}

    def timed(stage: str, work: Callable[[], Any]) -> Any:
        start = time.perf_counter()
        result = work()
        walls[stage] = round(time.perf_counter() - start, 2)
        return result

    with _workers(backend, scheduler), _progress(console) as progress:

        def stage(name: str, jobs: list[Any]) -> list[Any]:
            bar = progress.add_task(name, total=len(jobs))
            results = []
            for result in joblib.Parallel(n_jobs=_processes(backend), return_as="generator_unordered")(jobs):
                results.append(result)
                progress.advance(bar)
            return results

        timed("data", lambda: stage("simulate", [joblib.delayed(cells.ensure_data)(store, profile)]))
        fitted = timed("fit", lambda: stage("train", [joblib.delayed(cells.fit)(store, profile, c) for c in todo]))
        ready = [c for c in todo if not any(o.cell == c and o.reason for o in fitted)]
        done = timed(
            "estimate", lambda: stage("estimate", [joblib.delayed(cells.estimate)(store, profile, c) for c in ready])
        )
        failed = sorted((o for o in fitted + done if o.reason), key=lambda o: (o.cell.estimator, o.cell.seed))
        good = [c for c in ready if not any(o.cell == c for o in failed)]
        tables = timed("score", lambda: stage("score", [joblib.delayed(_score)(store, profile, c) for c in good]))
        _write_scores(out, tables, failed, store, profile)
        in_order = sorted(good, key=lambda c: (ordered(names).index(c.estimator), c.seed))
        # Serial, after everything else: timings are never taken beside other work.
        first = [c for c in in_order if c.seed == profile.seeds[0]]
        timed("latency", lambda: latency.measure(store, profile, first, out, progress))

    from bench.report import write_report

    manifest = {
        "command": command,
        "profile": asdict(profile),
        "seeds": list(profile.seeds),
        "estimators": ordered(names),
        "specs": {c.estimator: c.spec for c in todo},
        "data_key": cells.data_key(profile),
        "estimates_keys": [[c.estimator, c.seed, cells.estimates_key(c, profile)] for c in in_order],
        **provenance(),
        "wall_s": walls,
    }
    write_text(out / "manifest.json", json.dumps(manifest, indent=2) + "\n")
    timed("report", lambda: write_report(out))
    manifest["wall_s"] = walls
    write_text(out / "manifest.json", json.dumps(manifest, indent=2) + "\n")
    return failed


def plan(profile: Profile, only: tuple[str, ...]) -> list[Cell]:
    """The cells of a run, longest training first.

    Raises:
        BadInput: an unknown estimator, or a setting that an estimator does not have.
    """
    specs = only or tuple(discover())
    planned = []
    for spec in specs:
        kind = find(spec)
        try:
            kind(**profile.settings.get(kind.name, {}))
        except ValueError as error:
            raise BadInput(f"profile {profile.name!r}, [settings.{kind.name}]: {error}") from error
        planned += [Cell(_absolute(spec), kind.name, seed) for seed in profile.seeds]
    if unknown := sorted(set(profile.settings) - set(discover()) - {c.estimator for c in planned}):
        raise BadInput(f"profile {profile.name!r} has settings for {unknown[0]!r}, which is no estimator; remove them")
    return sorted(planned, key=lambda c: -cells.settings_of(c, profile).get("iterations", 0))


def _absolute(spec: str) -> str:
    """A file's path that still holds in a worker process."""
    file, colon, name = spec.partition(":")
    return f"{Path(file).resolve()}{colon}{name}" if file.endswith(".py") else spec


def _score(store: Store, profile: Profile, cell: Cell) -> pd.DataFrame:
    table = score(cells.load_estimates(store, profile, cell), cells.load_split(store, profile).test)
    return table.assign(estimator=cell.estimator, seed=cell.seed)


def _write_scores(
    out: Path, tables: list[pd.DataFrame], failed: list[Outcome], store: Store, profile: Profile
) -> None:
    """``scores.csv`` in a fixed order, failed cells as NaN, and ``failures.csv`` with their reasons."""
    names = cells.load_split(store, profile).test.names
    for outcome in failed:
        rows = [(s, m, np.nan) for s in names for m in DEFINITIONS]
        frame = pd.DataFrame(rows, columns=["sequence", "metric", "value"])
        tables.append(frame.assign(estimator=outcome.cell.estimator, seed=outcome.cell.seed))
    columns = ["estimator", "seed", "sequence", "metric", "value"]
    scores = pd.concat(tables, ignore_index=True)[columns]
    scores = scores.sort_values(columns[:4], kind="stable")
    write_atomically(out / "scores.csv", lambda path: scores.to_csv(path, index=False))
    failures = pd.DataFrame(
        [(o.cell.estimator, o.cell.seed, o.stage, o.reason) for o in failed],
        columns=["estimator", "seed", "stage", "reason"],
    )
    write_atomically(out / "failures.csv", lambda path: failures.to_csv(path, index=False))


def _processes(backend: str) -> int:
    return -1 if backend == "dask" else min(2, os.cpu_count() or 1)


@contextlib.contextmanager
def _workers(backend: str, scheduler: str) -> Iterator[None]:
    """joblib's own processes, or those of a Dask cluster."""
    if backend == "local":
        with joblib.parallel_config(backend="loky"):
            yield
        return
    if not scheduler:
        raise BadInput("--backend dask needs --scheduler ADDRESS, for example tcp://10.0.0.5:8786")
    try:
        from distributed import Client

        client = Client(scheduler, timeout="10s")
    except ImportError as error:
        raise BadInput("--backend dask needs Dask; install it with: pip install 'twinbench[dask]'") from error
    except (OSError, ValueError) as error:
        raise BadInput(f"no Dask scheduler answers at {scheduler!r}; check the address and that it runs") from error
    with client, joblib.parallel_config(backend="dask"):
        yield


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description:>9}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=console
    )
