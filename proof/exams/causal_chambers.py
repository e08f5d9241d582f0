"""Causal Chambers' wind tunnel: from each rung of the authors' ladder of models, what does the next rung add?

The ladder (Gamella, Peters, Bühlmann, Nature Machine Intelligence 2025, appendix on mechanistic models): a fan that is
steady (A1), or has inertia and quadratic drag (A2); a pressure by the fans alone (C1), by an impedance too (C2), and by
one that the hatch changes (C3). Where nobody has the authors' recordings they are simulated by the rung to be found.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from twinbench.common.errors import BadInput
from twinbench.common.store import write_text
from twinbench.data.batch import Array
from twinbench.data.recording import Recording
from twinbench.mismatch import diagnose
from twinbench.mismatch.findings import UNEXPLAINED
from twinbench.mismatch.model import whole_catalogue
from twinbench.physics.integrate import simulate
from twinbench.physics.simulator import Mechanism, Simulator
from twinbench.proof.exams.exam import Advance, Answer, Asked, Exam, Paper
from twinbench.proof.exams.wind_tunnel import (
    BAROMETER_PA,
    DRAG,
    FAN_A1,
    FAN_A2,
    FAN_LINEAR,
    HATCH,
    IMPEDANCE,
    INERTIA_AND_DRAG,
    TACHOMETER_RPM,
    TUNNEL_C1,
    TUNNEL_C2,
    TUNNEL_C3,
)

PERIOD_S, SAMPLES = 0.2, 600
"""Two minutes, at about the rate at which the tunnel reports."""
HELD_S = (3.0, 9.0)
"""How long a load or a hatch position holds."""
EXPERIMENTS = ("learn_1", "learn_2", "hold_out")
EXPERIMENT = "steps.csv"
"""Of the authors' data set wt_test_v1: steps of both loads and of the hatch."""
AMBIENT_PA = 95_000.0
CLOCK = 1_713_000_000.0
"""Unix time at which a simulated recording begins."""


class Rung(NamedTuple):
    """A step of the ladder.

    Attributes:
        lower: the simulator that is asked about.
        upper: what the recordings are simulated by.
        offered: rungs that stand in the catalogue beside ours.
        names: what the next rung adds, as a verdict may call it; empty if no effect of the catalogue is that.
        adds: the same in words.
    """

    lower: Simulator
    upper: Simulator
    offered: tuple[Mechanism, ...]
    names: tuple[str, ...]
    adds: str


BOTH = "inertia and quadratic drag"
RUNGS = {
    "steady fan": Rung(FAN_A1, FAN_A2, (INERTIA_AND_DRAG,), (INERTIA_AND_DRAG.name,), BOTH),
    "fan with linear drag": Rung(FAN_LINEAR, FAN_A2, (), (DRAG,), "quadratic drag"),
    "pressure law": Rung(TUNNEL_C1, TUNNEL_C2, (IMPEDANCE, HATCH), (IMPEDANCE.name,), "impedance"),
    "impedance": Rung(TUNNEL_C2, TUNNEL_C3, (HATCH,), (HATCH.name,), "hatch"),
    "steady fan, our catalogue alone": Rung(FAN_A1, FAN_A2, (), (), f"{BOTH}, which the catalogue lacks"),
    "pressure law, our catalogue alone": Rung(TUNNEL_C1, TUNNEL_C2, (), (), "impedance, which the catalogue lacks"),
    "impedance, our catalogue alone": Rung(TUNNEL_C2, TUNNEL_C3, (), (), "hatch, which the catalogue lacks"),
}
"""By the question's name."""


def read_experiment(path: Path, simulator: Simulator) -> Recording:
    """One of the authors' files: columns ``timestamp`` (Unix time, s), loads, hatch, speeds (rpm), pressures (Pa).

    ``rise_Pa`` is the downwind barometer less the ambient one.

    Raises:
        BadInput: no such file, or one without a column that the simulator needs.
    """
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: cannot be read ({error}); docs/exams.md says where such files are") from None
    channels = tuple(v.name for v in (*simulator.inputs, *simulator.outputs))
    sources = {"rise_Pa": ("pressure_downwind", "pressure_ambient")}
    needed = ["timestamp", *(c for name in channels for c in sources.get(name, (name,)))]
    if lacks := [name for name in needed if name not in table]:
        raise BadInput(f"{path}: lacks the column {lacks[0]}; take a file of the wind tunnel")
    if "rise_Pa" in channels:
        table["rise_Pa"] = table["pressure_downwind"] - table["pressure_ambient"]
    time_s = table["timestamp"].to_numpy(dtype=np.float64)
    return Recording(path.stem, time_s - time_s[0], channels, table[list(channels)].to_numpy(dtype=np.float64))


