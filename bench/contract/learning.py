"""Promises about settings, fit and storage."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from twinbench.bench.contract.outcome import Broken, NotOffered, need
from twinbench.bench.contract.promise import promise
from twinbench.bench.contract.subject import SHORT_RUN, SUBJECT_SEED, Subject, record, same
from twinbench.bench.evaluate import run
from twinbench.bench.profile import Evaluation
from twinbench.bench.registry import wrong_name
from twinbench.data.benchmark import fingerprint


@promise("it declares itself consistently")
def _declares(s: Subject) -> str:
    kind, known = s.kind, set(s.kind.settings)
    need(not wrong_name(kind.name), wrong_name(kind.name))
    stray = {*kind.contract_settings, *kind.search_space, *(k for a in kind.ablations.values() for k in a)} - known
    need(not stray, f"not among its settings: {', '.join(sorted(stray))}")
    for key, space in kind.search_space.items():
        default = kind.settings[key]
        searched = default in space if isinstance(space, list) else min(space) <= default <= max(space)
        need(searched, f"the default of {key}, {default}, is not searched")
    need(json.loads(json.dumps(dict(kind.settings))) == dict(kind.settings), "settings do not survive JSON")
    need(len(kind.implementations) == 1 or "implementation" in known, "implementations without the setting for them")
    return f"{len(known)} settings, {len(kind.search_space)} searched, {len(kind.ablations)} ablations"


@promise("an unknown setting is refused")
def _unknown_setting(s: Subject) -> str:
    try:
        s.kind(s.machine, no_such_setting=1)
    except ValueError as error:
        need("no_such_setting" in str(error), f"the message does not name the setting: {error}")
        return str(error).splitlines()[0]
    raise Broken("no_such_setting=1 was taken without a ValueError")


@promise("the same seed learns the same")
def _same_seed(s: Subject) -> str:
    first, second = s.fitted.arrays, s.again.estimator.arrays
    need(first.keys() == second.keys(), "two fits learnt arrays of different names")
    for name, array in first.items():
        need(same(array, second[name]), f"two fits with seed {SUBJECT_SEED} differ in {name}")
    return f"{len(first)} arrays equal bit for bit"


@promise("where nothing is drawn, another seed learns the same")
def _draws(s: Subject) -> str:
    if s.kind.draws:
        raise NotOffered("its training may draw at random")
    other = s.fit_with(SUBJECT_SEED + 1)
    for name, array in s.fitted.arrays.items():
        need(same(array, other.arrays[name]), f"with another seed, fit learns another {name}")
    return f"{len(s.fitted.arrays)} arrays equal bit for bit"


@promise("settings that work online are not learnt from")
def _online(s: Subject) -> str:
    kind = s.kind
    if not kind.online:
        raise NotOffered("every setting may matter to its training")
    stray = sorted(kind.online - set(kind.settings))
    need(not stray, f"not among its settings: {', '.join(stray)}")
    others = {name: _other(kind.settings[name]) for name in kind.online}
    estimator = s.fit_with(SUBJECT_SEED, **others)
    for name, array in s.fitted.arrays.items():
        need(same(array, estimator.arrays[name]), f"with other online settings, fit learns another {name}")
    return f"{len(others)} of them, {len(s.fitted.arrays)} arrays equal bit for bit"


def _other(value: Any) -> Any:
    if isinstance(value, bool):
        return not value
    return type(value)(2 * value + 1) if isinstance(value, int) else 1.5 * value + 0.1


@promise("fit leaves the recordings as they were")
def _fit_is_pure(s: Subject) -> str:
    split = s.ground.benchmark
    train, validation = s.again.fingerprints
    need(train == fingerprint(split.train), "fit changed the training sequences")
    need(validation == fingerprint(split.validation), "fit changed the validation sequences")
    return "same fingerprints before and after"


@promise("only fit reads the truth")
def _no_truth(s: Subject) -> str:
    measured = s.recordings["undisturbed"][:, :SHORT_RUN]
    before = record(s.again.estimator, measured)
    for batch in s.again.copies:  # whatever is still tied to the sequences it was fitted to changes with them
        assert batch.truth is not None
        for array in (batch.measured, batch.truth.states, batch.truth.health, batch.truth.outputs, batch.truth.inputs):
            array[:] = 0.0
    s.again.estimator.restore()
    need(same(record(s.again.estimator, measured), before), "its estimates change with the truth it was fitted to")
    try:
        run(s.fitted, s.ground.benchmark.test, Evaluation(), SUBJECT_SEED)
    except ValueError:
        return "refused where it comes along; what fit saw may be wiped afterwards"
    raise Broken("the run did not refuse recordings that carry their truth")


@promise("save and load, without pickle")
def _save_and_load(s: Subject) -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "estimator.npz"
        s.fitted.save(path)
        with np.load(path, allow_pickle=False) as stored:
            size = sum(stored[name].nbytes for name in stored.files)
        loaded = s.kind.load(path, s.machine)
    need(loaded.config == s.fitted.config, "the settings came back changed")
    measured = s.recordings["undisturbed"][:, :SHORT_RUN]
    need(same(record(loaded, measured), record(s.fitted, measured)), "the loaded one estimates differently")
    inputs = s.ground.future(SHORT_RUN, 20)
    forecasts = [e.forecast(s.state_after(e, measured), inputs) for e in (s.fitted, loaded)]
    need(same(*forecasts), "the loaded one forecasts differently")
    return f"{size / 1e3:.0f} kB, {SHORT_RUN} ticks and a forecast equal bit for bit"


@promise("restore can be repeated")
def _restore_twice(s: Subject) -> str:
    estimator = s.kind(s.machine, **s.fitted.config)
    estimator.arrays = {name: array.copy() for name, array in s.fitted.arrays.items()}
    estimator.restore()
    measured = s.recordings["undisturbed"][:, :SHORT_RUN]
    once = record(estimator, measured)
    estimator.restore()
    need(same(record(estimator, measured), once), "it estimates differently after a second restore")
    for name, array in s.fitted.arrays.items():
        need(same(array, estimator.arrays[name]), f"restore changed the learnt array {name}")
    return f"{SHORT_RUN} ticks equal bit for bit"
