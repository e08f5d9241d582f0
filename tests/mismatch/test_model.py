"""``model.toml``: what is written is read back as the same machine, and what is no model is refused in one line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tank_files import SPILL, TANK, write_python

from twinbench.common.errors import BadInput
from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.faults import faults
from twinbench.mismatch.model import load_catalogue, load_model, load_simulator, model_toml, whole_catalogue
from twinbench.physics.compose import plain_rhs
from twinbench.physics.load import check_catalogue
from twinbench.physics.nominal import NOMINAL
from twinbench.physics.simulator import Simulator


@pytest.fixture
def spec(tmp_path: Path) -> str:
    return write_python(tmp_path, TANK)


def rate(simulator, level: float, pump: float = 0.0) -> float:
    x = np.array([level] + [0.0] * (len(simulator.states) - 1))
    return float(plain_rhs(simulator)(x, np.array([pump]), simulator.theta())[0])


def mended(folder: Path, spec: str, name: str = "model.toml") -> Path:
    """The tank with a spill of the user's, the first of the generic effects, and a sensor that is off."""
    tank = load_simulator(spec)
    catalogue = write_python(folder, SPILL, "spill.py")
    (spill,) = load_catalogue(catalogue, tank)
    (bias,) = [m for m in faults(tank) if m.name == "sensor_bias@h_m"]
    first = generic(tank)[0]
    values = {"k": 0.08, "spill_1_s": 0.5, "rim_m": 0.7, bias.parameters[0].name: 0.03, first.parameters[0].name: 1e-3}
    path = folder / name
    path.write_text(model_toml(spec, tank, [spill, first, bias], values, folder, catalogue))
    return path


def test_a_mended_simulator_comes_back(tmp_path, spec):
    path = mended(tmp_path, spec)
    model = load_model(str(path))
    simulator, tank = model.simulator, load_simulator(spec)
    values = {v.name: v.nominal for v in simulator.parameters}
    assert (values["k"], values["spill_1_s"], values["rim_m"], values["g"]) == (0.08, 0.5, 0.7, 0.01)
    assert simulator.mechanisms[0] == "spill"
    base = load_simulator(spec).with_values(k=0.08)
    offset = rate(simulator, 0.5) - rate(base, 0.5)
    assert offset == pytest.approx(rate(simulator, 0.69) - rate(base, 0.69)), "the spill begins at its rim"
    assert rate(simulator, 0.9) - rate(base, 0.9) == pytest.approx(offset - 0.5 * 0.2)
    (bias,) = model.faults
    assert bias.parameters[0].nominal == 0.03
    assert len(tank.parameters) == 2, "the base stays as it was"
    text = path.read_text()
    assert "k = 0.08  # m**0.5/s" in text
    assert str(tmp_path) not in text, "paths are relative"


def test_it_moves_with_its_base(tmp_path, spec, monkeypatch):
    mended(tmp_path, spec)
    moved = tmp_path.rename(tmp_path.with_name("moved"))
    monkeypatch.chdir(moved.parent)
    assert load_simulator("moved/model.toml").mechanisms[0] == "spill"


def test_a_mended_simulator_can_be_mended_again(tmp_path, spec, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = mended(tmp_path, spec)
    (tmp_path / "again").mkdir()
    again = tmp_path / "again" / "model.toml"
    simulator = load_simulator(str(first))
    again.write_text(model_toml(str(first), simulator, [], {"rim_m": 0.8}, again.parent))
    model = load_model(str(again))
    assert model.simulator.theta()[model.simulator.index("rim_m")] == 0.8
    assert len(model.faults) == 1


def test_what_a_mended_simulator_has_is_not_missing_from_it(tmp_path, spec):
    path, tank = mended(tmp_path, spec), load_simulator(spec)
    simulator = load_simulator(str(path))
    own = load_catalogue(str(tmp_path / "spill.py"), simulator)
    whole = whole_catalogue(simulator, own)
    check_catalogue(simulator, whole)
    found = generic(tank)[0].name
    assert {"spill", found}.isdisjoint(m.name for m in whole)
    assert found in {m.name for m in whole_catalogue(tank)}


def test_amplitudes_inside_the_equations_are_values(tmp_path):
    from twinbench.physics.mechanisms import CATALOGUE

    (leak,) = [m for m in CATALOGUE if m.name == "external_leak"]
    path = tmp_path / "model.toml"
    path.write_text(model_toml("nominal", NOMINAL, [leak], {"A_ext_mm2": 3.5, "capacity": 0.97}, tmp_path))
    simulator = load_simulator(str(path))
    assert simulator.theta()[simulator.index("A_ext_mm2")] == 3.5
    assert simulator.theta()[simulator.index("capacity")] == 0.97
    assert simulator.mechanisms == ("external_leak",)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"nothing": 1.0}, "neither the simulator nor a mechanism has that parameter"),
        ({"k": float("nan")}, "must be a finite number"),
    ],
)
def test_no_model_is_written_that_could_not_be_read(tmp_path, spec, values, says):
    with pytest.raises(ValueError, match=says):
        model_toml(spec, load_simulator(spec), [], values, tmp_path)


