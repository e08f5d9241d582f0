"""Health parameters keep their bounds whatever the filter does in its own coordinates."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from twinbench.physics.health import HEALTHY, HIGH, LOW, theta_and_slope, to_theta, to_zeta

coordinates = arrays(np.float64, (3, 5), elements=st.floats(-1e3, 1e3))
worn = st.floats(0, 1).map(lambda s: HEALTHY + s * (np.array([0.88, 0.90, 0.052, 0.65, 6.0]) - HEALTHY))


def test_healthy_is_zero_and_one_unit_is_one_typical_change():
    theta, slope = theta_and_slope(np.zeros(5))
    assert np.allclose(theta, HEALTHY)
    assert np.allclose(slope, [0.02, 0.02, 0.004, 0.05, 0.5])


@given(coordinates)
def test_always_in_bounds_with_finite_slope(zeta):
    theta, slope = theta_and_slope(zeta)
    assert ((theta >= LOW) & (theta <= HIGH)).all()
    assert np.isfinite(slope).all()
    assert (slope >= 0).all()


@given(worn)
def test_round_trip(theta):
    assert np.allclose(to_theta(to_zeta(theta)), theta, rtol=1e-10, atol=1e-12)


@given(arrays(np.float64, 5, elements=st.floats(-5, 5)))
def test_slope_is_the_derivative(zeta):
    step = 1e-6
    difference = (to_theta(zeta + step) - to_theta(zeta - step)) / (2 * step)
    assert np.allclose(theta_and_slope(zeta)[1], difference, rtol=1e-5, atol=1e-9)
