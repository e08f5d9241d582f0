"""Checkpoints: what was saved by another estimator or another version is refused, with what differs."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pytest

from twinbench.methods.estimator import Estimator, State, ablated, gaussian_state, no_info


class Still(Estimator):
    """Knows nothing."""

    name = "still"
    settings: ClassVar[dict[str, float]] = {"scale": 1.0, "tempo": 2.0}
    online = frozenset({"tempo"})
    ablations: ClassVar[dict[str, dict[str, float]]] = {"slow": {"tempo": 0.1}}

    def fit(self, train, validation, seed):
        self.arrays = {"mean": np.zeros(10)}

    def init(self, batch) -> State:
        return gaussian_state(np.zeros((batch, 10)), np.eye(10))

    def step(self, state, sample):
        return state, no_info(len(state.mean))


@pytest.fixture
def saved(tmp_path):
    estimator = Still(scale=3.0)
    estimator.fit(None, None, 0)
    estimator.save(tmp_path / "part.npz")
    return tmp_path / "part.npz"


def test_a_checkpoint_comes_back_and_what_works_online_may_differ(saved):
    assert Still.load(saved).config == {"scale": 3.0, "tempo": 2.0}
    assert Still.load(saved, tempo=5.0).config["tempo"] == 5.0
    assert ablated(Still, "slow").load(saved, tempo=0.1).config == {"scale": 3.0, "tempo": 0.1}


def test_another_estimators_checkpoint_is_refused(saved):
    other = type("Other", (Still,), {"name": "other"})
    with pytest.raises(ValueError, match="holds the estimator 'still', not 'other'"):
        other.load(saved)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"scale": 1.0}, "it has the setting 'tempo'"),
        ({**Still.settings, "new": 1.0}, "it lacks the setting 'new'"),
    ],
)
def test_another_versions_checkpoint_is_refused_with_the_setting_that_differs(saved, settings, says):
    version = type("Still", (Still,), {"settings": settings})
    with pytest.raises(ValueError, match=says):
        version.load(saved)
