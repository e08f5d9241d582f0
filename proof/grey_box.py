"""What a form allows on the Cascaded Tanks: ``python -m twinbench.proof.grey_box --recordings FOLDER``.

Somebody who knows what tanks do writes the forms by hand, and scipy fits them to the recording to learn from. Nothing
of the mismatch engine takes part. So the errors on the recording held out bound from outside what a name could bring.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numba import njit
from rich.console import Console
from scipy.optimize import least_squares

from twinbench.common.errors import BadInput
from twinbench.common.progress import Progress
from twinbench.common.store import check_writable, write_text
from twinbench.common.versions import write_manifest
from twinbench.data.batch import Array
from twinbench.proof.command import refusing

ROOT = Path(__file__).resolve().parents[1]
EULER_STEPS = 8
"""Steps between two samples of 4 s. Sixteen change no error by more than a millivolt."""
SETTLING_S = 200.0
"""By the benchmark's rules the samples before this do not count."""
PARAMETERS = {
    "k1": (0.05, 0.005, 0.5),
    "k2": (0.05, 0.005, 0.5),
    "k3": (0.05, 0.005, 0.5),
    "k4": (0.05, 0.005, 0.5),
    "rim2_V": (100.0, 3.0, 100.0),
    "rim1_V": (100.0, 3.0, 100.0),
    "spill": (0.0, 0.0, 5.0),
    "power2": (0.5, 0.05, 1.5),
    "linear1": (0.0, -0.1, 0.1),
    "linear2": (0.0, -0.1, 0.1),
}
"""Value where a form leaves it alone, and bounds. Rims are out of reach until a tank may overflow."""
TEXTBOOK = ("k1", "k2", "k3", "k4")
LOWER = (*TEXTBOOK, "rim2_V")
BOTH = (*LOWER, "rim1_V", "spill")
FORMS = {
    "as the textbook": TEXTBOOK,
    "both drains have a linear part": (*TEXTBOOK, "linear1", "linear2"),
    "the lower tank overflows": LOWER,
    "both overflow, a part falls into the lower": BOTH,
    "both overflow, and the lower drains by another power": (*BOTH, "power2"),
    "both overflow, and both drains have a linear part": (*BOTH, "linear1", "linear2"),
}
"""What each grey box may fit."""


@njit(cache=True, error_model="numpy")
def levels(values, start, u, period_s, finer):  # type: ignore[no-untyped-def]
    """(N,) level of the lower tank, V: explicit Euler steps, held input, a level stops at the rim.

    Args:
        values: (10,) in the order of PARAMETERS.
        start: (2,) levels at the beginning, V.
        u: (N,) voltage of the pump, V.
    """
    k1, k2, k3, k4, rim2, rim1, spill, power2, linear1, linear2 = values
    upper, lower = start
    h = period_s / finer
    read = np.empty(u.size)
    for k in range(u.size):
        read[k] = lower
        for _ in range(finer):
            a, b = max(upper, 0.0), max(lower, 0.0)
            new = upper + h * (k4 * u[k] - k1 * a**0.5 - linear1 * a)
            over = max(new - rim1, 0.0)
            lower = min(lower + h * (k2 * a**0.5 - k3 * b**power2 - linear2 * b) + spill * over, rim2)
            upper = new - over
    return read


