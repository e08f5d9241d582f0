"""How a candidate's parameters move with its size, and through which shapes it is tried."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motor import MOTOR

from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.model import load_simulator, whole_catalogue
from twinbench.mismatch.variants import SHAPES, Variant, switched, variants
from twinbench.physics.simulator import Amplitude
from twinbench.proof.real_recordings import ROOT

NOMINAL = load_simulator("nominal")
COMPRESSOR = Machine(NOMINAL, [m for m in whole_catalogue(NOMINAL) if isinstance(m, Amplitude)])


@given(j=st.integers(0, len(COMPRESSOR.candidates) - 1), size=st.floats(-2.0, 2.0))
def test_an_amplitude_moves_by_its_size(j, size):
    """Also where the simulator has what is typical, as an isothermal manifold: that one was mended by nothing once."""
    candidate = COMPRESSOR.candidates[j]
    theta = COMPRESSOR.simulator.theta() if len(COMPRESSOR.simulator.theta()) > max(candidate.at) else np.zeros(500)
    moved = switched(COMPRESSOR, theta, Variant(j, ()), size)
    assert moved[candidate.at[0]] == pytest.approx(candidate.null[0] + size)
    others = np.delete(np.arange(len(theta)), list(candidate.at))
    assert moved[others] == pytest.approx(theta[others])


def test_one_amplitude_has_nothing_but_the_simulators_own_value_as_typical():
    (one,) = (c for c in COMPRESSOR.candidates if c.name == "isothermal_manifold")
    assert one.typical[0] == one.null[0]


def test_every_shape_is_tried_through_its_range():
    machine = Machine(MOTOR, generic(MOTOR))
    listed = variants(machine.candidates)
    assert len(set(listed)) == len(listed), "what is tried twice counts for less"
    for j, candidate in enumerate(machine.candidates):
        shapes = [np.array(v.shape) for v in listed if v.candidate == j]
        for place, v in enumerate(candidate.mechanism.parameters[1:]):
            if not shapes[0].size:
                continue  # an amplitude
            tried = np.unique([shape[place] for shape in shapes])
            assert ((tried >= v.low) & (tried <= v.high)).all()
            assert len(tried) >= len(SHAPES)


def test_a_leak_may_open_between_the_floor_and_where_what_leaks_commonly_stands():
    tanks = load_simulator(str(ROOT / "examples" / "two_tanks.py"))
    leaks = [m for m in generic(tanks) if m.name.startswith("leak@")]
    assert leaks
    for leak in leaks:
        (state,) = (v for v in tanks.states if v.name == leak.name.removeprefix("leak@"))
        height = leak.parameters[1]
        assert height.low < max(state.low, 0.0)
        assert height.high > max(state.low, 0.0, state.nominal)
