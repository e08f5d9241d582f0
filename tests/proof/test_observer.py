"""The ideal observer: columns against runs of their own, distances and classes against geometry done by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import toeplitz
from short_machines import SHORT, measured

from twinbench.mismatch.model import whole_catalogue
from twinbench.proof.concealed.changes import change_of
from twinbench.proof.concealed.columns import Picture, picture
from twinbench.proof.concealed.faults import all_faults
from twinbench.proof.concealed.forms import forms
from twinbench.proof.concealed.integrate import Parameters
from twinbench.proof.concealed.linear import Linear
from twinbench.proof.concealed.machine import Machine, Noise, behind_play
from twinbench.proof.concealed.observer import Seen, log_bayes, observe
from twinbench.proof.concealed.on_twin import OnTwin
from twinbench.proof.concealed.severity import readings
from twinbench.proof.concealed.whiten import whitened
from twinbench.proof.twins import simulator_of

SMOOTH = {
    "compressor": ("suction_valve_loss", "discharge_head_metal", "flow_meter_gain", "input_gain@N_rpm"),
    "heat_exchanger": ("loss_to_ambient@wall_1_K", "second_thermal_mass@oil_2_K", "input_gain@oil_kg_s"),
    "motor": ("quadratic_friction@omega_rad_s", "second_thermal_mass@T_winding_K", "input_bias@load_Nm"),
    "two_tanks": ("linear_leak@h1_cm", "backlash@pump_V", "sensor_lag@level1_cm"),
}


def named(machine: Machine, name: str) -> Any:
    return next(e for e in (*machine.effects, *machine.foreign, *all_faults(machine)) if e.name == name)


# Columns.


@pytest.mark.parametrize("name", sorted(SHORT))
def test_first_order_columns_are_what_runs_of_their_own_give(name: str) -> None:
    yardstick = measured(SHORT[name])
    effects = [named(SHORT[name], effect) for effect in SMOOTH[name]]
    changes = [change_of(yardstick, effect) for effect in effects]
    sizes = [0.05 * change.start for change in changes]
    linear = Linear(yardstick, -np.inf)
    columns = linear.changes(list(zip(effects, sizes, strict=True)))
    sigma = yardstick.sigma[:, None]
    for effect, change, size, column in zip(effects, changes, sizes, columns, strict=True):
        for i, run in enumerate(change.of(size)):
            exact = ((run - yardstick.base[i]).T / sigma).ravel()
            # A machine has not quite settled when a recording begins: what its starts do is projected out in any case.
            starts = (linear.starts(i) / sigma).reshape(len(yardstick.starts[i]), -1).T
            error = (column[i] / sigma).ravel() - exact
            error -= starts @ np.linalg.lstsq(starts, error, rcond=None)[0]
            assert np.linalg.norm(error) < 0.02 * np.linalg.norm(exact), effect.name


@pytest.mark.parametrize("name", sorted(SHORT))
def test_columns_of_starts_and_parameters_are_finite_differences(name: str) -> None:
    machine = SHORT[name]
    yardstick = measured(machine)
    linear, take, x0, p = Linear(yardstick, -np.inf), yardstick.takes[0], yardstick.starts[0], yardstick.p
    at = next(iter(machine.slow))
    moved = x0.copy()
    moved[at] += 0.01 * machine.slow[at]
    steady = Parameters.steady(p)
    run = readings(machine, take, take.u, moved, steady, machine.coarse)
    assert 100.0 * (run - yardstick.base[0]).T == pytest.approx(linear.starts(0)[at], rel=0.02, abs=1e-3)
    first = machine.calibrate[0]
    changed = p.copy()
    changed[machine.at(first)] += 1e-3 * yardstick.step(first)
    run = readings(machine, take, take.u, x0, Parameters.steady(changed), machine.coarse)
    column = linear.nuisances(0, rippled=False)[0]
    wanted = 1e3 * (run - yardstick.base[0]).T
    assert np.abs(wanted - column).max() < 0.02 * np.abs(column).max()


def test_an_effects_column_is_nothing_before_its_onset() -> None:
    machine = SHORT["motor"]
    yardstick = measured(machine)
    onset_s = yardstick.takes[1].start_s + 20.0
    ((first, second, third),) = Linear(yardstick, onset_s).changes([(machine.effects[0], 1.0)])
    before = round(20.0 / machine.period_s)
    assert np.abs(first).max() == 0.0
    assert np.abs(second[:, :before]).max() == 0.0
    assert np.abs(second[:, before + 2 :]).max() > 0.0
    assert np.abs(third).max() > 0.0


def test_the_ripple_is_there_to_be_projected_out_where_there_is_one() -> None:
    yardstick = measured(SHORT["two_tanks"])
    there = {"leak@h1_cm": 0.01}
    without, with_ripple = (picture(OnTwin(yardstick, -np.inf), there, pct) for pct in (0.0, 1.0))
    at = without.names.index("leak@h1_cm")
    assert with_ripple.gram[at, at] < 0.95 * without.gram[at, at]
    assert with_ripple.raw == pytest.approx(without.raw)
    assert (np.diag(without.gram) <= without.raw * (1.0 + 1e-9)).all()


def test_the_distance_from_none_is_what_a_fit_of_all_nuisances_at_once_leaves() -> None:
    """By whitened least squares over the training recordings together, starts and parameters one below the other."""
    machine = replace(SHORT["two_tanks"], ambient=0.0)
    yardstick, size = measured(machine), 0.01
    view = picture(OnTwin(yardstick, -np.inf), {"leak@h1_cm": size}, 0.0)
    made = change_of(yardstick, named(machine, "leak@h1_cm")).of(size)
    training = [i for i, take in enumerate(yardstick.takes) if not take.held_out]
    linear, takes, K = Linear(yardstick, -np.inf), len(training), len(machine.calibrate)
    nx = len(yardstick.starts[0])

    def white(columns: np.ndarray) -> np.ndarray:
        channels = [
            whitened(machine.noise[name], machine.lsb[name], machine.period_s, columns[:, c])
            for c, name in enumerate(machine.outputs)
        ]
        return np.concatenate(channels, axis=-1).T

    rows, target = [], []
    for k, i in enumerate(training):
        own = white(yardstick.parameters[i])
        block = np.zeros((len(own), K + takes * nx))
        block[:, :K], block[:, K + k * nx : K + (k + 1) * nx] = own, white(linear.starts(i))
        rows.append(block)
        target.append(white((made[i] - yardstick.base[i]).T[None])[:, 0])
    prior = np.diag([np.sqrt(3.0)] * K + [1.0 / 50.0] * (takes * nx))
    A, b = np.concatenate([*rows, prior]), np.concatenate([*target, np.zeros(len(prior))])
    left = b - A @ np.linalg.lstsq(A, b, rcond=None)[0]
    at = view.names.index("leak@h1_cm")
    assert view.gram[at, at] == pytest.approx(left @ left, rel=1e-6)


# Whitening.


def test_innovations_have_the_norm_that_the_noises_covariance_gives() -> None:
    noise, lsb, period_s = Noise(0.3, 0.4, 0.7), 0.1, 0.05
    lags = np.arange(800) * period_s
    covariance = noise.coloured**2 * toeplitz(np.exp(-lags / noise.tau_s))
    covariance += np.eye(len(lags)) * (noise.white**2 + lsb**2 / 12.0)
    series = np.stack([np.sin(lags), np.exp(-lags / 9.0) * lags])
    white = whitened(noise, lsb, period_s, series)
    assert white @ white.T == pytest.approx(series @ np.linalg.solve(covariance, series.T), rel=2e-3, abs=0.1)
    assert whitened(Noise(0.5, 0.0, 1.0), 0.0, period_s, series) == pytest.approx(series / 0.5)


# Play.


def test_play_follows_its_input_by_half_its_width_and_none_is_no_change() -> None:
    up_and_down = np.concatenate([np.linspace(0.0, 3.0, 31), np.linspace(3.0, 0.0, 31)])
    assert (behind_play(up_and_down, np.zeros(62)) == up_and_down).all()
    behind = behind_play(up_and_down, np.ones(62))
    assert behind[30] == pytest.approx(2.5)
    assert behind[-1] == pytest.approx(0.5)
    machine = SHORT["motor"]
    yardstick = measured(machine)
    changed = change_of(yardstick, named(machine, "backlash@voltage_V")).of(0.0)
    assert all((a == b).all() for a, b in zip(changed, yardstick.base, strict=True))


# Geometry.


def drawn(columns: np.ndarray, two_sided: tuple[int, ...] = (), foreign: tuple[int, ...] = ()) -> Picture:
    gram = columns @ columns.T
    several = np.arange(len(columns))
    names = tuple("abcdef"[: len(columns)])
    return Picture(
        names, gram, np.diag(gram), np.ones(len(columns)), np.isin(several, two_sided), np.isin(several, foreign)
    )


def seen(made: Picture, *beside: str) -> Seen:
    return observe(made, "a", beside, np.random.default_rng(0))


def test_distances_are_those_between_points_and_lines() -> None:
    a, b, far = np.array([10.0, 0.0, 0.0]), 3.0 * np.array([0.8, 0.6, 0.0]), np.array([0.0, 0.0, 5.0])
    found = seen(drawn(np.stack([a, b, far])))
    assert found.same == ("a",)
    assert (found.rival, found.from_none) == ("b", pytest.approx(100.0))
    assert found.from_rival == pytest.approx((10.0 * 0.6) ** 2)
    assert found.detectable
    assert not seen(drawn(np.stack([0.5 * a, b, far]))).detectable  # 25 from none
    assert not seen(drawn(np.stack([0.6 * a, b, far]))).detectable  # 36 from none, 13 from b
    assert found.close == ()
    assert seen(drawn(np.stack([0.6 * a, b, far]))).close == ("b",)
    assert seen(drawn(np.stack([0.6 * a, b, a + b[::-1]]))).close == ("b", "c")


def test_a_class_is_what_points_the_same_way() -> None:
    a, near = np.array([10.0, 0.0]), np.array([1.0, 0.03])
    found = seen(drawn(np.stack([a, near, -near, 2.0 * a]), two_sided=(), foreign=(3,)))
    assert found.same == ("a", "b")
    assert seen(drawn(np.stack([a, -near]), two_sided=(1,))).same == ("a", "b")
    assert seen(drawn(np.stack([a, -near]))).from_rival == 100.0  # it cannot be negative


def test_what_stands_beside_an_effect_is_projected_out() -> None:
    a, beside, rival = np.array([3.0, 4.0, 0.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 1.0])
    found = seen(drawn(np.stack([a, beside, rival])), "b")
    assert found.from_none == pytest.approx(16.0)
    assert (found.rival, found.from_rival) == ("c", pytest.approx(8.0))


def test_what_is_the_same_to_all_readings_is_one_class_by_the_machines_own_equations() -> None:
    """A bias of the load is an offset of the speed's balance, and the flow meter's gain has two names."""
    for name, effect, size, other in (
        ("motor", "offset@omega_rad_s", 0.3, "input_bias@load_Nm"),
        ("compressor", "flow_meter_gain", 0.02, "sensor_gain@m_flow_kg_s"),
    ):
        view = picture(OnTwin(measured(SHORT[name]), -np.inf), {effect: size}, 0.0)
        assert other in observe(view, effect, (), np.random.default_rng(0)).same


def test_a_rival_may_begin_when_the_effect_does() -> None:
    """A bias of the pump's voltage is an offset of the level's balance, from the same time on as from the beginning."""
    yardstick = measured(SHORT["two_tanks"])
    view = picture(OnTwin(yardstick, yardstick.takes[1].start_s + 20.0), {"offset@h1_cm": 0.02}, 0.0)
    assert "input_bias@pump_V" in observe(view, "offset@h1_cm", (), np.random.default_rng(0)).same


def test_forms_of_the_catalogue_without_a_truth_are_told_from_an_effect_too() -> None:
    """Radiation, of which no truth is drawn, is a loss to the ambient over a few tens of kelvins."""
    machine = SHORT["heat_exchanger"]
    yardstick, effect = measured(machine), "loss_to_ambient@water_2_K"
    view = picture(OnTwin(yardstick, -np.inf), {effect: 0.01}, 0.0)
    catalogue = {
        m.name for m in whole_catalogue(simulator_of(machine.simulator, machine.network), (), machine.period_s)
    }
    assert not {e.name for e in machine.effects} & {"radiation@water_2_K", "offset@water_2_K"}
    assert set(view.names) >= {"radiation@water_2_K", "offset@water_2_K"}
    assert set(view.names) <= catalogue
    assert {effect, "radiation@water_2_K"} <= set(observe(view, effect, (), np.random.default_rng(0)).same)


def test_a_form_begins_at_the_onset_and_does_what_the_truth_of_the_same_name_does() -> None:
    machine = SHORT["two_tanks"]
    yardstick, effect = measured(machine), named(SHORT["two_tanks"], "linear_leak@h1_cm")
    onset_s = yardstick.takes[1].start_s + 20.0
    made = {form.name: form for form in forms(OnTwin(yardstick, onset_s), ())}[effect.name]
    ((_, second, third),) = Linear(yardstick, onset_s).changes([(effect, effect.typical)])
    assert np.abs(made.columns[0]).max() < 1e-6 * np.abs(made.columns[1]).max()
    assert cosine(made.columns[1], second) > 0.95, "of another size"
    assert np.abs(made.columns[2]).max() == 0.0, "held out"
    assert np.abs(third).max() > 0.0


def cosine(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sum(a * b) / np.sqrt(np.sum(a**2) * np.sum(b**2)))


# The posterior.


@pytest.mark.parametrize("one_sided", [True, False])
def test_the_bayes_factor_is_the_integral_over_sizes(one_sided: bool) -> None:
    b, g, s = 2.3, 4.1, 0.7

    def integrand(size: float) -> float:
        prior = np.exp(-0.5 * (size / s) ** 2) / (s * np.sqrt(2.0 * np.pi)) * (2.0 if one_sided else 1.0)
        return float(prior * np.exp(b * size - 0.5 * g * size**2))

    integral = quad(integrand, 0.0 if one_sided else -8.0, 8.0)[0]
    found = log_bayes(np.array([b]), np.array([g]), np.array([s]), np.array([one_sided]))
    assert found == pytest.approx(np.log(integral), rel=1e-9)


def test_the_ideal_observer_is_sure_of_what_is_far_from_all_else_alone() -> None:
    far, other = np.array([20.0, 0.0]), np.array([0.0, 20.0])
    assert seen(drawn(np.stack([far, other])))[-2:] == (1.0, 1.0)
    assert seen(drawn(np.stack([0.05 * far, other])))[-2:] == (0.0, 0.0)
    twins = seen(drawn(np.stack([far, far, other])))
    assert (twins.named, twins.classed) == (0.0, 1.0)


def test_a_machine_needs_neither_ambient_nor_slow_states() -> None:
    machine = replace(SHORT["two_tanks"], ambient=0.0, slow={})
    view = picture(OnTwin(measured(machine), -np.inf), {"leak@h1_cm": 0.01}, 0.2)
    assert np.isfinite(view.gram).all()
