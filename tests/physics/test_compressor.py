"""The plant keeps its books: mass and energy balances, stability, and the map it was built to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numba import njit

from twinbench.physics.compressor import BAR, CP, CV, FLUXES, HEALTH, PARAMETERS, PLANT, R_DRY, STATES, flux, rhs
from twinbench.physics.integrate import Varying, simulate
from twinbench.physics.nominal import NOMINAL, REDUCED, reduced
from twinbench.physics.simulator import Variable
from twinbench.physics.steady import steady_state, valve_for

WORN = np.array([0.88, 0.90, 0.052, 0.65, 6.0])
HEALTHY = np.array([v.nominal for v in HEALTH])
N_X = len(STATES)


@njit(error_model="numpy")
def _rhs_and_fluxes(x, u, theta):
    """The plant's rhs with its fluxes as further states, so that RK4 integrates them alike."""
    return np.concatenate((rhs_jit(x[:N_X], u, theta), flux(x[:N_X], u, theta), energy_out(x, u, theta)))


rhs_jit = njit(error_model="numpy")(rhs)


@njit(error_model="numpy")
def energy_out(x, u, theta):
    """Enthalpy in and out of the machine."""
    f = flux(x[:N_X], u, theta)
    m = 0.12 * x[4]
    return np.array([m * CP * f[5], (f[2] + f[3] + f[4]) * CP * x[2]])


def metered(simulator):
    totals = tuple(Variable(f"total_{v.name}", v.unit, -1e15, 1e15, 0.0) for v in FLUXES)
    totals += (Variable("H_in", "J", -1e15, 1e15, 0.0), Variable("H_out", "J", -1e15, 1e15, 0.0))
    return replace(simulator, states=simulator.states + totals, rhs=_rhs_and_fluxes, flux=None, balance=None, fluxes=())


def corner_inputs(seconds: float, seed: int) -> np.ndarray:
    """Speed, suction pressure and pressure ratio thrown from corner to corner every 2 s."""
    rng = np.random.default_rng(seed)
    n = int(seconds / 0.05)
    block = np.arange(n) // 40
    pick = rng.integers(2, size=(3, block[-1] + 1))[:, block]
    N = np.where(pick[0], 1800.0, 900.0)
    p = np.where(pick[1], 1.08, 0.82)
    valve = valve_for(N, np.where(pick[2], 5.0, 2.1))
    return np.stack([p, np.full(n, 298.0), N, valve], axis=-1)[None]


@pytest.mark.parametrize("leaks", [{}, {"A_ext_mm2": 5.0, "A_rec_mm2": 6.0, "UA_amb_W_K": 8.0}])
def test_mass_and_energy_balances_close_to_a_millionth_of_throughput(leaks):
    plant = metered(PLANT.with_values(**leaks))
    u = corner_inputs(120.0, seed=1)
    x0 = np.concatenate([steady_state(PLANT.with_values(**leaks), u[0, 0]), np.zeros(len(FLUXES) + 2)])
    x, _ = simulate(plant, u, x0)
    start, end = x[0, 0], x[0, -1]
    total = dict(zip([v.name for v in FLUXES] + ["H_in", "H_out"], end[N_X:], strict=True))
    theta = PLANT.theta()
    V_e, V_i = theta[PLANT.index("V_exh_m3")], theta[PLANT.index("V_int_m3")]
    delivered = total["H_in"] / CP / 298.0 if not leaks else None

    def exhaust_mass(z):
        return z[1] * BAR * V_e / (R_DRY * z[2])

    def intake_mass(z):
        return z[0] * BAR * V_i / (R_DRY * 298.0)

    off = total["m_out_kg_s"] + total["m_ext_kg_s"] + total["m_rec_kg_s"]
    if delivered is not None:
        assert abs(intake_mass(end) - intake_mass(start) - total["m_in_kg_s"] + delivered) < 1e-6 * delivered
        assert abs(exhaust_mass(end) - exhaust_mass(start) - delivered + off) < 1e-6 * delivered
    stored = sum(
        capacity * (end[i] - start[i])
        for capacity, i in (
            (BAR * V_e * CV / R_DRY, 1),
            (theta[PLANT.index("C_w_J_K")], 3),
            (theta[PLANT.index("C_h_J_K")], 7),
        )
    )
    supplied = total["W_W"] + total["Q_f_W"] + total["H_in"]
    lost = total["H_out"] + total["Q_c_W"] + total["Q_ha_W"] + total["Q_amb_W"]
    assert abs(stored - supplied + lost) < 1e-6 * total["W_W"]


