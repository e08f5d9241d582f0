"""FMUs as simulators, against the same equations in Python; and what is refused."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.small_fmu import SmallFMU, needs_gcc
from numba import int64, njit

from twinbench.physics.check import check_simulator
from twinbench.physics.compile import compiled
from twinbench.physics.fmu import calls
from twinbench.physics.fmu.as_simulator import simulator_of

pytestmark = needs_gcc
SWING = SmallFMU(
    states={"angle": "speed", "speed": "(torque - b * speed - k * sin(angle)) / J"},
    inputs={"torque": 0.5},
    outputs={"encoder": "angle", "power": "torque * speed"},
    parameters={"J": 0.2, "b": 0.04, "k": 3.0},
    more={"angle": 'unit="rad" min="-9" max="9"', "J": 'unit="kg.m2" min="0.05"', "speed": 'unit="rad/s" nominal="4"'},
)


def rates(x: np.ndarray, u: np.ndarray, theta: np.ndarray) -> np.ndarray:
    J, b, k = theta
    return np.array([x[1], (u[0] - b * x[1] - k * np.sin(x[0])) / J])


@pytest.fixture(
    scope="module",
    params=[
        (2, "ModelExchange"),
        (3, "CoSimulation"),
        pytest.param((3, "ModelExchange"), marks=pytest.mark.slow),
        pytest.param((2, "CoSimulation"), marks=pytest.mark.slow),
    ],
    ids=str,
)
def file(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    version, kind = request.param
    return replace(SWING, exchange=kind).build(tmp_path_factory.mktemp("fmu"), version)


def points(count: int, seed: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    return [(3.0 * rng.normal(size=2), rng.normal(size=1), rng.uniform(0.1, 2.0, 3)) for _ in range(count)]


def test_rates_and_readings_are_those_of_the_equations(file: Path) -> None:
    swing = simulator_of(file)
    made = compiled(swing)
    for x, u, theta in points(50, 0):
        np.testing.assert_allclose(made.rhs(x, u, theta), rates(x, u, theta), rtol=1e-13)
        np.testing.assert_allclose(swing.rhs(x, u, theta), rates(x, u, theta), rtol=1e-13)
        np.testing.assert_allclose(made.output(x, u, theta), [x[0], u[0] * x[1]], rtol=1e-13)
    assert made.native
    check_simulator(swing)


def test_what_it_says_of_itself_is_kept(file: Path) -> None:
    swing = simulator_of(file)
    assert [v.name for v in swing.states] == ["angle", "speed"]
    assert [v.name for v in swing.parameters] == ["J", "b", "k"]
    angle, speed = swing.states
    assert (angle.unit, angle.low, angle.high, angle.nominal) == ("rad", -9.0, 9.0, 1.0)
    assert speed.scale == 4.0
    assert swing.parameters[0].low == 0.05
    assert swing.theta().tolist() == [0.2, 0.04, 3.0]


def test_threads_that_share_its_instances_get_what_one_alone_gets(file: Path) -> None:
    rhs = compiled(simulator_of(file)).rhs

    @njit(nogil=True)
    def many(f, x, u, theta, n):  # type: ignore[no-untyped-def]
        total = np.zeros(2)
        for i in range(n):
            x[0] += 1e-4
            theta[0] = 0.2 + 0.01 * (i % 3)
            total += f(x, u, theta)
        return total

    def run(point: tuple[np.ndarray, ...]) -> np.ndarray:
        return many(rhs, *(part.copy() for part in point), 2000)

    wanted = points(8, 1)
    alone = [run(point) for point in wanted]
    with ThreadPoolExecutor(4) as pool:
        np.testing.assert_array_equal(list(pool.map(run, wanted)), alone)


def test_a_recording_begins_where_the_readings_are_its_first(file: Path) -> None:
    swing = simulator_of(file)
    x = swing.initial(np.array([0.5]), np.array([0.3, 1.1]), swing.theta())
    np.testing.assert_allclose(x, [0.3, 2.2], rtol=1e-6)
    x = swing.initial(np.array([0.5]), np.array([0.3, np.nan]), swing.theta())
    np.testing.assert_allclose(x, [0.3, 1.0], rtol=1e-6)


def test_relations_hold_at_every_state_and_not_as_at_the_last_event(tmp_path: Path) -> None:
    braked = SmallFMU(
        states={"speed": "-(settled ? b : -b)"}, outputs={"read": "speed"}, parameters={"b": 0.5},
        relation="speed > 0", indicators=1,
    )  # fmt: skip
    for version in (2, 3):
        rhs = compiled(simulator_of(braked.build(tmp_path, version))).rhs
        found = [rhs(np.array([v]), np.empty(0), np.array([0.5]))[0] for v in (2.0, -2.0, 3.0)]
        assert found == [-0.5, 0.5, -0.5]


LONE = SmallFMU(states={"level": "-k * level"}, outputs={"read": "level"}, parameters={"k": 0.5})
MUTE = SmallFMU(**{**vars(LONE), "exchange": "CoSimulation", "tells": False})
REFUSED = {
    "no outputs that are real numbers": SmallFMU(states={}, inputs={"inflow": 0.2}, exchange="CoSimulation"),
    "what it does depends on time": SmallFMU(**{**vars(MUTE), "states": {"level": "-k * level + time"}}),
    "authoring tool": SmallFMU(**{**vars(LONE), "flags": 'needsExecutionTool="true"'}),
    "no continuous states": SmallFMU(states={}, outputs={"read": "2.0"}),
    "depend on time": SmallFMU(**{**vars(LONE), "states": {"level": "-k * level + time"}}),
    "its rates depend on time": SmallFMU(
        **{**vars(LONE), "states": {"level": "-k * level + time"}, "exchange": "CoSimulation"}
    ),
    "jump at events": SmallFMU(**{**vars(LONE), "jumps": "level < 0", "indicators": 1}),
    "timetable of events": SmallFMU(**{**vars(LONE), "timetable": 1}),
    "reports an error at its own start": SmallFMU(**{**vars(LONE), "status": "ERROR"}),
    "reports an error": SmallFMU(**{**vars(MUTE), "status": "ERROR"}),
}


@pytest.mark.parametrize("why", REFUSED)
@pytest.mark.parametrize("version", [2, 3])
def test_what_is_no_differential_equation_is_refused_in_a_line(why: str, version: int, tmp_path: Path) -> None:
    file = REFUSED[why].build(tmp_path, version)
    with pytest.raises(ValueError, match=why) as refused:
        simulator_of(file)
    assert str(refused.value).startswith(f"{file}: ")
    assert "\n" not in str(refused.value)


def rewritten(file: Path, old: str, new: str) -> Path:
    """The same FMU with another description."""
    other = file.with_name("other.fmu")
    with zipfile.ZipFile(file) as archive, zipfile.ZipFile(other, "w") as changed:
        for name in archive.namelist():
            content = archive.read(name)
            if name == "modelDescription.xml":
                assert old.encode() in content
                content = content.replace(old.encode(), new.encode())
            changed.writestr(name.replace("binaries/", "binaries/" if new != "elsewhere" else "binaries/not_"), content)
    return other


def test_what_calls_one_fmu_is_compiled_for_all(file: Path) -> None:
    compiled(simulator_of(file))
    assert {signature[0] for function in (calls.rates, calls.readings) for signature in function.signatures} == {int64}


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ('fmiVersion="2.0"', 'fmiVersion="1.0"', "is of FMI 1.0"),
        ('guid="{small}"', 'guid="{else}"', "makes no instance"),
        ("<Real unit", "<Integer unit", "must be a single real number"),
        ("<fmiModelDescription", "<", "is no XML"),
        ("<ModelExchange", "<CoSimulation", "makes no instance"),
        ('modelIdentifier="small"', 'modelIdentifier="large"', "has no binary for .*, but for"),
    ],
)
def test_a_description_that_does_not_fit_is_refused_in_a_line(tmp_path: Path, old: str, new: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        simulator_of(rewritten(SWING.build(tmp_path), old, new))


def test_a_file_that_is_no_fmu_is_refused_in_a_line(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no such file"):
        simulator_of(tmp_path / "none.fmu")
    (tmp_path / "text.fmu").write_text("text")
    with pytest.raises(ValueError, match="no zip archive"):
        simulator_of(tmp_path / "text.fmu")
    with zipfile.ZipFile(tmp_path / "empty.fmu", "w") as archive:
        archive.writestr("read.me", "nothing")
    with pytest.raises(ValueError, match=r"no modelDescription\.xml"):
        simulator_of(tmp_path / "empty.fmu")


def test_a_later_process_finds_the_machine_code(file: Path) -> None:
    code = (
        "import sys, numpy as np\n"
        "from twinbench.physics.compile import compiled\n"
        "from twinbench.physics.fmu.as_simulator import simulator_of\n"
        "made = compiled(simulator_of(sys.argv[1]))\n"
        "print(made.rhs(np.ones(2), np.ones(1), np.ones(3))[1], sum(made.rhs.stats.cache_hits.values()))\n"
    )
    unknown = rewritten(file, 'modelName="small"', 'modelName="unknown"')
    said = [
        subprocess.run(
            [sys.executable, "-c", code, str(unknown)], capture_output=True, text=True, check=True
        ).stdout.split()
        for _ in range(2)
    ]
    assert [float(value) for value, _ in said] == pytest.approx([-np.sin(1.0)] * 2)
    assert [int(hits) for _, hits in said] == [0, 1]
