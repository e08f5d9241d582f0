"""Ten million updates of DeepONet-Kalman in place, with random sensor faults: does it stay sound, and as small?

    python -m twinbench.bench.benchmarks.soak --profile paper --results results/paper_time

The test recordings go round and round. At random, channels are lost, stuck, off by up to a thousand training spreads,
drifting, spiking, or read zero, several at once, for a tick up to a minute. After every single update the filter's
covariance must have a Cholesky factor and everything must be finite.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from pathlib import Path
from typing import Any

from twinbench.common.threads import pin

pin()

import numpy as np  # noqa: E402  threads are pinned before NumPy is there
from numba import njit  # noqa: E402

from twinbench.bench.cells import load_fit, load_split  # noqa: E402
from twinbench.bench.estimate.apply import Training, trained_cells  # noqa: E402
from twinbench.bench.roster import PROPOSED  # noqa: E402
from twinbench.common.progress import Progress  # noqa: E402
from twinbench.common.store import write_text  # noqa: E402
from twinbench.common.versions import provenance  # noqa: E402
from twinbench.data.batch import Array  # noqa: E402
from twinbench.methods.deeponet_kalman.cycle import said_type, scratch, update  # noqa: E402
from twinbench.methods.deeponet_kalman.method import DeepONetKalman  # noqa: E402

BLOCK_UPDATES = 10_000
FAULTS_PER_BLOCK = 40
LONGEST_FAULT = 1200
KINDS = ("lost", "stuck", "off", "drift", "spikes", "zero")
EIGENVALUE_ROUND_OFF = 1e-9
"""What may be missing to a positive definite correlation matrix."""


@njit(cache=True, error_model="numpy")
def _sound(P, C):  # type: ignore[no-untyped-def]
    """Is P (n, n) finite, with a Cholesky factor once scaled to unit diagonal? ``C`` (n, n) is scratch."""
    n = P.shape[0]
    for i in range(n):
        if not P[i, i] > 0.0:
            return False
        for j in range(i + 1):
            s = P[i, j] / np.sqrt(P[i, i] * P[j, j]) + (EIGENVALUE_ROUND_OFF if i == j else 0.0)
            for k in range(j):
                s -= C[i, k] * C[j, k]
            if not np.isfinite(s) or (i == j and s <= 0.0):
                return False
            C[i, j] = np.sqrt(s) if i == j else s / C[j, j]
    return True


@njit(cache=True, error_model="numpy")
def soak(weights, twin, memory, said, t, readings, lag_s, C):  # type: ignore[no-untyped-def]
    """Update by each of readings (N, 7). Returns how many updates left anything unsound.

    The function takes plain arrays because it is compiled.
    """
    unsound = 0
    for k in range(readings.shape[0]):
        update(weights, twin, memory, readings[k : k + 1], lag_s[k : k + 1], said, t)
        sound = _sound(memory[0].P, C)
        for i in range(said[0].mean.size):
            sound = sound and np.isfinite(said[0].mean[i]) and said[0].low[i] <= said[0].high[i]
        unsound += 0 if sound else 1
    return unsound


def faulty(readings: Array, spread: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Readings (N, 7) with random faults in them, and how late (N, 7) in seconds they come.

    Args:
        readings: (N, 7) in the channels' units, order CHANNELS.
        spread: (7,) of the channels, in their units.
        rng: what the faults are drawn from.
    """
    out, lag_s = readings.copy(), np.zeros(readings.shape)
    for _ in range(FAULTS_PER_BLOCK):
        begin, c = rng.integers(len(out)), rng.integers(out.shape[1])
        rows = slice(begin, begin + int(np.exp(rng.uniform(0.0, np.log(LONGEST_FAULT)))))
        values, kind = out[rows, c], KINDS[rng.integers(len(KINDS))]
        size = spread[c] * 10.0 ** rng.uniform(-2.0, 3.0) * rng.choice([-1.0, 1.0])
        if kind == "lost":
            values[:] = np.nan
        elif kind == "stuck":
            values[:] = values[0]
        elif kind == "off":
            values += size
        elif kind == "drift":
            values += size * np.linspace(0.0, 1.0, len(values))
        elif kind == "spikes":
            values[rng.random(len(values)) < 0.2] += size
        else:
            values[:] = 0.0
    late = rng.integers(len(out), size=5)
    for begin in late:
        lag_s[begin : begin + 200, 4:] = rng.uniform(0.0, 0.1, 3)
    return out, lag_s


def run(twin: DeepONetKalman, recordings: Array, updates: int, seed: int) -> dict[str, Any]:
    """Soak a twin in recordings (B, N, 7), and say how it was.

    Args:
        recordings: (B, N, 7) readings in the channels' units, order CHANNELS.
    """
    rng = np.random.default_rng(seed)
    spread = np.nanstd(recordings.reshape(-1, recordings.shape[-1]), axis=0)
    memory, said, room = (
        twin.init(1).memory[0].copy(),
        np.zeros(1, said_type(twin.parts)),
        scratch(twin.weights, twin.parts),
    )
    C, unsound, least, resident, took = np.zeros((19, 19)), 0, np.inf, [], 0.0
    blocks = [
        b
        for recording in recordings
        for b in np.split(recording, range(BLOCK_UPDATES, recording.shape[0], BLOCK_UPDATES))
    ]
    done = 0
    with Progress() as progress, progress.stage("soak", updates) as going:
        for block in itertools.cycle(blocks):
            readings, lag_s = faulty(block[: updates - done], spread, rng)
            begun = time.perf_counter()
            unsound += soak(twin.weights, twin.twin, memory, said, room, readings, lag_s, C)
            took += time.perf_counter() - begun
            done += len(readings)
            least = float(np.minimum(least, _least_eigenvalue(memory["P"][0])))
            resident.append(_resident_MB())
            going.step(len(readings))
            if done == updates:
                break
    settled = resident[len(resident) // 10 :]
    return {
        "updates": done,
        "seed": seed,
        "unsound_updates": unsound,
        "least_eigenvalue_of_correlation": least,
        "resident_MB_after_a_tenth": settled[0],
        "resident_MB_at_the_end": settled[-1],
        "drift_MB": round(settled[-1] - settled[0], 2),
        "seconds": round(took, 1),
    }


def _least_eigenvalue(P: Array) -> float:
    """Of the correlation matrix; NaN if P is no covariance."""
    variance = np.diagonal(P)
    if not (np.isfinite(P).all() and (variance > 0.0).all()):
        return np.nan
    return float(np.linalg.eigvalsh(P / np.sqrt(np.outer(variance, variance)))[0])


def _resident_MB() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return round(pages * 4096 / 1e6, 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--profile", default="quick")
    parser.add_argument("--results", type=Path, metavar="DIR")
    parser.add_argument("--updates", type=int, default=10_000_000, metavar="N")
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"), metavar="DIR")
    a = parser.parse_args()
    store, (cell,) = trained_cells(Training(a.profile, a.results), [PROPOSED])
    twin = load_fit(store, cell)
    assert isinstance(twin, DeepONetKalman)
    found = run(twin, load_split(store, cell).test.measured, a.updates, seed=5)
    write_text(a.out / "soak.json", json.dumps(found | {"provenance": provenance()}, indent=2) + "\n")
    print((a.out / "soak.json").read_text())


if __name__ == "__main__":
    main()
