"""A made-up finished run: truth that wears, and estimators that miss it by a known factor."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd

from twinbench.bench.cells import save_split
from twinbench.bench.estimates import Estimates
from twinbench.bench.statistics.scores import score
from twinbench.common.store import Store
from twinbench.data.batch import Batch, Truth
from twinbench.data.benchmark import Split
from twinbench.machines.compressor import COMPRESSOR, ESTIMATED
from twinbench.physics.compressor import M_REF_KG_S

LEVELS = {
    "oracle": 1.0, "always_prior": 2.2, "nominal_ekf": 2.6, "gru_kf": 2.0, "lstm_rls": 5.0, "deeponet": 3.2,
    "pinn_ukf": 1.7, "deeponet_kalman": 1.2,
}  # fmt: skip
"""How many times the oracle's error each estimator makes."""
SCALE = np.array([0.004, 0.006, 1.2, 2.5, 0.003, 0.006, 0.008, 0.0012, 0.025, 0.4])
LATENCY = "estimator,mode,implementation,window,p50_us,p95_us,p99_us,max_us,memory_kB\n"


def make_truth(sequences: int = 10, seconds: int = 600, seed: int = 0) -> Batch:
    """(B, N) at 1 Hz: load pieces, and one health parameter after the other that wears in mid-sequence."""
    rng = np.random.default_rng(seed)
    B, N = sequences, seconds
    t = np.arange(N, dtype=float)
    load = np.cumsum(np.where(rng.random((B, N)) < 0.015, rng.normal(0, 0.5, (B, N)), 0.0), axis=1)
    load = np.tanh(0.6 * np.apply_along_axis(lambda x: np.convolve(x, np.ones(15) / 15, "same"), 1, load))
    health = np.tile(COMPRESSOR.coordinates.healthy, (B, N, 1))
    done = np.clip((t - 0.3 * N) / (0.35 * N), 0, 1)
    for b in range(B):
        i = (0, 2, 3, 4, 1)[b % 5]
        direction = 1 if i in (2, 4) else -1
        course = (t > 0.4 * N).astype(float) if i == 4 else done
        health[b, :, i] += direction * COMPRESSOR.span[i] * (0.5 + 0.5 * rng.random()) * course
    flow = 1.0 + 0.25 * load
    states = np.stack(
        [
            0.93 - 0.02 * load,
            3.3 + 0.9 * load,
            430 + 30 * load,
            355 + 8 * load,
            flow,
            430 + 30 * load,
            0.6 + 0 * load,
            375 + 0 * load,
        ],
        axis=-1,
    )
    outputs = np.stack([states[..., 1], states[..., 2] + health[..., 4], M_REF_KG_S * flow], axis=-1)
    inputs = np.stack([0.95 + 0 * load, 298 + 0 * load, 1350 + 300 * load, 0.6 + 0 * load], axis=-1)
    measured = np.concatenate([inputs, outputs], axis=-1)
    names = tuple(f"test-{b:02d}" for b in range(B))
    return Batch(names, t, measured, Truth(states, health, outputs, inputs))


def make_estimates(truth: Batch, estimator: str, seed: int, level: float, too_sure: float = 1.0) -> Estimates:
    """Slowly wandering errors of ``level`` times SCALE; intervals are right if ``too_sure`` is 1."""
    assert truth.truth is not None
    rng = np.random.default_rng([seed, *estimator.encode()])
    true = truth.truth.estimated
    B, N, n = true.shape
    error = rng.standard_normal((B, N, n))
    for k in range(1, N):
        error[:, k] = 0.97 * error[:, k - 1] + np.sqrt(1 - 0.97**2) * error[:, k]
    error *= level * SCALE * rng.uniform(0.7, 1.3, (B, 1, 1))
    half = 1.96 * level * SCALE / too_sure
    mean = true + error
    origins = np.arange(60, N - 60, 60)
    leads = np.array([1.0, 10.0, 60.0])
    clean = np.stack([truth.truth.outputs[:, origins + int(lead)] for lead in leads], axis=2)
    off = rng.standard_normal(clean.shape) * level * np.array([0.02, 1.0, 0.0008])
    cov = np.broadcast_to(np.diag((level * SCALE / too_sure) ** 2), (B, len(origins), n, n)).copy()
    return Estimates(
        estimator,
        seed,
        truth.names,
        truth.time_s,
        mean.astype(np.float32),
        (mean - half).astype(np.float32),
        (mean + half).astype(np.float32),
        (rng.chisquare(3, (B, N)) * too_sure).astype(np.float32),
        np.full((B, N), 3, np.int8),
        np.zeros((B, N), np.int16),
        truth.time_s[origins],
        leads,
        clean + off,
        mean[:, origins],
        cov,
        np.full(n, np.nan),
    )


