"""Whose Python a ``model.toml`` runs: said each time, asked for where it lies elsewhere; and the file's limits."""

from __future__ import annotations

import ntpath
from pathlib import Path

import pytest
from tank_files import SPILL, TANK, write_python

from twinbench.common.errors import BadInput
from twinbench.common.filespec import moved
from twinbench.mismatch.model import MOST_BASES, load_model, load_simulator

RAN = "open(__file__ + '.ran', 'w').close()\n"


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """``here``, in which everything is called, and ``there`` beside it, which holds a tank that leaves a mark."""
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
        write_python(tmp_path / name, RAN + TANK)
        write_python(tmp_path / name, RAN + SPILL, "spill.py")
    write_python(tmp_path / "here", TANK, "tank_of_this_test.py")
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path


def model(path: str, base: str, source: str = "", more: str = "") -> str:
    mechanism = f'[[mechanisms]]\nname = "spill"\nfrom = "{source}"\n' if source else ""
    Path(path).parent.mkdir(exist_ok=True)
    Path(path).write_text(f'base = "{base}"\n{mechanism}{more}')
    return path


def ran(folder: Path) -> bool:
    return any(folder.glob("*.ran"))


@pytest.mark.parametrize(
    ("path", "base", "source"),
    [
        ("model.toml", "tank.py", "spill.py"),
        ("model.toml", "tank.py:TANK", "spill.py:SPILL"),
        ("found/model.toml", "../tank.py", "../spill.py"),
        ("../there/model.toml", "tank.py", "spill.py"),
        ("../there/model.toml", "../here/tank.py", "spill.py"),
        ("model.toml", "tank_of_this_test:TANK", ""),
    ],
)
def test_what_lies_in_its_folder_or_where_one_is_is_run_and_named(places, caplog, path, base, source):
    assert load_simulator(model(path, base, source)).name == "tank"
    assert caplog.messages[0].startswith(f"twinbench: {path} runs code from {places}")
    assert len(caplog.messages) == (2 if source else 1)


@pytest.mark.parametrize(
    ("base", "source"),
    [
        ("../there/tank.py", ""),
        ("../there/tank.py:TANK", ""),
        ("link.py", ""),
        ("tank.py", "../there/spill.py"),
        ("tank.py", "../there/spill.py:SPILL"),
        ("../there/model.toml", ""),
        ("antigravity:TANK", ""),
    ],
)
def test_what_lies_elsewhere_is_run_for_trust_only(places, caplog, base, source):
    Path("link.py").symlink_to(places / "there" / "tank.py")
    model(str(places / "there" / "model.toml"), "tank.py")
    path = model("model.toml", base, source)
    with pytest.raises(BadInput, match="say --trust") as caught:
        load_model(path)
    assert "\n" not in str(caught.value)
    assert "there" in str(caught.value) or "antigravity.py" in str(caught.value)
    assert not ran(places / "there")
    if base != "antigravity:TANK":
        assert load_model(path, trust=True).simulator.name == "tank"
        assert ran(places / "there") or ran(places / "here")
        assert "runs code from" in caplog.text


def test_built_in_simulators_need_no_word(places, caplog):
    for base in ("compressor", "twinbench.physics.nominal:NOMINAL"):
        load_simulator(model("model.toml", base))
    assert caplog.messages == []


def test_a_file_that_is_named_on_the_command_line_is_meant(places, caplog):
    assert load_simulator("../there/tank.py").name == "tank"
    assert caplog.messages == []


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ("[values]\nk = 1.5", "[values] k = 1.5 lies outside its bounds, 0 to 1; mend it"),
        ("[values]\ng = -1", "[values] g = -1 lies outside its bounds, 0 to 1"),
        ("[values]\nk = 1" + 400 * "0", "a whole number must have 63 bits at most"),
        ("[values]\nk = 1e999", "must hold numbers only"),
        ("[values]\nk = " + 5000 * "9", "not TOML"),
        ("[values]\nk = " + 50_000 * "[", "nested too deep"),
        (
            '[[mechanisms]]\nname = "sensor_bias@h_m"\nfrom = "faults"\n[values]\nbias_h_m = 9.0',
            "bias_h_m = 9 lies outside its bounds, -2 to 2",
        ),
        (2 * '[[mechanisms]]\nname = "spill"\nfrom = "spill.py"\n', "mechanism 'spill' is there twice"),
        ("#" * (1 << 21), "has more than 1,048,576 bytes"),
    ],
)
def test_a_model_that_means_harm_is_one_short_line(places, more, says):
    with pytest.raises(BadInput) as caught:
        load_model(model("model.toml", "tank.py", more=more))
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


def test_a_value_at_its_bound_and_a_lag_of_many_samples_are_read(places):
    fault = '[[mechanisms]]\nname = "sensor_lag@h_m"\nfrom = "faults"\n'
    loaded = load_model(model("model.toml", "tank.py", more=fault + "[values]\nk = 1.0000000001\nlag_s_h_m = 400.0"))
    assert loaded.faults[0].parameters[0].nominal == 400.0
    assert loaded.simulator.theta()[0] == pytest.approx(1.0)


def test_bases_of_bases_have_an_end(places):
    for k in range(MOST_BASES + 2):
        model(f"m{k}.toml", f"m{k - 1}.toml" if k else "tank.py")
    assert load_simulator(f"m{MOST_BASES - 1}.toml").name == "tank"
    with pytest.raises(BadInput, match=f"has more than {MOST_BASES} bases below it"):
        load_simulator(f"m{MOST_BASES + 1}.toml")


def test_a_circle_of_bases(places):
    model("a.toml", "b.toml")
    model("b.toml", "./a.toml")
    with pytest.raises(BadInput, match=r"a.toml: is its own base"):
        load_simulator("a.toml")


def test_a_base_on_another_drive_keeps_its_whole_path(monkeypatch):
    def relpath(path: str, start: str) -> str:
        return ntpath.relpath("D:\\tanks.py", "C:\\found")

    monkeypatch.setattr("os.path.relpath", relpath)
    assert moved("tanks.py:TANKS", Path("/d"), Path("/c")) == "/d/tanks.py:TANKS"
