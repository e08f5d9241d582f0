"""Simulators and catalogues by name and from files: what is found, and the one line that refuses the rest."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.linked_tanks import LEAK, TANK, write

from twinbench.physics.compressor import PLANT
from twinbench.physics.load import builtin_catalogue, check_catalogue, load_catalogue, load_simulator
from twinbench.physics.mechanisms import CATALOGUE
from twinbench.physics.nominal import NOMINAL


def one_line(caught: pytest.ExceptionInfo[ValueError]) -> str:
    assert "\n" not in str(caught.value)
    return str(caught.value)


def refused(folder: Path, old: str, new: str) -> str:
    """What loading says of the tank with one thing in it changed."""
    assert old in TANK
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        load_simulator(write(folder, TANK.replace(old, new)))
    return one_line(caught)


def catalogue_refused(folder: Path, old: str, new: str) -> str:
    """What loading says of the leak with one thing in it changed."""
    assert old in LEAK
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        load_catalogue(write(folder, LEAK.replace(old, new), "leak.py"), load_simulator(write(folder, TANK)))
    return one_line(caught)


def test_by_name_and_from_a_package():
    assert load_simulator("compressor") is PLANT
    assert load_simulator("nominal") is NOMINAL
    assert load_simulator("twinbench.physics.compressor:PLANT") is PLANT


@pytest.mark.parametrize("spec", ["{}", "{}:TANK"])
def test_from_a_file(tmp_path, spec):
    simulator = load_simulator(spec.format(write(tmp_path, TANK)))
    assert simulator.rhs(np.array([1.0, 0.0]), np.array([2.0]), np.array([0.5])).tolist() == [1.5, 1.0]


def test_an_edit_counts_even_within_the_second_and_nothing_is_left_beside_the_file(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    for name in ("tank", "bowl"):
        spec = write(tmp_path, TANK.replace('"tank"', f'"{name}"'))
        os.utime(spec, (1e9, 1e9))
        assert load_simulator(spec).name == name
    assert [p.name for p in tmp_path.iterdir()] == [Path(spec).name]


def test_two_names_of_one_simulator_are_one(tmp_path):
    assert load_simulator(write(tmp_path, TANK + "\nSAME = TANK\n")).name == "tank"


def test_from_a_module_in_the_folder_of_the_call(tmp_path, monkeypatch):
    write(tmp_path, TANK, "plant_of_mine.py")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", ["/nowhere"])
    assert load_simulator("plant_of_mine:TANK").name == "tank"


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ("compresor", "did you mean 'compressor'?"),
        ("tank", "give path/to/file.py"),
        ("gone.py", "no file gone.py"),
        ("no_such_package:TANK", "fails to import: ModuleNotFoundError"),
        ("twinbench.physics.compressor:GONE", "has no Simulator 'GONE'; it has: PLANT"),
    ],
)
def test_a_spec_that_names_nothing(tmp_path, monkeypatch, spec, says):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="no") as caught:
        load_simulator(spec)
    assert says in one_line(caught)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("STATES = (", "STATES = undefined, (", "line 14: fails to import: NameError"),
        ("def output(", "def output((", "line 8: fails to import: SyntaxError"),
        ("STATES = (", "raise SystemExit\nSTATES = (", "fails to import: SystemExit"),
        ("TANK = Simulator(", "TANK = tuple, (", "holds no Simulator"),
        (
            "STATES = (",
            "from twinbench.physics.compressor import PLANT\nSTATES = (",
            "holds Simulators PLANT, TANK; name ",
        ),
    ],
)
def test_a_file_that_gives_no_simulator(tmp_path, old, new, says):
    assert says in refused(tmp_path, old, new)


def test_a_wrong_name_in_a_file(tmp_path):
    with pytest.raises(ValueError, match="has no Simulator 'TONK'; it has: TANK"):
        load_simulator(write(tmp_path, TANK) + ":TONK")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "x[0] - x[1]])",
            "x[0] - x[1], 0.0])",
            "rhs(x, u, theta) returns an array of shape (3,), must return 2 numbers (a, b)",
        ),
        ("np.array([x[1]])", "x[1]", "output(x, u, theta) returns one number, must return 1 numbers (h)"),
        ("y0[0], y0[0]", "y0[0]", "initial(u0, y0, theta) returns an array of shape (1,), must return 2 numbers"),
        ("return np.array([x[1]])", "pass", "output(x, u, theta) returns nothing"),
        ("np.array([x[1]])", "['high']", "returns list, must return numbers"),
        ("u[0] - theta", "u[1] - theta", "rhs(x, u, theta) fails in line 6: IndexError"),
        ("def rhs(x, u, theta)", "def rhs(x, u)", "rhs(x, u, theta) fails: TypeError"),
        ("x[0] - x[1]", "np.sqrt(-x[0])", "rhs(x, u, theta) returns nan for b at the nominal values"),
        ("np.array([x[1]])", "np.array([x[1] / (x[0] - 0.5)])", "output(x, u, theta) returns inf for h"),
        ("def output(x, u, theta):", "def output(x, u, theta):\n    x[0] = 0.0", "changes its arguments"),
        ('Variable("k", "', 'Variable("k", None and "', "unit of 'k' must be text"),
        ('Variable("flow"', 'Variable("h"', "'h' is the name of one of its inputs and of its outputs"),
        ('Variable("k"', 'Variable("a"', "'a' is the name of one of its states and of its parameters"),
        ('Variable("b"', 'Variable("a"', "states named twice: ['a']"),
        ("1.0, 0.05)", "0.01, 0.05)", "nominal 0.05 is outside [0.0, 0.01]"),
        ('"tank", STATES', '"tank", (1,)', "fails to import: AttributeError"),
        ('(Variable("h", "m", 0.0, 2.0, 0.5),)', "()", "has no outputs"),
    ],
)
def test_functions_that_do_not_fit(tmp_path, old, new, says):
    line = refused(tmp_path, old, new)
    assert says in line
    assert "tank.py" in line


def test_the_error_tells_the_line_of_the_file_and_not_of_a_library(tmp_path):
    assert "fails in line 6: " in refused(tmp_path, "u[0] - theta[0] * x[0]", "np.linalg.inv(x)")


@pytest.mark.parametrize("form", ["{}", "CATALOGUE = ({},)", "CATALOGUE = [{}]", "CATALOGUE = {}"])
def test_a_catalogue_from_a_file(tmp_path, form):
    tank = load_simulator(write(tmp_path, TANK))
    text = LEAK.replace("LEAK = ", "MINE = ") + form.format("MINE")
    (mechanism,) = load_catalogue(write(tmp_path, text, "leak.py"), tank)
    assert mechanism.name == "leak"
    (named,) = load_catalogue(str(tmp_path / "leak.py") + ":MINE", tank)
    assert named.name == "leak"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("balance:a", "balance:c", "mechanism 'leak': simulator 'tank' has no balance 'c'; it has: a, b"),
        ("balance:a", "flow", "port 'flow' must read balance:NAME, flux:NAME, output:NAME, input:NAME"),
        ("balance:a", "flux:a", "simulator 'tank' has no flux 'a'"),
        ("theta[-1] * x[0]", "theta[-1] * x[2]", "mechanism 'leak': term(x, u, theta) fails in line 5: IndexError"),
        ("theta[-1] * x[0]", "theta[-1] * x", "returns an array of shape (2,), must return one number"),
        ("theta[-1] * x[0]", 'float("nan")', "returns nan at the nominal values"),
        ("term=leak", "term=leak, states=(Variable('s', '1', 0, 1, 0),)", "states and derivative go together"),
        (
            "LEAK = Term(",
            "LEAK = Mechanism(",
            "line 7: fails to import: TypeError: mechanism 'leak': write Term(",
        ),
        ("LEAK = Term(", "LEAK = Amplitude(absent=(0.0,), ", "unexpected keyword argument 'term'"),
        ('c", "1/s", 0.0, 1.0, 0.1),), term=leak', 'c", "1/s", 0.0, 1.0, 0.1),), absent=(0.0,)', "argument: 'term'"),
        ("term=leak", "", "missing 1 required keyword-only argument: 'term'"),
        ("term=leak", "term=leak, series=leak", "unexpected keyword argument 'series'"),
        ('Variable("c"', 'Variable("k"', "its 'k' is also a name of simulator 'tank'; rename one"),
        (
            "LEAK = ",
            "TWIN = Term('leak', '', 'balance:b', (Variable('d', '', 0, 1, 0),), term=leak)\nLEAK = ",
            "mechanism 'leak': is there twice",
        ),
        (
            "LEAK = ",
            "TWIN = Term('twin', '', 'balance:b', (Variable('c', '', 0, 1, 0),), term=leak)\nLEAK = ",
            "its 'c' is also a name of mechanism 'twin'",
        ),
        ("LEAK = Term", "LEAK = dict", "holds no Mechanism"),
        ("import Amplitude", "import Amplitudes", "line 2: fails to import: ImportError"),
        ("term=leak", "term=leak, kind='magic'", "kind is 'magic', must be physics, sensor or input"),
    ],
)
def test_a_catalogue_that_does_not_fit(tmp_path, old, new, says):
    line = catalogue_refused(tmp_path, old, new)
    assert says in line
    assert "leak.py" in line


def test_a_fault_that_loses_samples(tmp_path):
    text = LEAK.replace("balance:a", "output:h").replace("LEAK = Term", "LEAK = Series")
    text = text.replace("term=leak", "series=lambda t, y, p: y[1:]")
    with pytest.raises(ValueError, match=r"returns an array of shape \(49,\), must return 50 numbers"):
        load_catalogue(write(tmp_path, text, "leak.py"), load_simulator(write(tmp_path, TANK)))


def test_an_amplitude_of_no_parameter_of_the_simulator(tmp_path):
    text = LEAK.replace("LEAK = Term", "LEAK = Amplitude").replace("term=leak", "absent=(0.0,)")
    with pytest.raises(ValueError, match=r"so its parameters are the simulator's; there is no 'c'; it has: k"):
        load_catalogue(write(tmp_path, text, "leak.py"), load_simulator(write(tmp_path, TANK)))


@pytest.mark.parametrize(("suffix", "says"), [(":GONE", "has no 'GONE'"), (":leak", "must be a tuple or list")])
def test_a_catalogue_by_a_wrong_name(tmp_path, suffix, says):
    with pytest.raises(ValueError, match=says):
        load_catalogue(write(tmp_path, LEAK, "leak.py") + suffix, load_simulator(write(tmp_path, TANK)))


def test_the_compressors_catalogue_is_for_machines_with_its_amplitudes(tmp_path):
    assert builtin_catalogue(NOMINAL) == CATALOGUE
    assert builtin_catalogue(load_simulator(write(tmp_path, TANK))) == ()
    check_catalogue(NOMINAL, CATALOGUE)
