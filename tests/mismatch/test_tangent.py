"""A run linearised along its own path: matrices against ``expm``, columns against forward runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record
from scipy.linalg import expm
from two_tanks import TANKS

from twinbench.data.recording import Recording
from twinbench.mismatch import tangent
from twinbench.mismatch.calibrate import own_unknowns, shared_unknowns
from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.faults import faults
from twinbench.mismatch.fit import Problem, Unknown
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.naming.view import View
from twinbench.mismatch.steps import settle_step
from twinbench.mismatch.tracks import prepare
from twinbench.mismatch.variants import Variant, switched, typical
from twinbench.physics.integrate import simulate
from twinbench.physics.simulator import Simulator, Variable

PROBE = 0.02
"""Share of its typical size that a candidate is tried with."""
FAST = "current_A"
"""The state whose time constant is hardly longer than a block of the motor's recording."""


def linear_machine(A: np.ndarray, C: np.ndarray) -> Machine:
    """x' = A x + u, y = C x."""

    def rhs(x, u, theta):
        return A @ x + u

    def several(kind: str, n: int) -> tuple[Variable, ...]:
        return tuple(Variable(f"{kind}{i}", "1", -1e6, 1e6, 0.0, 1.0) for i in range(n))

    simulator = Simulator(
        name="linear",
        states=several("x", len(A)),
        inputs=several("u", len(A)),
        outputs=several("y", len(C)),
        parameters=(Variable("idle", "1", 0.0, 1.0, 0.5, 1.0),),
        rhs=rhs,
        output=lambda x, u, theta: C @ x,
        initial=lambda u0, y0, theta: np.zeros(len(A)),
    )
    return Machine(simulator, ())


@pytest.mark.parametrize("rates", [(-0.3, -0.1), (-40.0, -0.2), (-3000.0, -1.0)], ids=["slow", "stiff", "very stiff"])
def test_the_matrices_of_a_stretch_are_exponentials(rates):
    turn = np.array([[1.0, 0.4], [0.2, 1.0]])
    A, C = turn @ np.diag(rates) @ np.linalg.inv(turn), np.array([[1.0, 0.5]])
    machine, seconds, count = linear_machine(A, C), 1.3, 4
    n, ny = A.shape[0], C.shape[0]
    E, G, Yx, Yf = np.empty((1, n, n)), np.empty((1, n, n)), np.empty((1, ny, n)), np.empty((1, ny, n))
    machine.loop(tangent.stretches)(
        *machine.equations,
        np.zeros((1, n)),
        np.array([seconds]),
        np.array([count]),
        np.zeros((1, n)),
        machine.ode(machine.theta),
        np.empty(0, dtype=np.int64),
        np.empty((1, 0)),
        np.arange(n),
        np.ones(n),
        *(E, G, Yx, Yf),
    )

    def both(t: float) -> tuple[np.ndarray, np.ndarray]:
        """exp(A t) and its integral up to t, from one exponential of a larger matrix (Van Loan)."""
        whole = expm(np.block([[A, np.eye(n)], [np.zeros((n, 2 * n))]]) * t)
        return whole[:n, :n], whole[:n, n:]

    end, forced = both(seconds)
    np.testing.assert_allclose(E[0], end, atol=2e-6)
    np.testing.assert_allclose(G[0], forced, atol=2e-6)
    at = [both(seconds * k / count) for k in range(count)]
    np.testing.assert_allclose(Yx[0], C @ np.mean([e for e, _ in at], axis=0), atol=2e-6)
    np.testing.assert_allclose(Yf[0], C @ np.mean([g for _, g in at], axis=0), atol=2e-6)


def tanks_recording() -> Recording:
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(2.0, 8.0, 30), 30)
    _, y = simulate(TANKS, u[None, :, None], np.array([10.0, 10.0]), dt_s=1.0, substeps=4)
    return Recording("tanks", np.arange(900.0), ("pump_V", "level1_cm", "level2_cm"), np.column_stack((u, y[0])))


