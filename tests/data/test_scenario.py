"""What the sequences go through, on the design alone: nothing is simulated here."""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.common.errors import BadInput
from twinbench.data.benchmark import PARTS, SINGLE, SINGLE_KINDS, DesignConfig, design
from twinbench.data.fresh import BIAS_STEP_K, HEALTH, HEALTHY, HEAT_TRANSFER_LOSS, MIX, RATE_PER_MIN, draw
from twinbench.data.scenario import latin_hypercube, stream
from twinbench.machines.compressor import COMPRESSOR, N_LIMITS_RPM, P_SUC_LIMITS_BAR

CONFIG = DesignConfig()
DESIGN = design(CONFIG)
ALL = [scenario for part in PARTS for scenario in DESIGN[part]]
WARM_S = 60.0 * CONFIG.warmup_minutes
SINGLES = [s for s in DESIGN["test"] if s.name.startswith(SINGLE)]
each = pytest.mark.parametrize("scenario", ALL, ids=lambda s: s.name)
each_single = pytest.mark.parametrize("scenario", SINGLES, ids=lambda s: s.name)


def test_the_papers_numbers():
    assert [len(DESIGN[part]) for part in PARTS] == [26, 20, 40, 70]
    kept = [len(s.time_s()) - round(WARM_S / 0.05) for s in ALL]
    assert set(kept) == {30_000}
    assert sum(kept) == 4_680_000
    assert all(s.seconds == 1800.0 for s in ALL)


@each
def test_inputs_stay_in_their_limits_and_load_changes(scenario):
    u = scenario.inputs()
    assert u.shape == (36_000, len(COMPRESSOR.inputs))
    p_suc, _, N, valve = u[round(WARM_S / 0.05) :].T
    for values, (low, high) in ((N, N_LIMITS_RPM), (p_suc, P_SUC_LIMITS_BAR), (valve, (0.2, 1.0))):
        assert low <= values.min() < values.max() <= high
        assert np.ptp(values) > 0.1 * (high - low)


@each_single
def test_each_degradation_has_a_before_a_transition_and_an_after(scenario):
    assert np.array_equal(scenario.start, HEALTHY)
    (changed,) = {c.parameter for c in scenario.changes}
    assert changed == scenario.kind
    t, health = scenario.time_s(), scenario.health()
    assert np.allclose(health[0], scenario.start)
    for i, name in enumerate(HEALTH):
        moves = t[1:][np.diff(health[:, i]) != 0.0]
        if name != changed:
            assert len(moves) == 0
            continue
        assert moves[0] - WARM_S >= 59.0
        assert scenario.seconds - moves[-1] >= 119.0


@each_single
def test_degradations_are_as_fast_and_as_large_as_the_paper_says(scenario):
    health = scenario.health()
    for change in scenario.changes:
        path = health[:, HEALTH.index(change.parameter)]
        total = abs(path[-1] - path[0])
        if change.parameter in RATE_PER_MIN:
            per_minute = np.abs(np.diff(path)).max() * 20.0 * 60.0
            low, high = RATE_PER_MIN[change.parameter]
            assert low * 0.999 <= per_minute <= high * 1.001
            assert total > 0.1 * abs(HEALTHY[HEALTH.index(change.parameter)] - path.mean())
        elif change.parameter == "heat_transfer":
            assert HEAT_TRANSFER_LOSS[0] <= total <= HEAT_TRANSFER_LOSS[1]
        else:
            assert BIAS_STEP_K[0] <= total <= BIAS_STEP_K[1]
            assert np.count_nonzero(np.diff(path)) <= 2


def test_the_papers_recordings_change_every_parameter_in_turn_and_the_bias_either_way():
    assert [s.kind for s in SINGLES] == [*SINGLE_KINDS, *SINGLE_KINDS]
    assert set(SINGLE_KINDS) == set(HEALTH)
    signs = {np.sign(draw("x", "T_bias_K", seed, 10.0, 1.0, np.full(MIX, 0.5)).changes[0].end) for seed in range(20)}
    assert signs == {-1.0, 1.0}


@each_single
def test_a_single_sequence_joins_one_health_change_with_transients_that_do_not_care(scenario):
    (change,) = scenario.changes
    u = scenario.inputs()
    t = scenario.time_s()[1:]
    kept = t > WARM_S
    steps = t[kept & (np.abs(np.diff(u[:, 0])) > 0.005)]  # bar in one sample: only a step does that
    ramps = t[kept & (np.abs(np.diff(u[:, 3])) > 1e-5)]
    for transients in (steps, ramps):
        assert len(transients) > 0
        assert ((transients < change.begin_s) | (transients > change.finish_s)).any()
    assert np.abs(steps - change.begin_s).min() > 0.2  # a step does not announce the change


def test_changes_come_at_no_fixed_time_and_at_no_fixed_distance_from_a_step():
    begins = np.array([s.changes[0].begin_s for s in SINGLES])
    assert np.ptp(begins) > 180.0
    steps = [s.drive.p_suc_bar[1::2, 0] for s in SINGLES]
    since = np.array([b - at[at < b].max() for b, at in zip(begins, steps, strict=True)])
    assert np.ptp(since) > 60.0
    assert any((at > s.changes[0].begin_s).any() for at, s in zip(steps, SINGLES, strict=True))


@pytest.mark.parametrize("part", PARTS)
def test_the_hypercube_fills_every_stratum_once(part):
    count = getattr(CONFIG, f"n_{part}")
    mix = latin_hypercube(count, count, MIX, CONFIG.seed, part)
    assert mix.shape == (count, MIX)
    assert np.array_equal(np.sort(np.floor(mix * count), axis=0), np.tile(np.arange(count)[:, None], (1, MIX)))


@pytest.mark.parametrize("count", [0, 1, 5, 26, 40])
def test_a_row_of_the_hypercube_does_not_depend_on_how_many_there_are(count):
    assert np.array_equal(latin_hypercube(count, 26, MIX, "a"), latin_hypercube(60, 26, MIX, "a")[:count])


@pytest.mark.parametrize("part", PARTS)
def test_a_sequence_does_not_depend_on_how_many_others_there_are(part):
    few = design(DesignConfig(n_train=3, n_validation=2, n_calibration=1, n_test=3, n_single=2))[part]
    whole = {s.name: s for s in DESIGN[part]}
    for one in few:
        same = whole[one.name]
        assert np.array_equal(one.inputs(), same.inputs())
        assert np.array_equal(one.health(), same.health())


def test_streams_are_told_apart_by_every_axis():
    first = {axes: stream(*axes).random() for axes in [(1, "a"), (1, "b"), (2, "a"), (1, "a", "sensors"), ("1", "a")]}
    assert len(set(first.values())) == len(first)
    assert stream(1, "a").random() == first[(1, "a")]


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"n_train": 0}, "n_train is 0"),
        ({"n_test": 1001}, "n_test is 1001"),
        ({"n_single": -1}, "n_single is -1"),
        ({"minutes": 0.5}, "minutes is 0.5"),
        ({"minutes": float("nan")}, "minutes is nan"),
        ({"warmup_minutes": -1.0}, "warmup_minutes is -1.0"),
        ({"minutes": 5.0, "warmup_minutes": 5.0}, "must be shorter than minutes"),
    ],
)
def test_an_impossible_design_is_refused(settings, says):
    with pytest.raises(BadInput, match=says):
        DesignConfig(**settings)