def write_run(
    out: Path,
    levels: dict[str, float] | None = None,
    sequences: int = 10,
    seeds: tuple[int, ...] = (0,),
    failed: tuple[tuple[str, int, str, str], ...] = (),
    latency: bool = True,
    seconds: int = 600,
) -> Path:
    """Everything that a run leaves for the report, in ``out``; ``failed`` holds estimator, seed, stage, reason."""
    levels = LEVELS if levels is None else levels
    truth = make_truth(sequences, seconds)
    store, keys, scores = Store(out / "store"), [], []
    store.put("data", "d0", lambda path: save_split(Split(truth, truth, truth, truth), path))
    for estimator, level in levels.items():
        for seed in seeds:
            if any((estimator, seed) == row[:2] for row in failed):
                continue
            cell = make_estimates(truth, estimator, seed, level, too_sure=level**0.7)
            keys.append(f"{estimator}-{seed}")
            store.put("estimate", keys[-1], cell.save)
            scores.append(score(cell, truth).assign(estimator=estimator, seed=seed))
    columns = ["estimator", "seed", "sequence", "metric", "value"]
    table = pd.concat([*scores, _failed_scores(failed, truth)], ignore_index=True)[columns]
    table.to_csv(out / "scores.csv", index=False)
    pd.DataFrame(failed, columns=["estimator", "seed", "stage", "reason"]).to_csv(out / "failures.csv", index=False)
    rows = [
        f"{e},back_to_back,{kind},64,{40 * v * slow},{50 * v * slow},{80 * v * slow},{600 * v * slow},{100 * v}\n"
        for e, v in levels.items()
        for kind, slow in ((("compiled", 1), ("filterpy", 12)) if e.endswith("kf") else (("numba", 1),))
    ]
    (out / "latency.csv").write_text(LATENCY + ("".join(rows) if latency else ""))
    cost = [f"{e},{s},{stage},{v}\n" for e, v in levels.items() for s in seeds for stage in ("fit", "estimate")]
    (out / "cost.csv").write_text("".join(["estimator,seed,stage,cpu_s\n", *cost]))
    manifest = {
        "command": "twinbench run --profile quick",
        "profile": {"name": "quick"},
        "seeds": list(seeds),
        "data_key": "d0",
        "estimates_keys": keys,
        "commit": "0123abc",
        "uncommitted_changes": False,
        "python": "3.11.7",
        "versions": {"numpy": "2.4.6"},
        "machine": {"processor": "some <processor>", "cores": 2},
        "wall_s": {"data": 12.0, "fit": 150.4},
        "made": {
            e: {
                "command": f"twinbench run --only {'added' if e == 'oracle' else 'whole'}",
                "commit": "0123abc",
                "processor": "some",
            }
            for e in [*levels, *(f"deeponet_kalman:part_{i}" for i in range(22))]
        },
    }
    (out / "manifest.json").write_text(json.dumps(manifest))
    return out


def _failed_scores(failed: tuple[tuple[str, int, str, str], ...], truth: Batch) -> pd.DataFrame:
    from twinbench.bench.statistics.scores import DEFINITIONS

    rows = [(e, seed, s, m, np.nan) for e, seed, _, _ in failed for s in truth.names for m in DEFINITIONS]
    return pd.DataFrame(rows, columns=["estimator", "seed", "sequence", "metric", "value"])


assert len(SCALE) == len(ESTIMATED)
