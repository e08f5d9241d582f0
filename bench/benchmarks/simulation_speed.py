"""How fast the plant is simulated, against ``scipy.integrate.solve_ivp`` at the same accuracy.

    python -m twinbench.bench.benchmarks.simulation_speed --out results/benchmarks

Both hold inputs and health from one 20 Hz sample to the next. An error is the largest difference of a state from
the reference (DOP853 restarted at every sample, rtol 1e-11) over all samples, in the state's ``scale``. The peer is
called in two ways: once for a whole recording, as when all inputs are known beforehand, and once a sample, as online.
Its right-hand side is given twice: in plain Python, as scipy's users write it, and compiled by our machinery, input
look-up included, which leaves the integrator alone to compare. Each method has the loosest tolerance at which it is
as accurate as ours; only ours computes the sensors' readings too. Times are processor time of one thread, rounds
interleaved, the fastest of each.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from twinbench.common.threads import pin

pin()

import numpy as np  # noqa: E402  threads are pinned before NumPy is there
from numba import njit  # noqa: E402
from scipy.integrate import solve_ivp  # noqa: E402

from twinbench.common.store import write_text  # noqa: E402
from twinbench.common.versions import provenance  # noqa: E402
from twinbench.data.batch import Array  # noqa: E402
from twinbench.data.benchmark import design, simulate_benchmark  # noqa: E402
from twinbench.machines.compressor import HEALTH, SAMPLE_PERIOD_S  # noqa: E402
from twinbench.physics.compile import compiled  # noqa: E402
from twinbench.physics.compressor import PLANT, balance, flux  # noqa: E402
from twinbench.physics.integrate import Varying, simulate  # noqa: E402
from twinbench.physics.steady import steady_state  # noqa: E402

SEQUENCES = ("test-00", "test-02", "test-03", "test-06")  # capacity, heat transfer, bias, leakage
FIRST_SAMPLE = 12_600  # ten and a half minutes in: health changes soon
METHODS = ("RK23", "RK45", "DOP853", "Radau", "BDF", "LSODA")
TOLERANCES = tuple(float(10.0**-k) for k in np.arange(2.0, 9.5, 0.5))
SPEED_ROUNDS = 3
PYTHON_ROWS = 1500  # samples of each sequence, once, for the plain right-hand side: it is slow
SCALE = np.array([v.scale for v in PLANT.states])
Rhs = Callable[..., Array]


def held(rhs: Rhs) -> Rhs:
    """dx/dt (8,) with inputs u (N, 4) and health values (N, 5) held between samples; theta is scratch."""

    def function(t, x, u, values, theta):  # type: ignore[no-untyped-def]
        k = min(int(t * 20.0 + 1e-9), u.shape[0] - 1)
        theta[:5] = values[k]
        return rhs(np.ascontiguousarray(x), u[k], theta)

    return function


def _plain(x: Array, u: Array, theta: Array) -> Array:
    """The plant's equations as Python runs them."""
    f = flux.py_func(x, u, theta)
    return np.asarray(balance.py_func(x, u, theta, f))


COMPILED: Rhs = njit(error_model="numpy")(held(compiled(PLANT).rhs))
PYTHON: Rhs = held(_plain)


def whole_recording(rhs: Rhs, x0: Array, u: Array, values: Array, method: str, rtol: float) -> Array:
    """States (N, 8) at the samples from one call.

    Args:
        x0: (8,) state at the first sample, in the states' units.
        u: (N, 4) inputs in their units, order INPUTS.
        values: (N, 5) health in the parameters' units, order HEALTH.
    """
    t = np.arange(len(u)) * SAMPLE_PERIOD_S
    held_rows = (u, values, PLANT.theta())
    return solve_ivp(rhs, (0.0, t[-1]), x0, method, t, args=held_rows, rtol=rtol, atol=rtol * SCALE).y.T


def sample_by_sample(rhs: Rhs, x0: Array, u: Array, values: Array, method: str, rtol: float) -> Array:
    """States (N, 8) at the samples, a call for each, so that no step crosses a jump of what is held.

    Args:
        x0: (8,) state at the first sample, in the states' units.
        u: (N, 4) inputs in their units, order INPUTS.
        values: (N, 5) health in the parameters' units, order HEALTH.
    """
    x = np.empty((len(u), len(SCALE)))
    x[0] = x0
    for k in range(len(u) - 1):
        row = (u[k : k + 1], values[k : k + 1], PLANT.theta())
        one = solve_ivp(rhs, (0.0, SAMPLE_PERIOD_S), x[k], method, args=row, rtol=rtol, atol=rtol * SCALE)
        x[k + 1] = one.y[:, -1]
    return x


def cpu_s(run: Callable[[], Any]) -> float:
    """Processor time of one call."""
    start = time.process_time()
    run()
    return time.process_time() - start


def contest(peer: Callable[..., Array], samples: int) -> dict[str, Any]:
    """Ours against solve_ivp called as ``peer`` does, on so many samples of each sequence."""
    scenarios = [s for s in design()["test"] if s.name in SEQUENCES]
    window = slice(FIRST_SAMPLE, FIRST_SAMPLE + samples)
    u = np.stack([s.inputs()[window] for s in scenarios])
    values = np.stack([s.health()[window] for s in scenarios])
    x0 = np.stack([0.995 * steady_state(PLANT, row) for row in u[:, 0]])

    def theirs(call: Callable[..., Array], method: str, rtol: float, rhs: Rhs = COMPILED, rows: int = samples) -> Array:
        parts = zip(x0, u[:, :rows], values[:, :rows], strict=True)
        return np.stack([call(rhs, *part, method, rtol) for part in parts])

    ours = partial(simulate, PLANT, u, x0, varying=Varying(HEALTH, values))
    exact = theirs(sample_by_sample, "DOP853", 1e-11)
    wanted = float(np.abs((ours()[0] - exact) / SCALE).max())
    methods: list[dict[str, Any]] = []
    for method in METHODS:
        for rtol in TOLERANCES:
            error = float(np.abs((theirs(peer, method, rtol) - exact) / SCALE).max())
            if error <= wanted:
                methods.append({"method": method, "rtol": rtol, "error_scales": error})
                break
    for entry in methods:
        run = partial(theirs, peer, entry["method"], entry["rtol"])
        plain = partial(theirs, peer, entry["method"], entry["rtol"], PYTHON, PYTHON_ROWS)
        rounds = [(cpu_s(ours), cpu_s(run)) for _ in range(SPEED_ROUNDS)]
        fast, slow = np.min(rounds, axis=0) / len(x0) / samples
        slowest = cpu_s(plain) / len(x0) / min(samples, PYTHON_ROWS)
        entry |= {"ours_us": fast * 1e6, "compiled_us": slow * 1e6, "python_us": slowest * 1e6}
        entry |= {"ratio_compiled": slow / fast, "ratio_python": slowest / fast, "rounds_cpu_s": rounds}
    return {"samples": x0.shape[0] * samples, "ours_error_scales": wanted, "methods": methods}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"), metavar="DIR")
    out = parser.parse_args().out / "simulation_speed.json"
    found: dict[str, Any] = {
        "whole_recording": contest(whole_recording, 6_000),
        "sample_by_sample": contest(sample_by_sample, 500),
    }
    wall = time.perf_counter()
    found["full_benchmark"] = {"samples": 1_260_000, "cpu_s": cpu_s(simulate_benchmark)}
    found["full_benchmark"]["wall_s"] = time.perf_counter() - wall
    write_text(out, json.dumps(found | {"provenance": provenance()}, indent=2) + "\n")
    print(out.read_text())


if __name__ == "__main__":
    main()