WEARS = replace(MOTOR, drifts=("R_ohm",))


@pytest.fixture(scope="module", params=["motor", "a motor that wears", "tanks"])
def view(request) -> View:
    simulator, recording, period_s = {
        "motor": (MOTOR, record("motor", 1, seconds=60.0), 0.08),
        "a motor that wears": (WEARS, record("motor", 1, seconds=60.0), 0.08),
        "tanks": (TANKS, tanks_recording(), 1.0),
    }[request.param]
    tracks = prepare([recording], simulator)
    machine = Machine(simulator, (*generic(simulator), *faults(simulator, period_s)))
    scales = np.array([v.scale for v in simulator.outputs])
    settle_step(machine, tracks, 0.01 * scales)
    unknowns = (*shared_unknowns(simulator), *own_unknowns(simulator, tracks))
    problem = Problem(machine, tracks, unknowns, scales)
    return View.around(problem, problem.z0)


def compared(column: np.ndarray, run: np.ndarray) -> tuple[float, float]:
    """Cosine and ratio of lengths, where there are readings."""
    seen = np.isfinite(column) & np.isfinite(run)
    a, b = column[seen], run[seen]
    return float(a @ b / np.sqrt((a @ a) * (b @ b))), float(np.sqrt((a @ a) / (b @ b)))


def test_columns_of_unknowns_are_those_of_forward_runs(view):
    problem, z = view.problem, view.z
    (columns,) = problem.columns(z)
    for k, unknown in enumerate(problem.unknowns):
        step = PROBE * unknown.scale * (-1.0 if z[k] + PROBE * unknown.scale > unknown.high else 1.0)
        ahead = problem.residual(0, z + step * np.eye(len(z))[k])
        cosine, ratio = compared(columns[:, :, k], (view.residuals[0] - ahead) / step)
        assert cosine > 0.999, unknown.name
        assert ratio == pytest.approx(1.0, abs=0.08), unknown.name


def with_effect(name: str, size: float, since_s: float = -np.inf) -> Problem:
    """A motor that has a candidate at some share of its typical size, and the candidate's size among the unknowns."""
    tracks = prepare([record("motor", 1, seconds=60.0)], MOTOR)
    machine = Machine(MOTOR, (*generic(MOTOR), *faults(MOTOR, 0.08)))
    scales = np.array([v.scale for v in MOTOR.outputs])
    settle_step(machine, tracks, 0.01 * scales)
    (candidate,) = [c for c in machine.candidates if c.name == name]
    theta = machine.theta.copy()
    theta[list(candidate.at)] = [candidate.null[0] + size * typical(candidate), *candidate.null[1:]]
    scale = abs(typical(candidate))
    own = Unknown("size", "mechanism", candidate.at[0], -np.inf, np.inf, theta[candidate.at[0]], np.inf, scale)
    unknowns = (*shared_unknowns(MOTOR), *own_unknowns(MOTOR, tracks), own)
    return Problem(machine, tracks, unknowns, scales, theta=theta, since=(since_s,))


@pytest.mark.parametrize(
    ("name", "size", "since_s"),
    [
        ("sensor_lag@amps_A", 1.0, -np.inf),
        ("sensor_gain@speed_rad_s", 3.0, -np.inf),
        ("sensor_delay@amps_A", 1.0, -np.inf),
        ("coulomb_friction@omega_rad_s", 1.0, 30.0),
        ("input_gain@voltage_V", 3.0, 30.0),
        ("hysteresis@omega_rad_s", 0.0, -np.inf),
    ],
)
def test_columns_beside_an_effect_are_those_of_forward_runs(name, size, since_s):
    """A faulty sensor reads them, what is there later is not there before, and what remembers does so from nothing."""
    problem = with_effect(name, size, since_s)
    z = problem.z0
    (columns,), (here,) = problem.columns(z), problem.residuals(z)
    (by_runs,) = problem.columns(z, by_runs=True)
    for k, unknown in enumerate(problem.unknowns):
        step = PROBE * unknown.scale
        ahead = problem.residual(0, z + step * np.eye(len(z))[k])
        cosine, ratio = compared(columns[:, :, k], (here - ahead) / step)
        assert cosine > 0.995, unknown.name
        assert ratio == pytest.approx(1.0, abs=0.08), unknown.name
        cosine, ratio = compared(by_runs[:, :, k], (here - ahead) / step)
        assert cosine > 0.9999, unknown.name
        assert ratio == pytest.approx(1.0, abs=0.02), unknown.name