def write_experiment(path: Path, simulator: Simulator, seed: Sequence[int]) -> None:
    """Simulate a recording by a rung of the ladder, with the sheet's noise, and write it as the authors do."""
    rng = np.random.default_rng(seed)
    u = np.column_stack([_steps(rng, *_LEVELS[v.name]) for v in simulator.inputs])
    start = simulator.initial(u[0], np.array([v.nominal for v in simulator.outputs]), simulator.theta())
    read = simulate(simulator, u[None], start, dt_s=PERIOD_S, substeps=20)[1][0]
    table = pd.DataFrame({"timestamp": CLOCK + PERIOD_S * np.arange(SAMPLES)})
    for v, column in zip(simulator.inputs, u.T, strict=True):
        table[v.name] = column
    for v, column in zip(simulator.outputs, read.T, strict=True):
        if v.name == "rise_Pa":
            table["pressure_ambient"] = AMBIENT_PA
            table["pressure_downwind"] = AMBIENT_PA + column + rng.normal(0.0, BAROMETER_PA, SAMPLES)
        else:
            table[v.name] = column + rng.normal(0.0, TACHOMETER_RPM, SAMPLES)
    write_text(path, table.to_csv(index=False))


_LEVELS = {"load_in": (0.2, 1.0), "load_out": (0.2, 1.0), "hatch": (0.0, 45.0)}
"""Lowest and highest level of an input: shares of the full load, degrees."""


def _steps(rng: np.random.Generator, low: float, high: float) -> Array:
    """(N,) levels that hold for a while each."""
    counts = (rng.uniform(*HELD_S, SAMPLES) / PERIOD_S).astype(int)
    return np.asarray(np.repeat(rng.uniform(low, high, SAMPLES), counts)[:SAMPLES])


def answered(question: str, asked: Asked) -> tuple[Answer, dict[str, str]]:
    """The answer to one question, and a row with the verdict's own words."""
    rung = RUNGS[question]
    if asked.data is None:
        with tempfile.TemporaryDirectory(prefix="tunnel-") as folder:
            paths = [Path(folder) / f"{name}.csv" for name in EXPERIMENTS]
            for k, path in enumerate(paths):
                write_experiment(path, rung.upper, (asked.seed, list(RUNGS).index(question), k))
            *learnt, held = (read_experiment(path, rung.lower) for path in paths)
        given, hold_out = learnt, [held]
    else:
        given, hold_out = [read_experiment(asked.data / EXPERIMENT, rung.lower)], []
    catalogue = whole_catalogue(rung.lower, rung.offered, PERIOD_S)
    verdict = diagnose(rung.lower, given, hold_out, catalogue)
    names = [finding.names for finding in verdict.findings if finding.names]
    places = sorted({str(finding.port) for finding in verdict.findings if not finding.names})
    told = "; ".join(" or ".join(one) for one in names) or "no name"
    if places:
        told += f"; something unnamed at {', '.join(places)}"
    note = f"verdict: {verdict.verdict}"
    if rung.names:
        right = bool(names) and all(set(rung.names) & set(one) for one in names)
    else:
        right = not names and verdict.verdict == UNEXPLAINED
        note += "; right is unexplained"
    row = {"question": question, "verdict": verdict.verdict, "names": told, "says": verdict.says}
    return Answer(question, rung.adds, told, right, note), row


def sit(asked: Asked, advance: Advance) -> Paper:
    """Ask at each rung for the next."""
    answers, rows = [], []
    wanted = [name for name in RUNGS if asked.wants(name)]
    for k, question in enumerate(wanted, 1):
        answer, row = answered(question, asked)
        answers.append(answer)
        rows.append(row)
        advance(k / len(wanted))
    return Paper(answers, {"verdicts": pd.DataFrame(rows)})


EXAM = Exam(
    name="causal_chambers",
    says="what the next rung adds to a model of a wind tunnel: inertia and drag, impedance, hatch",
    setter="models of Causal Chambers' wind tunnel (package causalchamber 0.2.8, MIT); recordings CC BY 4.0, not here",
    questions=tuple(RUNGS),
    sit=sit,
)
