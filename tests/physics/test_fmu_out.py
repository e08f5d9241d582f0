"""A simulator written as an FMU: what FMPy and we read back is the simulator, and what no FMU can hold is refused."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from helpers.host import Host, fmpy
from helpers.refusals import refused
from helpers.tiny_run import twinbench
from scipy.integrate import solve_ivp

from twinbench.mismatch.model import load_simulator
from twinbench.physics.compile import compiled
from twinbench.physics.compose import plain_rhs
from twinbench.physics.fmu.write import write_fmu
from twinbench.physics.integrate import simulate
from twinbench.physics.simulator import Array, Simulator, Variable

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="FMUs are written on Linux only"),
    pytest.mark.skipif(shutil.which("cc") is None, reason="FMUs are written with a C compiler; install gcc"),
]
EXAMPLES = Path(__file__).parents[2] / "examples"
MENDED = {
    "motor": ("hysteresis@omega_rad_s", {"J_kg_m2": 1.3, "hysteresis_omega_rad_s": 9.0}),
    "two_tanks": ("overflow@h1_cm", {"hole1_cm2": 0.45, "overflow_h1_cm": 0.02, "overflow_above_h1_cm": 19.0}),
}
"""By example: what it is mended with, and the values that were fitted."""
PERIOD_S, SAMPLES = 0.1, 150


class Written(NamedTuple):
    """A mended simulator and the FMU that the command made of it."""

    simulator: Simulator
    file: Path
    size: str
    values: dict[str, float]

    def names(self, group: str) -> list[str]:
        return [v.name for v in getattr(self.simulator, group)]


@pytest.fixture(scope="module", params=MENDED)
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Written:
    folder, (mechanism, values) = tmp_path_factory.mktemp(request.param), MENDED[request.param]
    shutil.copy(EXAMPLES / f"{request.param}.py", folder)
    listed = "\n".join(f"{name} = {value}" for name, value in values.items())
    spec, file = folder / "model.toml", folder / "mended.fmu"
    spec.write_text(
        f'base = "{request.param}.py"\n[[mechanisms]]\nname = "{mechanism}"\nfrom = "generic"\n[values]\n{listed}\n'
    )
    assert twinbench("fmu", spec, "--trust", "--out", file) == 0
    return Written(load_simulator(str(spec), trust=True), file, mechanism.replace("@", "_"), values)


def unit_of(variable: Variable) -> str:
    """As an FMU has it: nothing where there is no dimension."""
    return "" if variable.unit == "1" else variable.unit


def inputs(simulator: Simulator) -> Array:
    """(SAMPLES, nu) in the inputs' units: a new level every few seconds, from which an overflow begins and ends."""
    rng = np.random.default_rng(3)
    levels = [[v.nominal + v.scale * rng.normal() for v in simulator.inputs] for _ in range(SAMPLES // 15)]
    return np.repeat(np.array(levels), 15, axis=0)


def test_fmpy_finds_nothing_wrong_and_reads_what_was_fitted(written: Written) -> None:
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(written.file)) == []
    about = fmpy.read_model_description(str(written.file))
    read = {v.name: v for v in about.modelVariables}
    assert {name: float(read[name].start) for name in written.values} == written.values
    for variable in (*written.simulator.states, *written.simulator.inputs, *written.simulator.parameters):
        assert (read[variable.name].unit or "") == unit_of(variable)
    assert about.modelExchange is not None
    assert about.coSimulation is not None


def test_what_depends_on_what_is_told_as_the_equations_have_it(written: Written) -> None:
    about = fmpy.read_model_description(str(written.file))
    told = {u.variable.name: {v.name for v in u.dependencies} for u in (*about.outputs, *about.derivatives)}
    if written.simulator.name == "motor":
        force = "hysteresis_force_omega_rad_s"
        assert told["der(omega_rad_s)"] == {"current_A", "omega_rad_s", "load_Nm", force}
        assert told[f"der({force})"] == {"omega_rad_s", force}
        assert told["speed_rad_s"] == {"omega_rad_s"}
    else:
        assert told["der(h1_cm)"] == {"h1_cm", "pump_V"}
        assert told["der(h2_cm)"] == {"h1_cm", "h2_cm"}


def test_rates_and_readings_are_the_simulators_and_without_the_effect_the_examples(
    written: Written, tmp_path: Path
) -> None:
    simulator, plain = written.simulator, load_simulator(str(EXAMPLES / f"{written.simulator.name}.py"))
    equations, base, rng = compiled(simulator), plain_rhs(plain), np.random.default_rng(0)
    with Host(written.file, tmp_path, exchange=True) as host:
        for k in range(40):
            x, u, theta = (
                np.array([v.nominal + 0.3 * v.scale * rng.normal() for v in group])
                for group in (simulator.states, simulator.inputs, simulator.parameters)
            )
            if k % 2:
                theta[simulator.index(written.size)] = 0.0
            host.set(written.names("parameters") + written.names("inputs"), np.concatenate((theta, u)))
            dx = host.rates(x)
            np.testing.assert_array_equal(dx, equations.rhs(x, u, theta))
            np.testing.assert_array_equal(host.get(written.names("outputs")), equations.output(x, u, theta))
            if k % 2:
                n = len(plain.states)
                np.testing.assert_allclose(dx[:n], base(x[:n], u, theta[: len(plain.parameters)]), rtol=1e-13)


def test_in_model_exchange_another_integrator_follows_the_same_course(written: Written) -> None:
    simulator, end_s = written.simulator, PERIOD_S * SAMPLES
    names = written.names("outputs")
    found = fmpy.simulate_fmu(
        str(written.file), fmi_type="ModelExchange", stop_time=end_s, output_interval=PERIOD_S, output=names,
        relative_tolerance=1e-9,
    )  # fmt: skip
    u, theta = np.array([v.nominal for v in simulator.inputs]), simulator.theta()
    start = simulator.initial(u, np.array([v.nominal for v in simulator.outputs]), theta)
    exact = solve_ivp(
        lambda _, x: plain_rhs(simulator)(x, u, theta),
        (0.0, end_s),
        start,
        "LSODA",
        found["time"],
        rtol=1e-9,
        atol=1e-9,
    )
    assert np.ptp(exact.y, axis=1).max() > 0.1
    for k, name in enumerate(names):
        reading = [simulator.output(x, u, theta)[k] for x in exact.y.T]
        np.testing.assert_allclose(found[name], reading, rtol=1e-6)


def test_in_co_simulation_it_follows_the_course_of_our_own_integrator(written: Written, tmp_path: Path) -> None:
    simulator, u = written.simulator, inputs(written.simulator)
    names, rows = written.names("states") + written.names("outputs"), []
    with Host(written.file, tmp_path, exchange=False) as host:
        for k in range(SAMPLES):
            host.set(written.names("inputs"), u[k])
            rows.append(host.get(names))
            host.fmu.doStep(k * PERIOD_S, PERIOD_S)
    got = np.array(rows)
    x, y = simulate(simulator, u[None], got[0, : len(simulator.states)], dt_s=PERIOD_S, substeps=50)
    scale = np.array([v.scale for v in (*simulator.states, *simulator.outputs)])
    assert np.abs(got - np.concatenate((x[0], y[0]), axis=1)).max(axis=0) / scale == pytest.approx(0.0, abs=2e-6)


def test_it_comes_back_as_the_simulator_that_it_was(written: Written) -> None:
    again, simulator = load_simulator(str(written.file)), written.simulator
    with pytest.raises(ValueError, match="not ours to pass on"):
        write_fmu(again, written.file.with_name("again.fmu"))
    for group in ("states", "inputs", "outputs", "parameters"):
        for came, went in zip(getattr(again, group), getattr(simulator, group), strict=True):
            assert (came.name, came.low, came.high) == (went.name, went.low, went.high)
            assert came.unit == unit_of(went)
            assert came.scale == pytest.approx(went.scale)
    np.testing.assert_array_equal(again.theta(), simulator.theta())
    before, after, rng = compiled(simulator), compiled(again), np.random.default_rng(1)
    for _ in range(20):
        x, u = (np.array([v.nominal + v.scale * rng.normal() for v in g]) for g in (simulator.states, simulator.inputs))
        np.testing.assert_array_equal(after.rhs(x, u, again.theta()), before.rhs(x, u, simulator.theta()))


def test_the_binary_needs_the_c_library_and_no_python(written: Written, tmp_path: Path) -> None:
    shutil.unpack_archive(written.file, tmp_path, "zip")
    (library,) = tmp_path.glob("binaries/*/*.so")
    needed = subprocess.run(["readelf", "-d", library], capture_output=True, text=True, check=True).stdout
    needed = [line.partition("[")[2].rstrip("]") for line in needed.splitlines() if "(NEEDED)" in line]
    assert {name.partition(".so")[0] for name in needed} <= {"libm", "libc"}


VALVE = """
import numpy as np
from twinbench.physics.simulator import Simulator, Variable

SEEN = []


def rhs(x, u, theta):
    RHS


VALVE = Simulator(
    "valve",
    states=(Variable("p", "bar", 0.0, 9.0, 1.0), Variable("q", "bar", 0.0, 9.0, 2.0)),
    inputs=(),
    outputs=(Variable("p", "bar", 0.0, 9.0, 1.0),),
    parameters=(Variable("k", "", 0.0, 9.0, 3.0),),
    rhs=rhs,
    output=lambda x, u, theta: np.array([x[0]]),
    initial=lambda u, y, theta: np.array([y[0], 2.0]),
)
"""


def valve(folder: Path, rhs: str) -> str:
    file = folder / "valve.py"
    file.write_text(VALVE.replace("RHS", rhs))
    return str(file)


RAISES = """
    if x[1] <= 0.0:
        raise ValueError("no pressure to hold against")
    return [-theta[0] * x[0], x[0] / x[1]]"""
"""The result is a list, whose memory may grow."""


def test_an_exception_in_the_equations_is_an_error_in_the_host_which_goes_on(tmp_path: Path) -> None:
    file = tmp_path / "valve.fmu"
    assert twinbench("fmu", valve(tmp_path, RAISES), "--out", file) == 0
    with Host(file, tmp_path, exchange=True) as host:
        assert host.rates(np.array([1.0, 2.0])).tolist() == [-3.0, 0.5]
        with pytest.raises(Exception, match="fmi2GetDerivatives failed with status 3"):
            host.rates(np.array([1.0, 0.0]))
        assert host.rates(np.array([4.0, 2.0])).tolist() == [-12.0, 2.0]
        assert host.get(["state.p", "p", "q"]).tolist() == [4.0, 4.0, 2.0]  # a state and a reading have one name
        assert np.isnan(host.rates(np.array([np.nan, 2.0]))[0])
    with Host(file, tmp_path, exchange=False) as host:
        host.set(["q"], np.zeros(1))
        with pytest.raises(Exception, match="fmi2DoStep failed with status 3"):
            host.fmu.doStep(0.0, 1.0)


def test_what_no_fmu_can_hold_and_what_none_can_be_made_with_is_refused_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(EXAMPLES / "two_tanks.py", tmp_path)
    fault = '[[mechanisms]]\nname = "sensor_lag@level1_cm"\nfrom = "faults"\n'
    (tmp_path / "model.toml").write_text(f'base = "two_tanks.py"\n{fault}')
    monkeypatch.chdir(tmp_path)
    assert "holds sensor_lag@level1_cm" in refused(tmp_path, capsys, "fmu", "model.toml", "--out", "out.fmu")
    assert "call it out.fmu" in refused(tmp_path, capsys, "fmu", "two_tanks.py", "--out", "out.zip")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "install gcc or clang" in refused(tmp_path, capsys, "fmu", "two_tanks.py", "--out", "out.fmu")


@pytest.mark.parametrize(
    ("rhs", "says"),
    [("return np.eye(2) @ x", "numba_xxgemv"), ("SEEN.append(1)\n    return np.zeros(2)", "runs as plain Python")],
)
def test_equations_that_need_python_are_refused_in_a_line(
    rhs: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert says in refused(tmp_path, capsys, "fmu", valve(tmp_path, rhs), "--out", tmp_path / "valve.fmu")
