"""One case: is the verdict a set, and what becomes of it after an experiment that was proposed, drawn, or repeated?"""

from __future__ import annotations

import json
import time
from collections.abc import Collection, Mapping, Sequence
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
from twinbench.proof.concealed.severity import Take
from twinbench.proof.designs.concealed import Concealed, concealed
from twinbench.proof.designs.ideal import seen, sure
from twinbench.proof.kept import kept

ARMS = ("proposed", "random", "repeated")
"""The proposed experiment, one of the feasible ones by chance, and the inputs of the recordings at hand once more."""
IN_TURN = 3
"""Proposed experiments one after the other, as long as the verdict is a set."""
RIGHT = ("name", "class")
SET = "set"
_CODE = ("twinbench.proof.designs.trial", "twinbench.mismatch")


def tried(item: Item, seed: int, out: Path) -> None:
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


def judged(truth: Mapping[str, Any], verdict: Verdict) -> str:
    """What a verdict comes to, in a word of ``outcome``."""
    found = claims(verdict.to_dict())
    return outcome(truth, [c.names for c in found], [c.ports for c in found])


def _tried(item: Item, seed: int) -> dict[str, Any]:
    c = concealed(item, seed)
    shape = {"reach": c.reach, "length_share": c.length_share}
    about: dict[str, Any] = {"background_pct": c.truth.background_pct, **shape}
    first = diagnose(c.twin, c.at_hand[:-1], hold_out=c.at_hand[-1:])
    if contested(first.diagnosis.claims) is None:
        return {"status": "no set", **about}
    # The ideal observer takes long, and most verdicts are no sets.
    wider = seen(c.truth, _with(c, c.later("ordinary", c.ordinary, c.narrow)), refit=True)
    told = c.truth.told(wider.same)
    before = judged(told, first)
    about |= {"before": before, "names": [list(f.names) for f in first.findings]}
    if before != SET:
        return {"status": "another set", **about}
    if not wider.detectable:
        return {"status": "not separable", **about}
    found = within(first.diagnosis.answer, first.diagnosis.claims, c.limits)
    if found is None:
        return {"status": "no proposal", **about}
    assert found.expected is not None
    experiments = {
        "proposed": found.trial.candidate.u,
        "random": _by_chance(c),
        "repeated": c.narrow[0].u[: len(c.limits.time_s)],
    }
    takes = {arm: c.later(f"{arm}_1", u, c.narrow) for arm, u in experiments.items()}
    after, rounds = _in_turn(c, told, found)
    return {
        "status": SET,
        **about,
        "says": found.trial.candidate.says,
        "promised": {"right": found.expected.right, "nats": found.expected.worst, "settles": not found.scattered},
        "proposed": after[0],
        **{arm: judged(told, _asked_after(c, [c.recorded(takes[arm])])) for arm in ARMS[1:]},
        "in_turn": after,
        "experiments": rounds,
        "ideal": _ideal(c, wider.same, takes),
    }


def _ideal(c: Concealed, same: Collection[str], takes: Mapping[str, Take]) -> dict[str, float]:
    """With which probability the ideal observer is sure of the right class, at hand and after each experiment."""
    return {"at_hand": sure(c.truth, c.narrow, same)} | {
        arm: sure(c.truth, _with(c, take), same) for arm, take in takes.items()
    }


def _with(c: Concealed, take: Take) -> list[Take]:
    """The recordings at hand and one more to learn from."""
    return [*c.narrow[:-1], take, c.narrow[-1]]


def _in_turn(c: Concealed, told: Mapping[str, Any], first: Proposal) -> tuple[list[str], int]:
    """Outcomes after one proposed experiment, two, ...; and after how many it was the right name, 0 if never."""
    made, takes, proposal, outcomes = list[Recording](), list(c.narrow), first, list[str]()
    for k in range(1, IN_TURN + 1):
        takes.append(c.later(f"proposed_{k}", proposal.trial.candidate.u, takes))
        made.append(c.recorded(takes[-1]))
        verdict = _asked_after(c, made)
        outcomes.append(judged(told, verdict))
        if outcomes[-1] in RIGHT:
            return outcomes, k
        d = verdict.diagnosis
        again = within(d.answer, d.claims, c.limits) if outcomes[-1] == SET else None
        if again is None:
            break
        proposal = again
    return outcomes, 0


def _asked_after(c: Concealed, more: Sequence[Recording]) -> Verdict:
    """The verdict after further recordings."""
    return diagnose(c.twin, [*c.at_hand[:-1], *more], hold_out=c.at_hand[-1:])


def _by_chance(c: Concealed) -> Array:
    """Inputs (N, nu) of a feasible experiment that nobody chose, and that the machine stands, in their units."""
    candidates = drawn(c.twin, c.limits)
    for k in stream(c.seed, "by chance", c.case).permutation(len(candidates)):
        try:
            c.recorded(c.later("trial", candidates[k].u, c.narrow))
        except FloatingPointError:
            continue
        return candidates[k].u
    raise FloatingPointError("no experiment within the limits is stood by the machine")
