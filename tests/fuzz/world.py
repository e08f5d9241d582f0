"""What the cases start from: a small trained run, and good recordings of a compressor and of a tank."""

from __future__ import annotations

import contextlib
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from fuzz.given import COMPRESSOR, TANK, TIME, Given
from fuzz.profiles import TRAINED
from twinbench.machines.compressor import SAMPLE_PERIOD_S

ESTIMATOR = "oracle"
"""Nothing to train, and it corrects itself by every reading."""
EXPORTED = "deeponet_kalman"
SECONDS = 60.0
"""Of the compressor's recording."""
RECORDED_S = 10.0
"""Of it, what a record is made of."""
TANK_SAMPLES, TANK_PERIOD_S = 160, 0.5
HOLE, GAIN = 0.05, 0.01
"""Of the tank: the simulator's own, so that simulator and recordings agree."""
SENSOR_NOISE_M = 0.002


@dataclass(frozen=True)
class World:
    """Files that the cases share and must not change; everything in ``folder``."""

    folder: Path
    compressor: pd.DataFrame
    tank: pd.DataFrame
    held_out: pd.DataFrame

    @property
    def run(self) -> Path:
        return self.folder / "run"

    @property
    def unused(self) -> Path:
        """The run as it was before the cases began, with what one estimate leaves in its store."""
        return self.folder / "unused"

    @property
    def profile(self) -> Path:
        return self.folder / "trained.toml"

    @property
    def online(self) -> Path:
        """The record of a run over a part of the compressor's recording."""
        return self.folder / "online.npz"

    def recording(self, machine: str) -> Given:
        if machine == "tank":
            return Given(TANK, self.tank.copy())
        return Given(COMPRESSOR, self.compressor.copy())


def build(folder: Path) -> World:
    """Train, simulate, and write; some half a minute."""
    from twinbench.bench.cli.main import main

    folder.mkdir(parents=True)
    profile, run = folder / "trained.toml", folder / "run"
    profile.write_text(TRAINED)
    with _quiet():
        failed = main(["run", "--profile", str(profile), "--out", str(run), "--only", ESTIMATOR])
        failed += main(["simulate", "--profile", str(profile), "--out", str(folder / "good"), "--no-truth"])
    if failed:
        raise RuntimeError(f"the run that the cases start from failed; see {folder}")
    _train(profile, run)
    compressor = _liveliest([pd.read_csv(path) for path in sorted((folder / "good").glob("*.csv"))])
    compressor.to_csv(folder / "day.csv", index=False)
    trained = ["--profile", str(profile), "--results", str(run), "--out", str(folder / "estimates")]
    with _quiet():
        main(["estimate", ESTIMATOR, str(folder / "day.csv"), *trained])
    shutil.copytree(run, folder / "unused")
    compressor[: round(RECORDED_S / SAMPLE_PERIOD_S)].to_csv(folder / "part.csv", index=False)
    with _quiet():
        recorded = [str(folder / name) for name in ("part.csv", "online.npz")]
        main(["record", ESTIMATOR, recorded[0], *trained[:4], "--out", recorded[1], "--every", "40"])
    return World(folder, compressor, tank_recording(1, TANK_SAMPLES), tank_recording(2, TANK_SAMPLES // 2))


def _liveliest(tables: list[pd.DataFrame]) -> pd.DataFrame:
    """The SECONDS in which the speed moves most: at a steady load a shuffled column is none."""
    samples = round(SECONDS / SAMPLE_PERIOD_S)
    windows = [t.iloc[k : k + samples] for t in tables for k in range(0, len(t) - samples + 1, samples // 6)]
    return max(windows, key=lambda window: window["N_rpm"].std()).reset_index(drop=True)


def _train(profile: Path, run: Path) -> None:
    """What export writes; nothing is estimated with it."""
    from twinbench.bench import cells
    from twinbench.bench.profile import load_profile
    from twinbench.common.store import Store

    whole = load_profile(str(profile))
    outcome = cells.fit(Store(run / "store"), whole, cells.make_cell(EXPORTED, whole.seeds[0], whole))
    if outcome.reason:
        raise RuntimeError(f"{EXPORTED} could not be trained: {outcome.reason}")


def tank_recording(seed: int, samples: int) -> pd.DataFrame:
    """A tank that a pump fills in steps and that drains by Torricelli, its level read with noise."""
    rng = np.random.default_rng(seed)
    pump = np.repeat(rng.uniform(1.0, 6.0, samples // 20 + 1), 20)[:samples]
    level, levels, parts = 0.5, np.empty(samples), 20
    for k in range(samples):
        levels[k] = level
        for _ in range(parts):
            level += TANK_PERIOD_S / parts * (GAIN * pump[k] - HOLE * np.sqrt(max(level, 0.0)))
    time_s = TANK_PERIOD_S * np.arange(samples)
    return pd.DataFrame({TIME: time_s, "pump_V": pump, "h_m": levels + SENSOR_NOISE_M * rng.standard_normal(samples)})


@contextlib.contextmanager
def _quiet():  # type: ignore[no-untyped-def]
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere), contextlib.redirect_stderr(nowhere):
        yield
