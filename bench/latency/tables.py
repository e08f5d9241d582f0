"""The latency suite's tables."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pandas as pd

from twinbench.bench.latency.timing import Name
from twinbench.bench.report.table_formats import Cell, Column, Table, number
from twinbench.bench.roster import label, ordered

BACK_TO_BACK = "back_to_back"
_PACED = re.compile(r"paced_(.*)_hz")
REFERENCE = Name("filterpy_ukf", "NumPy model", 1)
"""What ratios refer to: the median of its own mode."""
TIMES = ("p50_us", "p95_us", "p99_us", "max_us", "jitter_us")


def paced_at(period_s: float) -> str:
    """The mode of updates at a machine's pace: ``paced_20_hz``."""
    return f"paced_{1.0 / period_s:g}_hz"


def _head(mode: str) -> str:
    found = _PACED.fullmatch(mode)
    return f"at {found[1]} Hz" if found else mode.replace("_", " ")


def latency_table(latency: pd.DataFrame, about: dict[str, Any]) -> Table:
    """A row for each form, columns for each mode.

    Args:
        latency: columns of Name, mode and TIMES.
        about: as ``timing.Watch.told`` says it, the core and the sample period, ``period_s``.
    """
    modes = sorted(latency["mode"].unique())  # back to back first
    by = {(*map(row.get, Name._fields), row["mode"]): row for row in latency.to_dict("records")}
    names = list(dict.fromkeys(Name(*row) for row in latency[list(Name._fields)].itertuples(index=False)))
    place = ordered(n.estimator for n in names)
    names.sort(key=lambda n: place.index(n.estimator))
    forms = [(n.estimator, n.implementation) for n in names]
    columns = [Column("update")]
    for mode in modes:
        columns += [Column(time.removesuffix("_us"), f"{_head(mode)}, µs") for time in TIMES]
        columns.append(Column("× UKF", _head(mode)))
    rows = []
    for name in names:
        window = f", window {name.window}" if forms.count((name.estimator, name.implementation)) > 1 else ""
        cells = [Cell(f"{label(name.estimator)}, {name.implementation}{window}")]
        for mode in modes:
            own, reference = by[(*name, mode)], by[(*REFERENCE, mode)]
            cells += [Cell(number(own[time])) for time in TIMES]
            cells.append(Cell(number(own["p50_us"] / reference["p50_us"])))
        rows.append(tuple(cells))
    return Table("latency", "Time of one update of one machine", latency, tuple(columns), tuple(rows), notes(about))


def notes(about: dict[str, Any]) -> tuple[str, ...]:
    """How it was measured, and on how quiet a machine."""
    if "others_cores" not in about:
        quiet = "How busy the machine was beside is not known on this system."
    else:
        verdict = "A LOADED MACHINE: do not trust these times" if about["loaded"] else "a quiet machine"
        quiet = (
            f"Other processes took {about['others_cores']:g} cores on average, other guests of the hardware "
            f"{about['stolen_cores']:g}: {verdict}. Load before {about['load_1min_before']:g}, "
            f"after {about['load_1min_after']:g}."
        )
    pinned = "" if about.get("core") is None else f", pinned to core {about['core']}"
    period_s = about["period_s"]
    pace = f"{1.0 / period_s:g} Hz"
    return (
        f"One process, one thread{pinned}; the budget at {pace} is {1e6 * period_s:,.0f} µs. Back to back: interleaved "
        f"rounds. At {pace}: one update, then sleep until the next tick.",
        "× UKF: median over that of filterpy's UKF with the model in NumPy, in the same mode of the same run. "
        "Jitter: mean change from one update to the next.",
        quiet,
    )


def memory_table(held: pd.DataFrame) -> Table:
    """Weights, buffers and peaks."""
    kB = ("weights_kB", "buffers_kB", "besides_kB")
    columns = (
        Column("twin"),
        *(Column(c.removesuffix("_kB"), "kB") for c in kB),
        Column("process", "MB"),
    )
    rows = tuple(
        (
            Cell(f"{label(row['estimator'])}, {row['implementation']}"),
            *(Cell(number(np.float64(row[c]))) for c in kB),
            Cell(number(row["process_MB"])),
        )
        for row in held.to_dict("records")
    )
    notes = (
        "Buffers: what is carried or written into from update to update. Besides: the most that one update asks for "
        "and gives back, of Python and NumPy; torch's own is not seen. Process: the most that a process of its own "
        "held, interpreter and libraries included.",
    )
    return Table("memory", "Memory of one machine's twin", held, columns, rows, notes)
