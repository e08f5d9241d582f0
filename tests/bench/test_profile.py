"""Profiles: the two that ship, and a clear line for everything that may be wrong with one's own."""

from __future__ import annotations

from pathlib import Path

import pytest

from twinbench.bench.profile import load_profile
from twinbench.bench.statistics.scores import LEADS_S
from twinbench.common.errors import BadInput
from twinbench.data.benchmark import DesignConfig


def test_the_papers_profile_holds_the_papers_data_and_three_seeds() -> None:
    profile = load_profile("paper")
    assert profile.seeds == (0, 1, 2)
    assert profile.data == DesignConfig(
        n_train=26, n_validation=20, n_calibration=40, n_test=60, n_single=10, minutes=30.0, warmup_minutes=5.0
    )


@pytest.mark.parametrize("name", ["quick", "paper"])
def test_the_profiles_that_ship_forecast_what_is_scored(name: str) -> None:
    profile = load_profile(name)
    assert profile.name == name
    assert set(map(float, LEADS_S)) <= set(profile.evaluation.leads_s)


def test_a_file_overrides_what_it_names_and_whole_numbers_become_floats(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("seeds = [3, 4]\n[data]\nminutes = 8\n[settings.gru_kf]\niterations = 5\n")
    profile = load_profile(str(path))
    assert (profile.name, profile.seeds, profile.data.n_train) == ("mine", (3, 4), 26)
    assert isinstance(profile.data.minutes, float)
    assert profile.settings == {"gru_kf": {"iterations": 5}}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("sedes = [0]", "unknown key 'sedes'"),
        ("[data]\nn_trian = 2", r"unknown key 'data.n_trian'; \[data\] may hold seed, n_train"),
        ("seeds = 1", "seeds is 1, must be a list, each a whole number, at least one"),
        ("seeds = []", "seeds is .*, must be a list, each a whole number"),
        ("seeds = [0, 0.5]", "seeds is 0.5, must be a whole number"),
        ("seeds = [true]", "seeds is True, must be a whole number"),
        ("seeds = [-1]", "seeds is -1, must lie in"),
        ("seeds = [1, 1]", "must not name the same one twice"),
        ("name = 3", "name is 3, must be text"),
        ('name = "../up"', "must be a word"),
        ("data = 3", r"data must be a table, \[data\]"),
        ("[data]\nn_test = 0", r"n_test is 0, must lie in \[1, 1000\]"),
        ("[data]\nminutes = nan", "minutes is nan, must lie in"),
        ('[data]\nminutes = "long"', "data.minutes is 'long', must be a number"),
        ("[data]\nminutes = 4\nwarmup_minutes = 4", "warmup_minutes is 4.0, must be shorter"),
        ("[corruption]\ndropout = 1.5", r"dropout is 1.5, must lie in \[0, 0.99\]"),
        ("[evaluation]\nstride = 0", r"evaluation.stride is 0, must lie in \[1, 200\]"),
        ("[evaluation]\nleads_s = [0.0]", "evaluation.leads_s is 0.0, must lie in"),
        ("[evaluation]\nleads_s = [nan]", "evaluation.leads_s is nan, must lie in"),
        ("[latency]\nupdates = -1", r"latency.updates is -1, must lie in \[0, 10,000,000\]"),
        ("settings = 3", "settings must be tables"),
        ("[settings]\ngru_kf = 3", r"settings must be tables, one for each estimator: \[settings.gru_kf\]"),
        ("seeds = [", "not TOML"),
    ],
)
def test_a_bad_value_is_one_line_with_file_and_key(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(BadInput, match=says) as caught:
        load_profile(str(path))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_binary_is_not_toml(tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInput, match="not TOML"):
        load_profile(str(path))


@pytest.mark.parametrize("name", ["nosuch", "nosuch.toml"])
def test_a_missing_profile_says_which_there_are(name: str) -> None:
    with pytest.raises(BadInput, match=f"no profile '{name}'; choose one of .*paper, quick"):
        load_profile(name)
