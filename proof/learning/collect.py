"""Development cases: drawn, weighed by the engine, and every finding written down with whether it is right."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from twinbench.common.store import key_of, write_text
from twinbench.common.versions import code_version
from twinbench.data.scenario import stream
from twinbench.mismatch.asked import Asked
from twinbench.mismatch.model import whole_catalogue
from twinbench.mismatch.naming.answer import Answer, Found
from twinbench.mismatch.naming.decision import CREDIBLE
from twinbench.mismatch.naming.weighed import weighed
from twinbench.mismatch.recordings import read_recordings
from twinbench.mismatch.stage_prove import tested
from twinbench.proof.concealed.generate import Case, Item, draw, write
from twinbench.proof.concealed.outcome import UNKNOWN
from twinbench.proof.twins import left, simulator_of

ROUGH_PCT = (2.0, 10.0)
"""Range of the ripple of a rough simulator, even in its logarithm: what real rigs' simulators leave."""


def roughened(items: Sequence[Item], seed: int) -> list[Item]:
    """The same cases with simulators as rough as those of real rigs."""
    low, high = np.log(ROUGH_PCT)
    ripples = np.exp(stream(seed, "rough").uniform(low, high, len(items))).round(2)
    return [replace(item, background_pct=float(pct)) for item, pct in zip(items, ripples, strict=True)]


def collected(item: Item, seed: int, out: Path) -> dict[str, Any]:
    """One case's row, from disk if the engine and the generator are as they were."""
    path = out / f"{seed}-{item.case}.json"
    key = key_of(item=list(item.__dict__.values()), seed=seed, code=[code_version(p) for p in _CODE])
    try:
        known = json.loads(path.read_text())
        if known["key"] == key:
            return dict(known)
    except (OSError, ValueError, KeyError):
        pass
    row = {"key": key, **_row(item, seed)}
    write_text(path, json.dumps(row))
    return row


_CODE = ("twinbench.mismatch.stage_prove", "twinbench.mismatch.naming.weighed", "twinbench.proof.concealed.generate")


def _row(item: Item, seed: int) -> dict[str, Any]:
    try:
        case = draw(item, seed)
    except FloatingPointError as error:
        return {"case": item.case, "seed": seed, "failed": f"draw: {error}"}
    began = time.process_time()
    try:
        answer = _answer(case)
    except Exception as error:  # a row says that the engine failed, and why
        return {"case": item.case, "seed": seed, "cell": item.cell, "machine": item.machine, "failed": repr(error)}
    truth = case.truth
    return {
        "case": item.case,
        "seed": seed,
        "cell": item.cell,
        "machine": item.machine,
        "kind": truth["kind"],
        "effects": [{"name": e["name"], "class": e["class"], "ports": e["ports"]} for e in truth["effects"]],
        "severity": truth["severity"],
        "background_pct": truth["background_pct"],
        "detectable": truth["detectable"],
        "D0_sq": truth["D0_sq"],
        "Dk_sq": truth["Dk_sq"],
        "onset_s": truth["onset_s"],
        "since_s": answer.chosen.since_s,
        "findings": [_finding(f, case, answer) for f in answer.found],
        "left": [(str(u.port), u.log, u.size_pct) for u in answer.left[:3]],
        "gain": answer.chosen.log - answer.naming.null.log,
        "far": answer.naming.far,
        "seconds": time.process_time() - began,
    }


def _answer(case: Case) -> Answer:
    public = case.public
    simulator = simulator_of(public["simulator"], public.get("network", {}))
    simulator = replace(simulator.with_values(**public["values"]), calibrate=tuple(public["calibrate"]), drifts=())
    with tempfile.TemporaryDirectory(prefix="case-") as given:
        write(case, Path(given))
        names = [*public["train"], *public["held_out"]]
        recordings = read_recordings([Path(given) / f"{name}.csv" for name in names], simulator)
    n = len(public["train"])
    period_s = float(recordings[0].time_s[1] - recordings[0].time_s[0])
    catalogue = left(whole_catalogue(simulator, (), period_s), public["without"])
    found = weighed(Asked(simulator, recordings[:n], recordings[n:], catalogue))
    return tested(found.answer, found.fit, found.seen.floor).answer


def _finding(found: Found, case: Case, answer: Answer) -> dict[str, Any]:
    truth = case.truth
    known = truth["effects"] if truth["cell"] not in UNKNOWN else []
    right = {n for e in known for n in e["class"]}
    sizes = {name: value for e in known if e["name"] == found.name for name, value in e["sizes"].items()}
    chosen, i, names = answer.chosen, found.place, found.credible(CREDIBLE)
    first = chosen.problem.machine.candidates[found.effect.variant.candidate].mechanism.parameters[0].name
    true, absent = sizes.get(first, (None, None))
    return {
        "name": found.name,
        "right": found.name in right,
        "exactly": found.name in {e["name"] for e in known},
        "weights": dict(list(found.weights.items())[:8]),
        "alike": sorted(found.alike),
        "set": list(names),
        "marginals": [found.marginal(found.alike), found.marginal(names)],
        "holds": [bool(right & set(found.credible(p))) for p in (0.8, 0.95)],
        "evidence": dict(found.evidence),
        "size": [float(chosen.sizes[i]), float(chosen.sds[i]), None if true is None else true - absent],
    }
