"""A trained estimator over somebody's recordings: estimates with intervals, a figure, a summary."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bench import cells
from bench.cells import Cell
from bench.evaluate import run as evaluate
from bench.profile import Evaluation, Profile, load_profile
from bench.registry import discover, find
from bench.roster import axis_label, label, ordered
from bench.store import Store, write_atomically, write_text
from data.batch import ESTIMATED, HEALTH
from data.errors import BadInput
from data.recording import Recording, check_overlap, read_recording

SHORTEST_S = 10.0


def trained_cells(store: Store, profile: Profile, names: Sequence[str], results: Path) -> list[Cell]:
    """The first-seed cells of the named estimators, or of all that are trained.

    Raises:
        BadInput: one is not trained in that run.
    """
    found = []
    for name in names or ordered(discover()):
        cell = Cell(name, find(name).name, profile.seeds[0])
        if store.has("fit", cells.fit_key(cell, profile)):
            found.append(cell)
        elif names:
            raise BadInput(
                f"{name} is not trained in {results} with this code and profile {profile.name!r}; "
                f"train it with: twinbench run --profile {profile.name} --only oracle {name} --out {results}"
            )
    if not found:
        raise BadInput(f"nothing is trained in {results}; train with: twinbench run --profile {profile.name}")
    return found


def apply(
    name: str, paths: Sequence[Path], out: Path, profile_name: str, results: Path | None, mapping: Sequence[str]
) -> list[dict[str, Any]]:
    """Write ``<recording>.estimates.csv``, ``.png`` and ``.summary.json`` into ``out`` for each recording.

    Every recording is read and checked before anything is written.

    Returns:
        One summary per recording: where it ended, with 95 % intervals, and in words.
    """
    from bench.threads import pin_torch

    profile = load_profile(profile_name)
    results = results or Path("results") / profile.name
    recordings = [read_recording(path, mapping) for path in paths]
    check_overlap(recordings)
    for recording in recordings:
        length = recording.time_s[-1] - recording.time_s[0]
        if length < SHORTEST_S:
            raise BadInput(f"recording {recording.name} lasts {length:.1f} s; at least {SHORTEST_S:.0f} s are needed")
    store = Store(results / "store")
    cell = trained_cells(store, profile, [name], results)[0]
    pin_torch()
    estimator = cells.load_fit(store, profile, cell)
    summaries = []
    for recording in recordings:
        batch = recording.to_batch()
        every = max(1, batch.measured.shape[1] // 30_000)
        estimates = evaluate(estimator, batch, Evaluation(stride=every, origin_every_s=1e9, leads_s=(1.0,)), cell.seed)
        summary = _summarise(recording, label(cell.estimator), estimates.mean[0], estimates.low[0], estimates.high[0])
        _write(out, recording, estimates.time_s, estimates, batch.measured[0, ::every], summary)
        summaries.append(summary)
    return summaries


def _summarise(
    recording: Recording, who: str, mean: np.ndarray, low: np.ndarray, high: np.ndarray
) -> dict[str, Any]:
    final = {
        q: {"value": float(mean[-1, i]), "low": float(low[-1, i]), "high": float(high[-1, i])}
        for i, q in enumerate(ESTIMATED)
    }
    words = "; ".join(
        f"{axis_label(q).removesuffix(', –')} {final[q]['value']:.4g} ({final[q]['low']:.4g} to {final[q]['high']:.4g})"
        for q in HEALTH
    )
    missing = float(np.isnan(recording.values).mean())
    return {
        "recording": recording.name,
        "estimator": who,
        "seconds": float(recording.time_s[-1] - recording.time_s[0]),
        "missing_share": missing,
        "final": final,
        "says": f"{recording.name}: at the end of {recording.time_s[-1] - recording.time_s[0]:.0f} s, {who} has {words}.",
    }


def _write(
    out: Path, recording: Recording, time_s: np.ndarray, estimates: Any, measured: np.ndarray, summary: dict[str, Any]
) -> None:
    from bench.figures.recording import estimate_figure

    columns = {"time_s": time_s}
    for i, q in enumerate(ESTIMATED):
        columns |= {q: estimates.mean[0, :, i], f"{q}_low": estimates.low[0, :, i], f"{q}_high": estimates.high[0, :, i]}
    table = pd.DataFrame(columns)
    write_atomically(out / f"{recording.name}.estimates.csv", lambda path: table.to_csv(path, index=False))
    write_atomically(
        out / f"{recording.name}.png",
        lambda path: estimate_figure(
            time_s, estimates.mean[0], estimates.low[0], estimates.high[0], measured[: len(time_s)], path
        ),
    )
    write_text(out / f"{recording.name}.summary.json", json.dumps(summary, indent=2) + "\n")
