"""A benchmark small enough for tests: short recordings, and estimators of a dozen lines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import pytest

from helpers.tiny_profile import PROFILE
from twinbench.bench.cli.main import main

ESTIMATOR = """
import numpy as np
from twinbench.methods.estimator import Estimator, gaussian_state, no_info, register

@register
class Constant(Estimator):
    name, says = "{name}", "whatever the machines, their mean in training"
    settings = {{"scale": {scale}, "implementation": "quick"}}
    implementations = ("quick", "slow")
    window = 7

    def fit(self, train, validation, seed):
        truth = train.truth.estimated.reshape(-1, 10)
        self.arrays = {{"mean": self.config["scale"] * truth.mean(axis=0), "cov": np.cov(truth[::50].T)}}
        {fit}

    def init(self, batch):
        return gaussian_state(np.tile(self.arrays["mean"], (batch, 1)), self.arrays["cov"])

    def step(self, state, sample):
        if self.config["implementation"] == "slow":
            sum(range(20_000))
        {step}
        return gaussian_state(state.mean, self.arrays["cov"]), no_info(len(state.mean))
"""


def write_profile(folder: Path, updates: int = 0, more: str = "") -> Path:
    """The tiny profile, ``tiny.toml``."""
    path = folder / "tiny.toml"
    text = PROFILE.replace("n_test = 2", "n_test = 3").replace("updates = 0", f"updates = {updates}")
    path.write_text(text + more)
    return path


def write_estimator(folder: Path, name: str, scale: float = 1.0, fit: str = "", step: str = "") -> str:
    """A file-based estimator with lines of its own in fit and step; its path."""
    path = folder / f"{name}.py"
    path.write_text(ESTIMATOR.format(name=name, scale=scale, fit=fit, step=step))
    return str(path)


def run_here(patch: pytest.MonkeyPatch) -> None:
    """Runs keep to this process, as on a machine with one core, and draw no figures."""
    patch.setenv("LOKY_MAX_CPU_COUNT", "1")
    for drawn in ("write.draw", "other.draw_any"):
        patch.setattr(f"twinbench.bench.report.{drawn}", lambda *_: iter(()))


def twinbench(*arguments: object) -> int:
    """The command in this process, one cell at a time; the exit status."""
    return main([str(a) for a in arguments])


def parts(out: Path) -> dict[str, int]:
    """Every finished part of a store and when it was written."""
    return {str(p.relative_to(out)): p.stat().st_mtime_ns for p in out.glob("store/*/*/part.*")}


def run_arguments(profile: Path, out: Path, estimators: Sequence[str]) -> list[str]:
    """``twinbench run`` of the estimators."""
    return ["run", "--profile", str(profile), "--out", str(out), "--only", *estimators]


def comparable(out: Path) -> dict[str, bytes]:
    """What two runs of the same must agree on to the byte."""
    tables = [p for p in (out / "tables").iterdir() if p.stem not in ("cost", "comparison")]  # times differ
    files = [out / "scores.csv", out / "failures.csv", *tables]
    same = {str(path.relative_to(out)): path.read_bytes() for path in files}
    compared = pd.read_csv(out / "tables" / "comparison.csv")
    timeless = compared.drop(columns=[c for c in compared if c.startswith("train")])
    return same | {"tables/comparison.csv": timeless.to_csv().encode()}
