"""One case: is the verdict a set, and what becomes of it after an experiment that was proposed, drawn, or repeated?"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from twinbench.common.store import key_of, write_text
from twinbench.common.versions import code_version
from twinbench.data.recording import Recording
from twinbench.data.scenario import stream
from twinbench.mismatch import Verdict, diagnose
from twinbench.mismatch.design.candidates import drawn
from twinbench.mismatch.design.choice import Proposal
from twinbench.mismatch.design.contested import contested
from twinbench.mismatch.design.within import within
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.generate import Item
from twinbench.proof.concealed.judge import claims
from twinbench.proof.concealed.outcome import outcome
from twinbench.proof.designs.concealed import Concealed, concealed, observed_truth

ARMS = ("proposed", "random", "repeated")
"""The proposed experiment, one of the feasible ones by chance, and the inputs of the recordings at hand once more."""
IN_TURN = 3
"""Proposed experiments one after the other, as long as the verdict is a set."""
RIGHT = ("name", "class")
_CODE = ("twinbench.proof.designs.trial", "twinbench.mismatch")


def tried(item: Item, seed: int, out: Path) -> int:
    """Try a case, unless an earlier run did with the same code."""
    path = out / "cases" / f"{item.case}.json"
    key = key_of(item=list(item.__dict__.values()), seed=seed, code=[code_version(m) for m in _CODE])
    if kept(path, key) is None:
        began = time.process_time()
        try:
            result = _tried(item, seed)
        except FloatingPointError as error:
            result = {"status": "diverged", "says": str(error)}
        seconds = round(time.process_time() - began, 1)
        write_text(path, json.dumps({"key": key, "seconds": seconds, **result}, indent=1))
    return 1


def kept(path: Path, key: str = "") -> dict[str, Any] | None:
    """What an earlier run found of a case; None if there is nothing, or by other code."""
    try:
        known = dict(json.loads(path.read_text()))
    except (OSError, ValueError):
        return None
    return known if not key or known.get("key") == key else None


def _tried(item: Item, seed: int) -> dict[str, Any]:
    machine = concealed(item, seed)
    about = {"machine": item.machine, "effect": item.effects[0], "severity": item.severity}
    at_hand = machine.at_hand()
    first = diagnose(machine.twin, at_hand[:-1], hold_out=at_hand[-1:])
    if contested(first.diagnosis.claims) is None:
        return {"status": "no set", **about}
    # The ideal observer takes long, and most verdicts are no sets.
    machine = replace(machine, truth=observed_truth(item, seed))
    before = judged(machine.truth, first)
    about = {"before": before, "names": [list(f.names) for f in first.findings], **about}
    if before != "set":
        return {"status": "another set", **about}
    if not machine.truth["detectable"]:
        return {"status": "not separable", **about}
    found = within(first.diagnosis.answer, first.diagnosis.claims, machine.limits)
    if found is None:
        return {"status": "no proposal", **about}
    arms = {
        "random": _made(machine, at_hand, _by_chance(machine, item)),
        "repeated": _made(machine, at_hand, machine.narrow[0]),
    }
    after, rounds = _in_turn(machine, at_hand, found)
    assert found.expected is not None
    promised = {"right": found.expected.right, "nats": found.expected.worst, "settles": not found.scattered}
    says = found.trial.candidate.says
    return {
        "status": "set", **about, "promised": promised, "says": says, "proposed": after[0], "in_turn": after, **arms,
        "experiments": rounds,
    }  # fmt: skip


def judged(truth: Mapping[str, Any], verdict: Verdict) -> str:
    """What a verdict comes to, in a word of ``outcome``."""
    found = claims(verdict.to_dict())
    return outcome(truth, [c.names for c in found], [c.ports for c in found])


def _in_turn(machine: Concealed, at_hand: Sequence[Recording], first: Proposal) -> tuple[list[str], int]:
    """Outcomes after one proposed experiment, two, ...; and after how many it was the right name, 0 if never."""
    recordings, proposal, outcomes = list(at_hand), first, list[str]()
    for k in range(IN_TURN):
        made = machine.recorded(f"proposed_{k + 1}", machine.later(recordings), proposal.trial.candidate.u)
        recordings = [*recordings[:-1], made, recordings[-1]]
        verdict = diagnose(machine.twin, recordings[:-1], hold_out=recordings[-1:])
        outcomes.append(judged(machine.truth, verdict))
        if outcomes[-1] in RIGHT:
            return outcomes, k + 1
        d = verdict.diagnosis
        again = within(d.answer, d.claims, machine.limits) if outcomes[-1] == "set" else None
        if again is None:
            break
        proposal = again
    return outcomes, 0


def _made(machine: Concealed, at_hand: Sequence[Recording], u: Array) -> str:
    """The outcome after one more recording."""
    more = machine.recorded("further", machine.later(list(at_hand)), u)
    return judged(machine.truth, diagnose(machine.twin, [*at_hand[:-1], more], hold_out=at_hand[-1:]))


def _by_chance(machine: Concealed, item: Item) -> Array:
    """Inputs of a feasible experiment that nobody chose, and that the machine stands."""
    candidates = drawn(machine.twin, machine.limits)
    rng = stream(machine.seed, "by chance", item.case)
    for k in rng.permutation(len(candidates)):
        try:
            machine.recorded("further", 0.0, candidates[k].u)
        except FloatingPointError:
            continue
        return candidates[k].u
    raise FloatingPointError("no experiment within the limits is stood by the machine")
