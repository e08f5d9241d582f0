"""``twinbench latency``: everything timed in one run on one core, so that every ratio compares like with like."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from rich.console import Console

from twinbench.bench import cells
from twinbench.bench.cells import Cell, Outcome
from twinbench.bench.estimate.apply import Training, trained_cells
from twinbench.bench.latency import memory
from twinbench.bench.latency.compiled_peers import CompiledPeer, ekf, ukf
from twinbench.bench.latency.estimators import recording, runners, samples, save_samples
from twinbench.bench.latency.forms import IN_PLACE, operators, whole_updates
from twinbench.bench.latency.peers import FilterpyEKF, FilterpyUKF, model_of
from twinbench.bench.latency.stages import stages
from twinbench.bench.latency.tables import BACK_TO_BACK, latency_table, memory_table, paced_at
from twinbench.bench.latency.timing import Name, Timed, Watch, back_to_back, one_core, paced, percentiles
from twinbench.bench.report.figures.latency import decomposition, latency_percentiles, window_lengths
from twinbench.bench.report.provenance import FORMATS
from twinbench.bench.report.table_formats import Table
from twinbench.bench.roster import PROPOSED
from twinbench.common.page import Drawing, write_figures
from twinbench.common.progress import Progress
from twinbench.common.store import Store, check_writable, write_atomically, write_csv, write_text
from twinbench.common.threads import pin_torch
from twinbench.common.versions import provenance
from twinbench.machines.coordinates import Array
from twinbench.machines.load import machine_at
from twinbench.machines.machine import Machine
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.frontend import FrontEnd


class Counts(NamedTuple):
    """How often each is timed."""

    updates: int  # back to back
    ticks: int  # at the machine's pace; 0 leaves that out


class _Measured(NamedTuple):
    """What the suite found."""

    table: pd.DataFrame
    parts: dict[str, float]  # of one update, us
    held: pd.DataFrame  # memory
    took: dict[str, dict[Name, Array]]  # by mode, every sample
    about: dict[str, Any]  # the machine meanwhile


def run(
    where: Training, only: list[str], counts: Counts, out: Path, command: str, console: Console
) -> tuple[Table, list[Outcome]]:
    """Time the trained estimators and their peers, and write ``out``.

    Writes ``latency.csv``, ``stages.csv``, ``memory.csv``, tables and figures of them, ``samples.npz`` and
    ``manifest.json``.

    Args:
        where: they were trained.
        only: the estimators; all that are trained if empty.

    Raises:
        BadInput: nothing is trained there, or ``out`` cannot be written to.
    """
    store, todo = trained_cells(where, only)
    check_writable(out)
    measured, failed = _measure(store, todo, counts, console)
    shown = latency_table(measured.table, measured.about)
    _write(out, measured, shown)
    manifest = {
        "command": command,
        **counts._asdict(),
        "machine": todo[0].machine,
        "seed": todo[0].seed,
        "fits": {c.estimator: c.fit for c in todo},
        "measured": measured.about,
        **provenance(),
    }
    write_text(out / "manifest.json", json.dumps(manifest, indent=2) + "\n")
    return shown, failed


def _measure(store: Store, todo: list[Cell], counts: Counts, console: Console) -> tuple[_Measured, list[Outcome]]:
    """All that is timed, on one core, and then the memory; and who failed."""
    pin_torch()
    machine, readings = machine_at(todo[0].machine), recording(store, todo)
    filled = FrontEnd.fit(cells.load_split(store, todo[0]).train).run(readings[None])[0][0]
    proposed = _proposed(store, todo)
    took, parts = {}, {}
    with Progress(console) as progress, one_core() as core:
        watch = Watch()
        ready, failed = runners(store, todo, readings)
        timed = [one for one, _ in ready.values()]
        if proposed is not None:
            timed += [*whole_updates(proposed, readings), *operators(proposed, filled)]
        timed += _peers(machine, filled)
        took[BACK_TO_BACK] = back_to_back(timed, counts.updates, progress)
        if counts.ticks:
            period_s = machine.sample_period_s
            took[paced_at(period_s)] = paced(timed, counts.ticks, period_s, progress)
        if proposed is not None:
            parts = stages(proposed, filled)
        about = {"core": core, "period_s": machine.sample_period_s, **watch.told()}
    table = pd.DataFrame(
        [{**name._asdict(), "mode": mode, **percentiles(us)} for mode, by in took.items() for name, us in by.items()]
    )
    return _Measured(table, parts, _memory(store, todo, ready, proposed, readings), took, about), failed


def _write(out: Path, measured: _Measured, shown: Table) -> None:
    """Tables, samples and figures."""
    write_csv(out / "latency.csv", measured.table)
    write_csv(out / "stages.csv", pd.DataFrame(measured.parts.items(), columns=["stage", "us"]))
    write_csv(out / "memory.csv", measured.held)
    write_atomically(out / "samples.npz", lambda path: save_samples(measured.took, path))
    for name, written in (("latency", shown), ("memory", memory_table(measured.held))):
        write_text(out / f"{name}.md", FORMATS["md"](written))
    write_figures(out / "figures", _drawings(measured))


def _proposed(store: Store, todo: list[Cell]) -> DeepONetKalman | None:
    for cell in todo:
        if cell.estimator == PROPOSED:
            estimator = cells.load_fit(store, cell)
            assert isinstance(estimator, DeepONetKalman)
            return estimator
    return None


def _peers(machine: Machine, filled: Array) -> Iterator[Timed]:
    rows, first, model = list(filled), filled[0], model_of(machine)
    for form, functions in (("NumPy model", model.written), ("numba model", model.numba)):
        yield Timed(Name("filterpy_ekf", form, 1), FilterpyEKF(first, model, functions).update, rows)
        yield Timed(Name("filterpy_ukf", form, 1), FilterpyUKF(first, model, functions).update, rows)
    yield Timed(Name("numba_ekf", "all compiled", 1), CompiledPeer(first, model, ekf).update, rows)
    yield Timed(Name("numba_ukf", "all compiled", 1), CompiledPeer(first, model, ukf).update, rows)


def _memory(
    store: Store, todo: list[Cell], ready: dict[Name, Any], proposed: DeepONetKalman | None, readings: Array
) -> pd.DataFrame:
    """After the timing, in loops and processes of its own."""
    ticks, rows, processes = samples(readings, machine_at(todo[0].machine)), [], []
    specs = {c.estimator: memory.Stored(c.spec, c.machine, store.path("fit", c.fit)) for c in todo}
    for name, (_, stepped) in ready.items():
        rows.append(memory.of_stepped(stepped, name.implementation, ticks))
        processes.append(memory.process_MB(specs[name.estimator], name.implementation))
    if proposed is not None:
        rows.append(memory.in_place(proposed, list(readings)))
        processes.append(memory.process_MB(specs[PROPOSED], IN_PLACE))
    return memory.table(rows, processes)


def _drawings(measured: _Measured) -> Iterator[Drawing]:
    table, parts = measured.table, measured.parts
    hot = table[table["mode"] == BACK_TO_BACK]
    yield Drawing("latency", "", latency_percentiles(hot, measured.about["period_s"]), "")
    if parts:
        yield Drawing("fig7a_stages", "", decomposition(parts), "")
        yield Drawing("fig7b_windows", "", window_lengths(hot[hot["implementation"] == IN_PLACE]), "")