def fitted(form: Sequence[str], learnt: pd.DataFrame, held: pd.DataFrame, starts: int, seed: int) -> dict[str, Any]:
    """Errors of the best of many fits, V, and its parameters. Of the recording held out only the start is fitted.

    Args:
        form: names of PARAMETERS that are fitted.
        learnt: the recording that is fitted, columns time_s, u_V, level2_V.
        held: the recording that is held out, the same columns.
        starts: fits from random values, of which the best on ``learnt`` counts.
    """
    rng = np.random.default_rng(seed)
    middle, low, high = (np.array(each) for each in zip(*PARAMETERS.values(), strict=True))
    free = np.array([list(PARAMETERS).index(name) for name in form])
    bounds = (np.r_[low[free], 0.0, 0.0], np.r_[high[free], 15.0, 15.0])
    best = None
    for _ in range(starts):
        begin = middle.copy()
        begin[:4] *= np.exp(0.6 * rng.standard_normal(4))
        begin[4:6] = learnt["level2_V"].max(), rng.uniform(4.0, 14.0)
        begin[6:8] = rng.uniform(0.0, 1.0), rng.uniform(0.3, 0.8)
        x0 = np.r_[begin[free], rng.uniform(2.0, 9.0), learnt["level2_V"].iloc[0]]
        found = least_squares(
            lambda x: _off(_whole(middle, free, x[:-2]), x[-2:], learnt),
            np.clip(x0, *bounds),
            bounds=bounds,
            x_scale=np.r_[np.maximum(np.abs(begin[free]), 0.01), 3.0, 3.0],
            max_nfev=300,
        )
        best = found if best is None or found.cost < best.cost else best
    assert best is not None
    values = _whole(middle, free, best.x[:-2])
    held_start = [5.0, held["level2_V"].iloc[0]]
    start = least_squares(lambda x: _off(values, x, held), held_start, bounds=([0.0, 0.0], [15.0, 15.0])).x
    off = _off(values, start, held)
    return {
        "learnt_V": _rms(_off(values, best.x[-2:], learnt)),
        "held_out_V": _rms(off),
        "held_out_from_200_s_V": _rms(off[(held["time_s"] - held["time_s"].iloc[0]).to_numpy() >= SETTLING_S]),
        **{name: float(values[list(PARAMETERS).index(name)]) if name in form else np.nan for name in PARAMETERS},
    }


def _whole(middle: Array, free: np.ndarray, chosen: Array) -> Array:
    values = middle.copy()
    values[free] = chosen
    return values


def _off(values: Array, start: Array, recording: pd.DataFrame) -> Array:
    """(N,) V: simulated less measured; far off where the simulation has no number."""
    u, read = (recording[name].to_numpy(dtype=np.float64) for name in ("u_V", "level2_V"))
    period_s = float(recording["time_s"].diff().median())
    off = levels(values, (float(start[0]), float(start[1])), u, period_s, EULER_STEPS) - read
    return np.where(np.isfinite(off), off, 1e3)


def _rms(off: Array) -> float:
    return float(np.sqrt(np.mean(off**2)))


@refusing("twinbench.proof.grey_box")
def main(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m twinbench.proof.grey_box", description=__doc__)
    parser.add_argument("--recordings", type=Path, required=True, help="folder with cascaded_tanks/{train,test}.csv")
    parser.add_argument("--starts", type=int, default=30, help="fits from random values for each form")
    parser.add_argument("--seed", type=int, default=0, help="of these values")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "grey_box", help="for the table")
    asked = parser.parse_args(arguments)
    out = asked.out.absolute()
    if asked.starts < 1:
        raise BadInput(f"--starts is {asked.starts}, must be at least 1")
    check_writable(out)
    learnt, held = (_read(asked.recordings / "cascaded_tanks" / f"{name}.csv") for name in ("train", "test"))
    rows = []
    with Progress(Console(stderr=True)) as progress, progress.stage("forms", len(FORMS)) as going:
        for says, form in FORMS.items():
            rows.append({"form": says, **fitted(form, learnt, held, asked.starts, asked.seed)})
            going.step()
    table = pd.DataFrame(rows).round(4)
    write_text(out / "grey_box.csv", table.to_csv(index=False))
    command = f"python -m twinbench.proof.grey_box --recordings FOLDER --starts {asked.starts} --seed {asked.seed}"
    write_manifest(out, command, asked.seed)
    print(table.iloc[:, :4].to_string(index=False))
    return 0


def _read(path: Path) -> pd.DataFrame:
    try:
        table = pd.read_csv(path)
    except OSError:
        raise BadInput(f"{path}: no such recording; docs/real_recordings.md says what FOLDER must hold") from None
    lacks = [name for name in ("time_s", "u_V", "level2_V") if name not in table]
    if lacks:
        raise BadInput(f"{path}: lacks the column {lacks[0]}")
    return table


if __name__ == "__main__":
    sys.exit(main())
