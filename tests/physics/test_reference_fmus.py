"""The Modelica Association's Reference FMUs, built from source: each is a simulator, or refused with the reason."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from helpers.small_fmu import needs_gcc
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
    "Clocks": "co-simulation only",
    "Feedthrough": "no continuous states",
    "Resource": "no continuous states",
    "Stair": "no continuous states",
    "StateSpace": "is an array",
}


def built(model: str, version: int, folder: Path) -> Path:
    inside = SOURCES / model
    library, file = folder / f"{model}.so", folder / f"{model}_{version}.fmu"
    code = [inside / "model.c", SOURCES / "src" / f"fmi{version}Functions.c", SOURCES / "src" / "cosimulation.c"]
    flags = ["-O2", "-shared", "-fPIC", f"-DFMI_VERSION={version}", "-DDISABLE_PREFIX", "-I", SOURCES / "include"]
    subprocess.run(["gcc", *flags, "-I", inside, "-o", library, *code, "-lm"], check=True)
    with zipfile.ZipFile(file, "w") as archive:
        archive.write(inside / f"FMI{version}.xml", "modelDescription.xml")
        archive.write(library, f"binaries/{WHERE[version]}/{model}.so")
    return file


def offered() -> list[tuple[str, int]]:
    return [(p.parent.name, int(p.stem[3:])) for p in sorted(SOURCES.glob("*/FMI[23].xml"))]


@pytest.mark.parametrize(("model", "version"), [m for m in offered() if m[0] in REFUSED])
def test_what_cannot_be_examined_is_refused_with_the_reason(model: str, version: int, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=REFUSED[model]):
        simulator_of(built(model, version, tmp_path))


EQUATIONS = {
    "Dahlquist": lambda x, k: -k * x,
    "VanDerPol": lambda x, mu: np.array([x[1], mu * (1.0 - x[0] ** 2) * x[1] - x[0]]),
    "Roberts": lambda x: np.array([
        -0.04 * x[0] + 1e4 * x[1] * (1.0 - x[0] - x[1]),
        0.04 * x[0] - 1e4 * x[1] * (1.0 - x[0] - x[1]) - 3e7 * x[1] ** 2,
    ]),
}  # fmt: skip


@pytest.mark.parametrize(("model", "version"), [m for m in offered() if m[0] not in REFUSED])
def test_trajectories_are_those_of_the_equations(model: str, version: int, tmp_path: Path) -> None:
    found = simulator_of(built(model, version, tmp_path))
    theta, start = found.theta(), np.array([s.nominal for s in found.states])
    time_s = np.linspace(0.0, 0.05 if model == "Roberts" else 5.0, 501)
    exact = solve_ivp(
        lambda _, x: EQUATIONS[model](x, *theta), time_s[[0, -1]], start, "LSODA", time_s, rtol=1e-10, atol=1e-12
    )
    x, _ = simulate(found, np.empty((1, time_s.size, 0)), start, dt_s=time_s[1], substeps=4)
    np.testing.assert_allclose(x[0], exact.y.T, rtol=1e-6, atol=1e-9)


def test_all_of_them_are_here() -> None:
    assert {m for m, _ in offered()} == {*REFUSED, *EQUATIONS}