def test_columns_of_candidates_are_those_of_forward_runs(view):
    problem, z = view.problem, view.z
    listed = [Variant(i, tuple(c.null[1:])) for i, c in enumerate(problem.machine.candidates)]
    (columns,) = view.of_variants(listed, np.full(len(listed), PROBE))
    silent = []
    for i, variant in enumerate(listed):
        candidate = problem.machine.candidates[variant.candidate]
        size, first = PROBE * typical(candidate), candidate.mechanism.parameters[0]
        if not first.low <= candidate.null[0] + size <= first.high:
            size = -size
        ahead = problem.residual(0, z, switched(problem.machine, problem.theta, variant, size))
        run = (view.residuals[0] - ahead) / PROBE * np.sign(size)
        if not np.nanmax(np.abs(run)) > 0.0:
            silent.append(candidate.name)
            assert not columns[:, :, i].any(), candidate.name
            continue
        cosine, ratio = compared(columns[:, :, i], run)
        fast = candidate.mechanism.port.variable == FAST
        assert cosine > (0.98 if fast else 0.999), candidate.name
        assert fast or ratio == pytest.approx(1.0, abs=0.02), candidate.name
    assert len(silent) < 0.1 * len(listed)


def test_an_effect_of_a_fast_state_shows_where_inputs_jump():
    """A fast state is, nearly all of a stretch, where the input sends it: not halfway between two stretches."""

    def rhs(x, u, theta):
        return np.array([-theta[1] * (x[0] - u[0]), -0.2 * x[1] + theta[0] * x[0]])

    follows = Simulator(
        name="follows",
        states=(Variable("fast", "1", -9.0, 9.0, 0.0, 1.0), Variable("slow", "1", -99.0, 99.0, 0.0, 1.0)),
        inputs=(Variable("asked", "1", -9.0, 9.0, 0.0, 1.0),),
        outputs=(Variable("read", "1", -99.0, 99.0, 0.0, 1.0),),
        parameters=(Variable("drives", "1/s", 0.0, 2.0, 0.3, 0.1), Variable("rate", "1/s", 1.0, 99.0, 20.0, 5.0)),
        rhs=rhs,
        output=lambda x, u, theta: x[1:].copy(),
        initial=lambda u0, y0, theta: np.array([u0[0], y0[0]]),
    )
    u = np.repeat(np.random.default_rng(3).uniform(-1.0, 3.0, 100), 4)[None, :, None]
    _, y = simulate(follows, u, np.zeros(2), dt_s=0.8, substeps=64)
    recording = Recording("follows", 0.8 * np.arange(u.size), ("asked", "read"), np.column_stack((u[0, :, 0], y[0])))
    tracks = prepare([recording], follows)
    machine = Machine(follows, ())
    settle_step(machine, tracks, np.array([1e-3]))
    problem = Problem(machine, tracks, shared_unknowns(follows), np.ones(1))
    (columns,) = problem.columns(problem.z0)
    drives = columns[:, 0, 0]
    nudge = np.array([1e-3, 0.0])
    ahead, behind = (tracks[0].block_means(problem.readings(0, problem.z0 + way * nudge)) for way in (1.0, -1.0))
    exact = (ahead - behind)[:, 0] / 2e-3
    seen = np.isfinite(exact)
    assert np.linalg.norm((drives - exact)[seen]) < 0.01 * np.linalg.norm(exact[seen])