def test_a_mechanism_of_nowhere_is_not_written(tmp_path, spec):
    tank = load_simulator(spec)
    own = load_catalogue(write_python(tmp_path, SPILL, "spill.py"), tank)
    with pytest.raises(ValueError, match="mechanism 'spill' is in no catalogue"):
        model_toml(spec, tank, own, {}, tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("base = ", "bases = ", "is no model; it must hold base"),
        ("base = ", "base ", "not TOML"),
        ('"tank.py"', '"gone.py"', "no file"),
        ('"tank.py"', '"model.toml"', "is its own base"),
        ('name = "spill"', 'name = "spell"', "spill.py has no mechanism 'spell'; it has: spill"),
        ('name = "spill"', "name = 1", "must hold two texts, name and from"),
        ("k = 0.08", "k = true", "[values] must hold numbers only"),
        ("k = 0.08", "k = nan", "[values] must hold numbers only"),
        ("k = 0.08", "kk = 0.08", "[values] has 'kk', which is no parameter of this model"),
    ],
)
def test_a_broken_model_is_one_line(tmp_path, spec, old, new, says):
    path = mended(tmp_path, spec)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(BadInput) as caught:
        load_model(str(path))
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_base_that_no_longer_has_what_the_model_sets(tmp_path, spec):
    path = mended(tmp_path, spec)
    write_python(tmp_path, TANK.replace('"level_m"', '"depth_m"'))
    with pytest.raises(BadInput, match="simulator 'tank' has no balance 'level_m'; it has: depth_m"):
        load_model(str(path))


@pytest.mark.parametrize("what", ["name", "parameter"])
def test_a_mechanism_of_yours_must_not_have_a_name_of_ours(tmp_path, spec, what):
    tank = load_simulator(spec)
    ours = generic(tank)[0]
    old, new = ("spill", ours.name) if what == "name" else ("rim_m", ours.parameters[0].name)
    path = write_python(tmp_path, SPILL.replace(f'"{old}"', f'"{new}"'), "spill.py")
    with pytest.raises(BadInput, match=f"our own catalogue has a '{new}' too; rename yours"):
        load_catalogue(path, tank)


WIDE = TANK.replace('"pump_V", "V", 0.0, 10.0, 3.0', '"pump_V", "V", -10.0, 100.0, 3.0, 2.0').replace(
    '"h_m", "m", 0.0, 2.0, 0.5', '"h_m", "m", -60.0, 200.0, 40.0, 10.0'
)


def moved_far(tank: Simulator) -> Simulator:
    """The tank as a fit may see it: a hundred times higher, the pump turned up, the level's sensor below zero."""
    ((h,), (pump,), (sensor,)) = tank.states, tank.inputs, tank.outputs
    return replace(
        tank,
        states=(replace(h, high=90.0, nominal=30.0, scale=9.0),),
        inputs=(replace(pump, nominal=70.0, scale=30.0),),
        outputs=(replace(sensor, nominal=-20.0, scale=8.0),),
    )


@pytest.mark.parametrize("source", ["generic", "faults"])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_whatever_a_fit_may_find_is_read_back(tmp_path, monkeypatch, source, share):
    """A fit sizes thresholds and periods for where the machine was, and an effect may be near its absence."""
    spec = write_python(tmp_path, WIDE)
    tank = load_simulator(spec)
    monkeypatch.setattr("twinbench.physics.load.tried", lambda *_: None)  # tried it is now, and each trial is a fork
    far = moved_far(tank)
    found = generic(far, (700.0, 730.0, 760.0)) if source == "generic" else faults(far, 0.5)
    offered = {m.name for m in (generic if source == "generic" else faults)(tank)}
    there = [m for m in found if m.name in offered]
    assert len(there) >= 10
    for m in there:
        values = {v.name: v.low + share * (v.high - v.low) for v in m.parameters}
        size = m.parameters[0]
        values[size.name] = m.off + max(share, 0.1) * (size.nominal - m.off)
        path, again = tmp_path / "model.toml", tmp_path / "again.toml"
        path.write_text(model_toml(spec, tank, [m], values, tmp_path))
        assert read_back(path, values) == values
        moved = values | {size.name: m.off + 0.5 * (values[size.name] - m.off)}
        simulator = load_simulator(str(path))
        inside = {name: v for name, v in moved.items() if name in {p.name for p in simulator.parameters}}
        again.write_text(model_toml(str(path), simulator, [], inside, tmp_path))
        assert read_back(again, inside) == inside


def read_back(path: Path, names) -> dict[str, float]:
    model = load_model(str(path))
    told = {v.name: v.nominal for v in model.simulator.parameters}
    told |= {v.name: v.nominal for f in model.faults for v in f.parameters}
    return {name: told[name] for name in names}


def test_a_mechanism_of_yours_may_be_found_near_its_absence(tmp_path, spec):
    """A fit goes from absence, which may lie outside the bounds of what is plainly there."""
    catalogue = write_python(tmp_path, SPILL.replace("0.0, 10.0, 0.3", "0.2, 10.0, 0.3"), "spill.py")
    tank = load_simulator(spec)
    (spill,) = load_catalogue(catalogue, tank)
    values = {"spill_1_s": 0.05, "rim_m": 0.7}
    path = tmp_path / "model.toml"
    path.write_text(model_toml(spec, tank, [spill], values, tmp_path, catalogue))
    assert read_back(path, values) == values
    path.write_text(path.read_text().replace("0.05", "-0.05"))
    with pytest.raises(BadInput, match="lies outside its bounds, 0 to 10"):
        load_model(str(path))


def test_the_whole_catalogue_fits_and_names_nothing_twice(spec):
    for simulator in (NOMINAL, load_simulator(spec)):
        whole = whole_catalogue(simulator)
        check_catalogue(simulator, whole)
        assert ("suction_preheat" in {m.name for m in whole}) == (simulator is NOMINAL)


def test_what_physics_refuses_is_bad_input():
    with pytest.raises(BadInput, match="no simulator 'compresor'"):
        load_simulator("compresor")
