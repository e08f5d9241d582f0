"""A proposal as files: the inputs as CSV, and all of it as JSON for programs."""

from __future__ import annotations

from pathlib import Path
from textwrap import fill
from typing import Any

import pandas as pd

from twinbench.common.documents import made_from, read_file, to_json
from twinbench.common.page import Drawing, write_figures
from twinbench.common.store import write_text
from twinbench.data.recording import TIME
from twinbench.mismatch.design import says
from twinbench.mismatch.design.choice import Proposal
from twinbench.mismatch.design.figure import experiment
from twinbench.mismatch.design.request import Designed, DesignRequest
from twinbench.mismatch.model import made_of
from twinbench.mismatch.seed import ENGINE_SEED

CAPTION = "The proposed inputs, and what each rival foretells of the output that tells most."
OUTLOOKS = SETTLES, HELPS, NOTHING, CALM = "settles", "helps", "settles nothing", "nothing contested"
"""All that ``verdict`` may say."""
DESIGN_VERSION = 1
"""Of the form of ``design.json``. It rises when a field goes, or changes its type or what it means."""


def document_of(d: Designed, asked: DesignRequest) -> dict[str, Any]:
    """``design.json``."""
    p, simulator = d.proposal, d.hand.rivals[0].problem.machine.simulator
    e = p.expected
    return {
        "schema_version": DESIGN_VERSION,
        "verdict": _outlook(p),
        "says": says.headline(d),
        "points": list(says.points(d)),
        "rivals": [
            {"name": name, "probability": probability, "group": int(group)}
            for name, probability, group in zip(d.hand.names, d.hand.probabilities, p.groups, strict=True)
            if name
        ],
        "beside": list(d.beside),
        "experiment": {
            "kind": p.trial.candidate.kind,
            "says": p.trial.candidate.says,
            "inputs": [v.name for v in simulator.inputs],
            "duration_s": len(p.trial.candidate.time_s) * d.limits.sampling_s,
            "sampling_s": d.limits.sampling_s,
            "enough_s": p.enough_s,
            "times": p.times,
        },
        "expected": None
        if e is None
        else {
            "nats": e.nats,
            "worst_nats": e.worst,
            "right_name": e.right,
            "wrong_name": e.wrong,
            "right_name_repeated": p.repeated,
        },
        "parameters": [] if e else [{"name": n, "sd_left": v} for n, v in says.left_over(d)],
        "again": [
            {
                "says": old.says,
                "right_name": old.expected.right,
                "worst_nats": old.expected.worst,
                "sensors": [{"state": a.state, "noise_sd": a.sd, "right_name": a.expected.right} for a in old.added],
            }
            for old in d.old
        ],
        "candidates": {"made": len(p.worth), "left_out": p.left_out, "nats": sorted(p.worth, reverse=True)},
        "provenance": _provenance(asked),
    }


def _outlook(p: Proposal) -> str:
    if p.expected is None:
        return CALM
    if p.times:
        return SETTLES
    return NOTHING if p.scattered else HELPS


def _provenance(asked: DesignRequest) -> dict[str, Any]:
    settings = {
        "simulator": asked.spec,
        "rivals": list(asked.rivals),
        "inputs": str(asked.limits),
        "verdict": str(asked.verdict or ""),
        "catalogue": asked.catalogue,
        "seed": ENGINE_SEED,
    }
    files = [f for spec in made_of(asked.spec) for f in read_file("simulator", spec)]
    files += [*read_file("limits", asked.limits), *read_file("catalogue", asked.catalogue)]
    files += read_file("verdict", asked.verdict) if asked.verdict else []
    return made_from(settings, files)


def write_design(d: Designed, document: dict[str, Any], out: Path) -> None:
    """Write ``inputs.csv``, ``design.json`` and ``figures/`` into a folder.

    Raises:
        CannotWrite: the folder cannot be written to.
    """
    candidate, simulator = d.proposal.trial.candidate, d.hand.rivals[0].problem.machine.simulator
    table = pd.DataFrame({TIME: candidate.time_s})
    for k, v in enumerate(simulator.inputs):
        table[v.name] = candidate.u[:, k]
    write_text(out / "inputs.csv", table.to_csv(index=False, float_format="%.8g"))
    write_text(out / "design.json", to_json(document) + "\n")
    drawing = Drawing("experiment", CAPTION, experiment(d), "")
    write_figures(out / "figures", [drawing])


def to_text(d: Designed, width: int = 80) -> str:
    """The proposal for a terminal: the sentence, then its points."""
    points = [fill(p, width, initial_indent="- ", subsequent_indent="  ") for p in says.points(d)]
    return "\n".join([fill(says.headline(d), width), "", *points, ""])
