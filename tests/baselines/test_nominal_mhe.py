"""The window's least squares against scipy's, and against a filter and smoother where they must agree."""

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.optimize import least_squares

from twinbench.baselines.horizon import compose, sweep

N, M, K = 3, 2, 8


def machine(seed):
    rng = np.random.default_rng(seed)
    F = 0.9 * np.linalg.qr(rng.normal(size=(N, N)))[0]
    H, q, p = rng.normal(size=(M, N)), rng.normal(size=(N, N)), rng.normal(size=(N, N))
    return (
        F,
        H,
        0.1 * q @ q.T + 0.01 * np.eye(N),
        rng.normal(size=N),
        p @ p.T + 0.1 * np.eye(N),
        rng.normal(size=(K, M)),
    )


def test_on_a_linear_window_the_path_is_that_of_filterpys_smoother():
    F, H, Q, x0, P0, y = machine(0)
    variance = np.array([0.5, 0.2])
    reach = np.vstack([np.eye(N), H])
    path = np.random.default_rng(1).normal(size=(K, N))  # wherever it starts, one step is enough
    stages = (np.repeat(part[None], K, axis=0) for part in (reach @ F, reach @ Q @ reach.T))
    outcome = path @ (reach @ F).T
    z, covs = sweep(x0, P0, path, outcome, *stages, y, np.tile(variance, (K, 1)), np.inf)
    peer = KalmanFilter(N, M)
    peer.x, peer.P, peer.F, peer.H, peer.Q, peer.R = x0, P0, F, H, Q, np.diag(variance)
    means, ps, _, _ = peer.batch_filter(list(y))
    smoothed, *_ = peer.rts_smoother(np.vstack([x0[None], means]), np.concatenate([P0[None], ps]))
    np.testing.assert_allclose(z[1:], means, atol=1e-9)
    np.testing.assert_allclose(covs[1:], ps, atol=1e-9)
    np.testing.assert_allclose(path, smoothed[:-1], atol=1e-9)


def test_repeated_steps_reach_the_least_squares_estimate_of_a_machine_that_bends():
    F, H, Q, x0, P0, y = machine(2)
    variance, reach = np.array([0.5, 0.2]), np.vstack([np.eye(N), H])

    def move(x):
        return F @ x + 0.2 * np.sin(x)

    def cost(unknown):
        x, w = unknown[:N], unknown[N:].reshape(K, N)
        parts = [np.linalg.solve(np.linalg.cholesky(P0), x - x0)]
        for k in range(K):
            x = move(x) + np.linalg.cholesky(Q) @ w[k]
            parts += [w[k], (y[k] - H @ x) / np.sqrt(variance)]
        return np.concatenate(parts)

    best = least_squares(cost, np.r_[x0, np.zeros(K * N)], xtol=1e-14, ftol=1e-14, gtol=1e-12).x
    path = np.repeat(x0[None], K, axis=0)
    noise = np.repeat((reach @ Q @ reach.T)[None], K, axis=0)
    for _ in range(20):
        A = np.array([reach @ (F + np.diag(0.2 * np.cos(x))) for x in path])
        outcome = np.array([reach @ move(x) for x in path])
        z, _ = sweep(x0, P0, path, outcome, A, noise, y, np.tile(variance, (K, 1)), np.inf)
    x = best[:N]
    for k in range(K):
        np.testing.assert_allclose(path[k], x, atol=1e-6)
        x = move(x) + np.linalg.cholesky(Q) @ best[N + k * N : N + (k + 1) * N]
    np.testing.assert_allclose(z[-1], x, atol=1e-6)


def test_composed_ticks_are_the_ticks_one_after_another():
    rng = np.random.default_rng(3)
    T, q = 0.5 * rng.normal(size=(4, 4)), rng.normal(size=(4, 4))
    for ticks in (1, 2, 7, 20):
        whole, noise = np.eye(4), np.zeros((4, 4))
        for _ in range(ticks):
            whole, noise = T @ whole, T @ noise @ T.T + q @ q.T
        for got, want in zip(compose(T, q @ q.T, ticks), (whole, noise), strict=True):
            np.testing.assert_allclose(got, want, atol=1e-9)


def test_a_missing_reading_corrects_nothing():
    F, H, Q, x0, P0, y = machine(4)
    reach = np.vstack([np.eye(N), H])
    y[2] = np.nan
    y[3, 0] = np.nan
    path = np.zeros((K, N))
    stages = [np.repeat(part[None], K, axis=0) for part in (reach @ F, reach @ Q @ reach.T)]
    z, covs = sweep(x0, P0, path, path @ (reach @ F).T, *stages, y, np.tile([0.5, 0.2], (K, 1)), np.inf)
    np.testing.assert_allclose(z[3], F @ z[2], atol=1e-12)
    np.testing.assert_allclose(covs[3], F @ covs[2] @ F.T + Q, atol=1e-12)
    assert np.isfinite(path).all()