@pytest.mark.parametrize("simulator", [PLANT, NOMINAL], ids=["plant", "nominal"])
@pytest.mark.parametrize("health", [HEALTHY, WORN], ids=["healthy", "worn"])
def test_finite_and_bounded_from_corner_to_corner(simulator, health):
    u = corner_inputs(300.0, seed=2)
    values = np.broadcast_to(health, (1, u.shape[1], 5))
    x0 = simulator.initial(u[0, 0], np.array([3.0, 430.0, 0.12]), simulator.theta())
    x, y = simulate(simulator, u, x0, varying=Varying([v.name for v in HEALTH], values))
    low, high = (np.array([getattr(v, side) for v in STATES]) for side in ("low", "high"))
    assert np.isfinite(y).all()
    assert (x >= low).all()
    assert (x <= high).all()


def test_two_substeps_agree_with_sixteen():
    u = corner_inputs(60.0, seed=3)
    x0 = steady_state(PLANT, u[0, 0])
    coarse, fine = (simulate(PLANT, u, x0, substeps=n)[0] for n in (2, 16))
    assert np.abs(coarse - fine)[..., 1].max() < 2e-3  # bar
    assert np.abs(coarse - fine)[..., 2].max() < 0.1  # K


@pytest.mark.parametrize("N_rpm", [900.0, 1350.0, 1800.0])
@pytest.mark.parametrize("ratio", [2.1, 3.3, 5.0])
def test_every_pressure_ratio_is_reached_at_every_speed(N_rpm, ratio):
    valve = float(valve_for(N_rpm, ratio))
    assert 0.2 < valve < 1.0
    x = steady_state(PLANT, np.array([0.95, 298.0, N_rpm, valve]))
    assert x[1] / 0.95 == pytest.approx(ratio, rel=0.01)


@pytest.mark.parametrize(
    ("name", "change", "signs"),
    [
        ("capacity", -0.06, (-1, -1, -1)),
        ("efficiency", -0.05, (0, 1, 0)),
        ("leakage", 0.018, (-1, -1, -1)),
        ("heat_transfer", -0.2, (0, 1, 0)),
        ("T_bias_K", 3.0, (0, 1, 0)),
        ("K_s", 0.04, (-1, 0, -1)),
        ("A_ext_mm2", 5.0, (-1, -1, 1)),
        ("b_in", 1.5e5, (-1, 0, -1)),
        ("UA_amb_W_K", 8.0, (-1, -1, 0)),
        ("T_c_K", 12.0, (0, 1, 0)),
        ("flow_gain", 0.02, (0, 0, 1)),
        ("slip", 0.02, (0, 0, 0)),
        ("stem", 0.05, (0, -1, 0)),
        ("flutter", 0.1, (0, 0, 0)),
    ],
)
def test_each_parameter_moves_the_readings_its_way(name, change, signs):
    """Signs of the steady response at 1350 rpm, pressure ratio 3.3; 0 where it is small."""
    u = np.array([0.95, 298.0, 1350.0, 0.644])
    readings = []
    for value in (PLANT.theta()[PLANT.index(name)], PLANT.theta()[PLANT.index(name)] + change):
        machine = PLANT.with_values(**{name: value})
        x = steady_state(machine, u)
        readings.append(machine.output(x, u, machine.theta()))
    step = (readings[1] - readings[0]) / np.array([0.03, 3.0, 0.0012])
    for moved, sign in zip(step, signs, strict=True):
        if sign:
            assert np.sign(moved) == sign
            assert abs(moved) > 0.3
        else:
            assert abs(moved) < 1.0


def test_nominal_differs_in_the_named_effects_only():
    plant, nominal = PLANT.theta(), NOMINAL.theta()
    differing = {v.name for v, a, b in zip(PARAMETERS, plant, nominal, strict=True) if a != b}
    assert differing == set(REDUCED)
    assert np.array_equal(reduced(0.0).theta(), plant)


def test_nominal_delivers_several_per_cent_too_much_before_recalibration():
    u = np.array([0.95, 298.0, 1350.0, 0.644])
    plant, nominal = steady_state(PLANT, u), steady_state(NOMINAL, u)
    assert 0.03 < nominal[4] / plant[4] - 1 < 0.10
