"""Health parameters keep their bounds whatever the filter does in its own coordinates, on every machine."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.coordinates import map_one
from twinbench.machines.load import BUILTIN, load_machine

MACHINES = [load_machine(name) for name in BUILTIN]
each = pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.name)
WIDE = st.lists(st.floats(-1e3, 1e3), min_size=5, max_size=5).map(np.array)
NEAR = st.lists(st.floats(-5.0, 5.0), min_size=5, max_size=5).map(np.array)
WEAR = st.lists(st.floats(0.0, 1.0), min_size=5, max_size=5).map(np.array)


@each
def test_healthy_is_zero_and_one_unit_is_one_typical_change(machine):
    own = machine.coordinates
    theta, slope = own.theta_and_slope(np.zeros(len(machine.health)))
    assert np.allclose(theta, own.healthy)
    assert np.allclose(slope, [machine.variables[name].scale for name in machine.health_names])


@each
@given(zeta=WIDE)
@settings(max_examples=50)
def test_always_in_bounds_with_finite_slope(machine, zeta):
    own = machine.coordinates
    theta, slope = own.theta_and_slope(zeta)
    assert ((theta >= own.low) & (theta <= own.high)).all()
    assert np.isfinite(slope).all()
    assert (slope >= 0.0).all()


@each
@given(wear=WEAR)
@settings(max_examples=50)
def test_coordinates_and_back(machine, wear):
    theta, own = machine.start_of(wear), machine.coordinates
    assert np.allclose(own.to_theta(own.to_zeta(theta)), theta, rtol=1e-10, atol=1e-12)


@each
@given(zeta=NEAR)
@settings(max_examples=50)
def test_the_slope_is_the_derivative(machine, zeta):
    own, step = machine.coordinates, 1e-6
    ends = own.to_theta(zeta + step), own.to_theta(zeta - step)
    middle, slope = own.theta_and_slope(zeta)
    inside = (middle > own.low) & (middle < own.high)  # at a bound an exponential map has a corner
    difference = (ends[0] - ends[1]) / (2.0 * step)
    size = (own.high - own.low)[inside]
    assert np.abs((slope - difference)[inside] / size).max(initial=0.0) < 1e-7


def test_one_parameter_alone_is_mapped_as_among_all():
    zeta = np.linspace(-2.0, 2.0, 5)
    together = COMPRESSOR.coordinates.theta_and_slope(zeta)
    alone = [map_one(COMPRESSOR.coordinates, j, zeta[j]) for j in range(5)]
    assert np.array_equal(np.array(alone).T, np.stack(together))


@each
def test_the_prior_is_the_mean_and_variance_of_the_starts(machine):
    mean, cov = machine.prior
    wear = np.random.default_rng(0).random((200_000, len(machine.health)))
    zeta = machine.coordinates.to_zeta(machine.start_of(wear))
    sd = np.sqrt(np.diag(cov))
    assert (zeta.mean(axis=0) - mean) / sd == pytest.approx(np.zeros(len(mean)), abs=0.01)
    assert zeta.std(axis=0) / sd == pytest.approx(np.ones(len(mean)), abs=0.01)
    assert np.array_equal(cov, np.diag(np.diag(cov)))


@each
def test_what_filters_and_networks_are_given_holds_a_whole_life(machine):
    low, high = machine.counterfactual
    zeta_low, zeta_high = machine.zeta_bounds
    for end in np.array([h.ends for h in machine.health]).T:
        assert ((end >= low) & (end <= high)).all()
        zeta = machine.coordinates.to_zeta(end)
        assert ((zeta >= zeta_low) & (zeta <= zeta_high)).all()
