"""The Modelica Association's Reference FMUs, built from source: each is a simulator, or refused with the reason."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from helpers.small_fmu import needs_gcc
from helpers.tiny_run import twinbench
from scipy.integrate import solve_ivp

from twinbench.physics.fmu.as_simulator import simulator_of
from twinbench.physics.integrate import simulate

SOURCES = Path(__file__).parents[3] / "shared" / "fmu" / "reference-fmus"
pytestmark = [
    needs_gcc,
    pytest.mark.skipif(not SOURCES.is_dir(), reason=f"no Reference FMUs in {SOURCES}; clone modelica/Reference-FMUs"),
    pytest.mark.skipif(sys.platform != "linux", reason="builds them as on Linux"),
]
WHERE = {2: "linux64", 3: "x86_64-linux"}
REFUSED = {
    "BouncingBall": "jump at events",
    "Clocks": "is of type Clock",
    "Feedthrough": "no continuous states",
    "Resource": "no continuous states",
    "Stair": "no continuous states",
    "StateSpace": "is an array",
}


def built(model: str, version: int, folder: Path, but: str = "") -> Path:
    """The FMU, built in a folder; its description without one of its kinds."""
    inside = SOURCES / model
    library, file = folder / f"{model}.so", folder / f"{model}_{version}.fmu"
    code = [inside / "model.c", SOURCES / "src" / f"fmi{version}Functions.c", SOURCES / "src" / "cosimulation.c"]
    flags = ["-O2", "-shared", "-fPIC", f"-DFMI_VERSION={version}", "-DDISABLE_PREFIX", "-I", SOURCES / "include"]
    subprocess.run(["gcc", *flags, "-I", inside, "-o", library, *code, "-lm"], check=True)
    with zipfile.ZipFile(file, "w") as archive:
        text = (inside / f"FMI{version}.xml").read_text()
        if but:
            text, found = re.subn(rf"<{but}\b([^<]*?/>|.*?</{but}>)", "", text, flags=re.S)
            assert found == 1
        archive.writestr("modelDescription.xml", text)
        archive.write(library, f"binaries/{WHERE[version]}/{model}.so")
    return file


def offered() -> list[tuple[str, int]]:
    return [(p.parent.name, int(p.stem[3:])) for p in sorted(SOURCES.glob("*/FMI[23].xml"))]


TAKEN = {model for model, _ in offered()} - set(REFUSED)


def in_both_versions(models: Collection[str]) -> list[Any]:
    """Those models by both versions of the standard. The older one is slow."""
    return [pytest.param(*m, marks=[pytest.mark.slow] * (m[1] == 2)) for m in offered() if m[0] in models]


@pytest.mark.parametrize(("model", "version"), in_both_versions(REFUSED))
def test_what_cannot_be_examined_is_refused_with_the_reason(model: str, version: int, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=REFUSED[model]):
        simulator_of(built(model, version, tmp_path))


STEPPED = ("BouncingBall", "Dahlquist", "VanDerPol")
"""Their authors publish where each goes, step by step."""
EQUATIONS = {
    "Dahlquist": lambda x, k: -k * x,
    "VanDerPol": lambda x, mu: np.array([x[1], mu * (1.0 - x[0] ** 2) * x[1] - x[0]]),
    "Roberts": lambda x: np.array([
        -0.04 * x[0] + 1e4 * x[1] * (1.0 - x[0] - x[1]),
        0.04 * x[0] - 1e4 * x[1] * (1.0 - x[0] - x[1]) - 3e7 * x[1] ** 2,
    ]),
}  # fmt: skip


@pytest.mark.parametrize(("model", "version"), in_both_versions(TAKEN))
def test_trajectories_are_those_of_the_equations(model: str, version: int, tmp_path: Path) -> None:
    found = simulator_of(built(model, version, tmp_path))
    theta, start = found.theta(), np.array([s.nominal for s in found.states])
    time_s = np.linspace(0.0, 0.05 if model == "Roberts" else 5.0, 501)
    exact = solve_ivp(
        lambda _, x: EQUATIONS[model](x, *theta), time_s[[0, -1]], start, "LSODA", time_s, rtol=1e-10, atol=1e-12
    )
    x, _ = simulate(found, np.empty((1, time_s.size, 0)), start, dt_s=time_s[1], substeps=4)
    np.testing.assert_allclose(x[0], exact.y.T, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("model", "version"), in_both_versions(TAKEN))
def test_one_for_co_simulation_that_tells_its_rates_is_the_same_simulator(
    model: str, version: int, tmp_path: Path
) -> None:
    exchange = simulator_of(built(model, version, tmp_path))
    (tmp_path / "co").mkdir()
    co = simulator_of(built(model, version, tmp_path / "co", but="ModelExchange"))
    rng, theta = np.random.default_rng(0), exchange.theta()
    for _ in range(20):
        x = np.array([s.nominal + 0.3 * s.scale * rng.normal() for s in exchange.states])
        u = np.array([v.nominal for v in exchange.inputs])
        np.testing.assert_array_equal(co.rhs(x, u, theta), exchange.rhs(x, u, theta))  # type: ignore[misc]
        np.testing.assert_array_equal(co.output(x, u, theta), exchange.output(x, u, theta))


@pytest.mark.parametrize(("model", "version"), in_both_versions(STEPPED))
def test_one_that_can_only_be_stepped_goes_where_its_authors_say(model: str, version: int, tmp_path: Path) -> None:
    found = simulator_of(mute(built(model, version, tmp_path, but="ModelExchange")))
    assert found.rhs is None
    assert found.stepped is not None
    says = pd.read_csv(SOURCES / model / f"{model}_out.csv").to_numpy()
    seconds, start = np.diff(says[:, 0], append=says[-1, 0]), np.array([s.nominal for s in found.states])
    run = found.stepped(np.empty((len(says), 0)), seconds, start, found.theta())
    np.testing.assert_allclose(run[:, : len(found.outputs)], says[:, 1 : 1 + len(found.outputs)], rtol=1e-5, atol=1e-6)


def mute(file: Path) -> Path:
    """The FMU with nothing in its description of what a derivative is."""
    other = file.with_name("mute.fmu")
    with zipfile.ZipFile(file) as archive, zipfile.ZipFile(other, "w") as changed:
        for name in archive.namelist():
            content = archive.read(name)
            if name == "modelDescription.xml":
                text = re.sub(r' derivative="\d+"|<ContinuousStateDerivative [^>]*/>', "", content.decode())
                content = re.sub(r"<Derivatives>.*?</Derivatives>", "", text, flags=re.S).encode()
            changed.writestr(name, content)
    return other


def test_a_cubic_term_concealed_in_one_of_them_is_found(tmp_path: Path) -> None:
    file, cubic, rng = built("VanDerPol", 2, tmp_path), 0.1, np.random.default_rng(3)
    time_s, days = np.arange(0.0, 40.0, 0.05), []
    for k, start in enumerate([(0.1, 0.0), (3.0, 0.0), (-1.0, 2.5), (0.5, -3.0)]):
        truth = solve_ivp(
            lambda _, x: EQUATIONS["VanDerPol"](x, 1.0) - np.array([0.0, cubic * x[0] ** 3]),
            (0.0, 40.0), start, t_eval=time_s, rtol=1e-9, atol=1e-9,
        )  # fmt: skip
        read = truth.y + 0.01 * rng.standard_normal(truth.y.shape)
        days.append(tmp_path / f"day{k}.csv")
        pd.DataFrame({"time_s": time_s, "x0": read[0], "x1": read[1]}).to_csv(days[-1], index=False)
    status = twinbench("mismatch", file, *days[:3], "--hold-out", days[3], "--out", tmp_path / "found")
    (finding,) = json.loads((tmp_path / "found" / "verdict.json").read_text())["findings"]
    assert (status, finding["mechanism"]) == (10, "hardening_spring@x1")
    assert finding["parameters"]["hardening_spring_x1"]["value"] == pytest.approx(cubic, rel=0.05)


def test_all_of_them_are_here() -> None:
    assert {m for m, _ in offered()} == {*REFUSED, *EQUATIONS}
