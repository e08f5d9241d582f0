"""One case: is the verdict a set, and what becomes of it after an experiment that was proposed, drawn, or repeated?"""

from __future__ import annotations

import json
import time
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from twinbench.common.store import key_of, sha256_of, write_text
from twinbench.common.versions import code_version
from twinbench.data.scenario import stream
from twinbench.mismatch import Verdict, diagnose
from twinbench.mismatch.design.candidates import drawn
from twinbench.mismatch.design.choice import Choice
from twinbench.mismatch.design.contested import contested
from twinbench.mismatch.design.within import within
from twinbench.mismatch.naming.decision import RULE
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.generate import Item
from twinbench.proof.concealed.judge import claims
from twinbench.proof.concealed.machines import machine_of
from twinbench.proof.concealed.outcome import outcome
from twinbench.proof.concealed.severity import Take
from twinbench.proof.designs.concealed import Concealed, concealed
from twinbench.proof.designs.ideal import seen, sure
from twinbench.proof.kept import kept
from twinbench.proof.twins import ROOT

ARMS = ("proposed", "random", "repeated")
"""The proposed experiment, one of the feasible ones by chance, and the inputs of the recordings at hand once more."""
IN_TURN = 3
"""Proposed experiments one after the other, as long as the verdict is a set."""
RIGHT, ALIKE = ("name", "class"), "alike"
"""Outcomes in which one name stands alone, and one in which several do that nobody can tell apart."""
SET = "set"
FAILS = FloatingPointError, ValueError
"""What is raised where a machine or its twin diverges in an experiment; ``BadInput`` and NumPy's ``LinAlgError`` are
among them. Such an experiment gives no name."""
_CODE = ("twinbench.proof.designs.trial", "twinbench.mismatch")


def tried(item: Item, seed: int, out: Path) -> None:
    """Try a case, unless an earlier run did with the same code."""
    path = out / "cases" / f"{item.case}.json"
    code = [*(code_version(m) for m in _CODE), *map(sha256_of, _files(item, seed))]
    key = key_of(item=list(item.__dict__.values()), seed=seed, code=code)
    if kept(path, key) is None:
        began = time.process_time()
        try:
            result = _tried(item, seed)
        except FAILS as error:
            result = {"status": "failed", "says": repr(error)}
        seconds = round(time.process_time() - began, 1)
        write_text(path, json.dumps({"key": key, "seconds": seconds, **result}, indent=1))


def _files(item: Item, seed: int) -> list[Path]:
    """What a case depends on beside modules: the learnt rule, and the twin's file if it has one."""
    file = machine_of(item.machine, seed).simulator.partition(":")[0]
    return [RULE, ROOT / file] if file.endswith(".py") else [RULE]


def judged(truth: Mapping[str, Any], verdict: Verdict) -> str:
    """What a verdict comes to: a word of ``outcome``, or ``ALIKE``."""
    found = claims(verdict.to_dict())
    word = outcome(truth, [c.names for c in found], [c.ports for c in found])
    return ALIKE if word in RIGHT and any(len(c.names) > 1 for c in found) else word


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
    found = _proposed(c, first)
    experiments = {"random": _by_chance(c, found), "repeated": c.narrow[0].u[: len(c.limits.time_s)]}
    takes = {arm: c.later(f"{arm}_1", u, c.narrow) for arm, u in experiments.items()}
    after, rounds = [SET], 0
    if found is not None and found.expected is not None:
        about["says"] = found.trial.candidate.says
        promised = found.expected
        about["promised"] = {"right": promised.right, "nats": promised.worst, "settles": not found.scattered}
        takes["proposed"] = c.later("proposed_1", found.trial.candidate.u, c.narrow)
        after, rounds = _in_turn(c, told, found)
    return {
        "status": SET,
        **about,
        "proposed": after[0],
        **{arm: _after(c, told, [takes[arm]])[0] for arm in ARMS[1:]},
        "in_turn": after,
        "experiments": rounds,
        "ideal": _ideal(c, wider.same, takes),
    }


def _proposed(c: Concealed, verdict: Verdict) -> Choice | None:
    """The experiment to make next; None where there is none, or it cannot be worked out."""
    try:
        return within(verdict.diagnosis.answer, verdict.diagnosis.claims, c.limits)
    except FAILS:
        return None


def _ideal(c: Concealed, same: Collection[str], takes: Mapping[str, Take]) -> dict[str, float]:
    """With which probability the ideal observer is sure of the right class, at hand and after each experiment.

    Where none was proposed it is as at hand.
    """
    several: dict[str, Sequence[Take]] = dict.fromkeys(("at_hand", *ARMS), c.narrow)
    several |= {arm: _with(c, take) for arm, take in takes.items()}
    return {arm: _sure(c, some, same) for arm, some in several.items()}


def _sure(c: Concealed, takes: Sequence[Take], same: Collection[str]) -> float:
    try:
        return sure(c.truth, takes, same)
    except FAILS:
        return 0.0


def _with(c: Concealed, take: Take) -> list[Take]:
    """The recordings at hand and one more to learn from."""
    return [*c.narrow[:-1], take, c.narrow[-1]]


def _in_turn(c: Concealed, told: Mapping[str, Any], first: Choice) -> tuple[list[str], int]:
    """Outcomes after one proposed experiment, two, ...; and after how many it was the right name, 0 if never."""
    takes, choice, outcomes = list[Take](), first, list[str]()
    for k in range(1, IN_TURN + 1):
        takes.append(c.later(f"proposed_{k}", choice.trial.candidate.u, [*c.narrow, *takes]))
        word, verdict = _after(c, told, takes)
        outcomes.append(word)
        if word in RIGHT:
            return outcomes, k
        if word != SET or verdict is None:
            break
        again = _proposed(c, verdict)
        if again is None:
            break
        choice = again
    return outcomes, 0


def _after(c: Concealed, told: Mapping[str, Any], takes: Sequence[Take]) -> tuple[str, Verdict | None]:
    """What the verdict after further experiments comes to."""
    try:
        verdict = diagnose(c.twin, [*c.at_hand[:-1], *map(c.recorded, takes)], hold_out=c.at_hand[-1:])
    except FAILS:
        return "failed", None
    return judged(told, verdict), verdict


def _by_chance(c: Concealed, found: Choice | None) -> Array:
    """Inputs (N, nu) of an experiment that nobody chose, in their units: one of those that were proposed from."""
    candidates = found.made if found is not None else drawn(c.twin, c.limits)
    return candidates[int(stream(c.seed, "by chance", c.case).integers(len(candidates)))].u
