"""Re-simulated training sequences: loads recombined, other wear, still what the plant does."""

import numpy as np
import pytest

from twinbench.data.benchmark import DesignConfig, simulate_benchmark
from twinbench.machines.compressor import COMPRESSOR, HEALTH
from twinbench.methods.resimulate import resimulate
from twinbench.physics.compressor import PLANT
from twinbench.physics.integrate import Varying, simulate


@pytest.fixture(scope="module")
def both():
    train = simulate_benchmark(
        DesignConfig(n_train=3, n_validation=1, n_calibration=1, n_test=1, n_single=0, minutes=3.0, warmup_minutes=0.5)
    ).train
    return train, resimulate(train, np.random.default_rng(0), copies=2)


def test_the_originals_come_first_and_every_copy_recombines_their_loads(both):
    train, more = both
    assert len(more) == 9
    assert len(set(more.names)) == 9
    assert np.array_equal(more.measured[:3], train.measured, equal_nan=True)
    for copy in (slice(3, 6), slice(6, 9)):
        for channel in range(3):
            again = more.truth.inputs[copy, :, channel]
            order = np.argsort(again[:, 0]), np.argsort(train.truth.inputs[:, 0, channel])
            assert np.array_equal(again[order[0]], train.truth.inputs[order[1], :, channel])
    assert not np.array_equal(more.truth.inputs[3:6], more.truth.inputs[6:9])


def test_the_recombined_ratios_stay_where_the_machine_is_run(both):
    _, more = both
    ratio = more.truth.outputs[3:, :, 0] / more.truth.inputs[3:, :, 0]
    valve = more.truth.inputs[3:, :, 3]
    assert 1.7 < ratio.min() < ratio.max() < 5.5
    assert 0.1 < valve.min() < valve.max() <= 1.0


def test_health_is_new_and_possible(both):
    train, more = both
    health = more.truth.health[3:]
    assert ((health >= COMPRESSOR.coordinates.low) & (health <= COMPRESSOR.coordinates.high)).all()
    assert (health[:3].std(axis=1) != train.truth.health.std(axis=1)).any()
    assert not np.array_equal(health[:3], health[3:])


def test_truth_is_what_the_plant_does_under_that_health(both):
    _, more = both
    x, y = simulate(PLANT, more.truth.inputs, more.truth.states[:, 0], varying=Varying(HEALTH, more.truth.health))
    assert np.array_equal(x, more.truth.states)
    assert np.array_equal(y, more.truth.outputs)


def test_without_truth_there_is_nothing_to_run_again(both):
    with pytest.raises(ValueError, match="need"):
        resimulate(both[0].without_truth(), np.random.default_rng(0), 1)
