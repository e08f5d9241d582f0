"""What machines are run through: drawn from a stream, within bounds, and leaning where they are told to."""

from __future__ import annotations

import numpy as np
import pytest

from twinbench.data.scenario import stream
from twinbench.machines.load import BUILTIN, load_machine
from twinbench.machines.loads import along, joined, pieces

each = pytest.mark.parametrize("machine", [load_machine(name) for name in BUILTIN], ids=lambda machine: machine.name)
SECONDS = 900.0


def driven(machine, lean: float, *axes: object) -> np.ndarray:
    time_s = np.arange(0.0, SECONDS, machine.sample_period_s)
    return machine.loads(SECONDS, np.full(machine.leans, lean), stream(*axes))(time_s)


@each
def test_one_stream_gives_the_same_loads_and_another_does_not(machine):
    first, again, other = driven(machine, 0.5, 1, "a"), driven(machine, 0.5, 1, "a"), driven(machine, 0.5, 1, "b")
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@each
def test_inputs_stay_within_their_bounds_and_move(machine):
    for lean in (0.0, 0.5, 1.0):
        u = driven(machine, lean, lean, "bounds")
        low, high = (np.array([getattr(v, end) for v in machine.plant.inputs]) for end in ("low", "high"))
        assert u.shape[1] == len(machine.inputs)
        assert ((u >= low) & (u <= high)).all()
        assert (np.ptp(u, axis=0) > 0.0).all()


@each
def test_what_is_nearer_in_time_is_the_same_on_a_finer_grid(machine):
    drive = machine.loads(SECONDS, np.full(machine.leans, 0.5), stream(3))
    coarse, fine = np.arange(0.0, 100.0, 1.0), np.arange(0.0, 100.0, 0.5)
    assert np.array_equal(drive(fine)[::2], drive(coarse))


def test_a_lean_tilts_levels():
    means = [
        np.mean([along(pieces(stream(k), 600.0, (0.0, 1.0), lean, (10.0, 20.0), (1.0, 2.0)), TIMES) for k in range(20)])
        for lean in (0.0, 0.5, 1.0)
    ]
    assert means[0] < means[1] < means[2]
    assert means[1] == pytest.approx(0.5, abs=0.05)


TIMES = np.arange(0.0, 600.0, 1.0)


def test_courses_hold_and_ramp():
    knots = np.array([[0.0, 1.0], [10.0, 1.0], [20.0, 3.0]])
    higher = np.stack([knots[:, 0], knots[:, 1] + 1.0], axis=-1)
    u = joined(knots, higher)(np.array([5.0, 15.0, 30.0]))
    assert np.array_equal(u, [[1.0, 2.0], [2.0, 3.0], [3.0, 4.0]])
