"""Which estimators there are, and one line for every way of naming none."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from helpers.tiny_run import write_estimator

from twinbench.bench.registry import discover, find
from twinbench.common.errors import BadInput
from twinbench.methods.estimator import REGISTRY, Estimator

THEIRS = "from twinbench.methods.estimator import Estimator\n"
ORACLE = "from twinbench.baselines.oracle import Oracle\n"


def refused(name: str) -> str:
    with pytest.raises(BadInput) as caught:
        find(name)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def entry_point(monkeypatch: pytest.MonkeyPatch, load) -> None:
    """One installed plug-in, whose loading does this."""
    entry = SimpleNamespace(name="theirs", value="their_package:Theirs", load=load)
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [entry])
    monkeypatch.setattr("twinbench.bench.registry.REGISTRY", dict(REGISTRY))


def test_ours_are_found_by_name() -> None:
    assert find("oracle").name == "oracle"
    assert {"oracle", "nominal_ekf", "deeponet_kalman"} <= set(discover())


def test_an_unknown_name_gets_a_suggestion() -> None:
    assert "no estimator 'orcale'; did you mean 'oracle'?" in refused("orcale")
    assert "give a path ending in .py" in refused("zzz")


def test_a_file_is_read_anew_each_time_and_stays_out_of_the_registry(tmp_path: Path) -> None:
    spec = write_estimator(tmp_path, "mine", scale=1.0)
    assert find(spec).settings["scale"] == 1.0
    write_estimator(tmp_path, "mine", scale=1.25)
    assert find(spec).settings["scale"] == 1.25
    assert find(f"{spec}:Constant").name == "mine"
    assert "mine" not in REGISTRY


def test_a_file_that_builds_on_ours_takes_none_of_them_out_of_the_registry(tmp_path: Path) -> None:
    """In a process in which nobody has asked for any of ours before."""
    (tmp_path / "mine.py").write_text(ORACLE + "class Mine(Oracle):\n    name = 'mine'\n")
    asked = "from twinbench.bench.registry import discover, find; find('mine.py'); assert 'oracle' in discover()"
    done = subprocess.run([sys.executable, "-c", asked], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("import no_such_package", "fails to import: ModuleNotFoundError: No module named 'no_such_package'"),
        ("def f(:", "fails to import: SyntaxError"),
        ("raise SystemExit(3)", "fails to import: SystemExit: 3"),
        ("x = 1", r"has 0 Estimator classes (none); decorate one with @register"),
        (THEIRS + "class A(Estimator):\n    name = 'a'\nclass B(A):\n    name = 'b'", "has 2 Estimator classes (A, B)"),
        (THEIRS + "class A(Estimator):\n    name = 'a'", "A has no fit, no init, no step"),
        (ORACLE + "class A(Oracle):\n    name, settings = 'a', 3", "settings of A is no dict"),
        (ORACLE + "class A(Oracle):\n    name, ablations = 'a', []", "ablations of A is"),
    ],
)
def test_a_broken_file_is_one_line(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "broken.py"
    path.write_text(text)
    message = refused(str(path))
    assert says in message
    assert str(path) in message


@pytest.mark.parametrize("name", ["", "a b", "a/b", "../x", "a:b", "[red]x[/]", "x" * 61, "-o", "a\nb"])
def test_a_name_that_cannot_be_a_file_name_is_refused(tmp_path: Path, name: str) -> None:
    path = Path(write_estimator(tmp_path, "mine"))
    path.write_text(path.read_text().replace('"mine"', repr(name)))
    message = refused(str(path))
    assert "cannot be a file name" in message
    assert "\n" not in message


def test_a_file_that_is_not_there_or_lacks_the_class(tmp_path: Path) -> None:
    assert "no file" in refused(str(tmp_path / "nowhere.py"))
    assert "has no Estimator class 'Other'; it has: Constant" in refused(write_estimator(tmp_path, "mine") + ":Other")


@pytest.mark.parametrize("spec", [r"C:\x\my.py", r"C:\x\my.py:Mine", r"C:\x\my.py:Mine:no_scale"])
def test_a_path_of_windows_is_a_file(spec: str) -> None:
    assert r"no file C:\x\my.py; give the path of a .py file" in refused(spec)


def test_a_file_of_windows_is_planned_as_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from twinbench.bench.profile import load_profile
    from twinbench.bench.runner import plan

    monkeypatch.chdir(tmp_path)
    Path(write_estimator(tmp_path, "mine")).rename(r"C:\x\mine.py")  # a name like any other, here
    for spec in (r"C:\x\mine.py", r"C:\x\mine.py:Constant"):
        (cell,) = {c.spec for c in plan(load_profile("quick"), (spec,))}
        assert cell == str(tmp_path / spec)


def test_a_file_may_not_take_one_of_our_names(tmp_path: Path) -> None:
    assert "'oracle' is one of the benchmark's own names" in refused(write_estimator(tmp_path, "oracle"))


def test_an_installed_plug_in_joins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    theirs = find(write_estimator(tmp_path, "theirs"))
    entry_point(monkeypatch, lambda: theirs)
    assert find("theirs") is theirs


def fails() -> type[Estimator]:
    raise ImportError("numpy 1 wanted\nmore")


@pytest.mark.parametrize(
    ("load", "says"),
    [
        (
            fails,
            "plug-in 'theirs' (their_package:Theirs) fails to load: ImportError: numpy 1 wanted; mend that package",
        ),
        (lambda: SimpleNamespace, "plug-in 'theirs' (their_package:Theirs) is no Estimator with a name"),
        (lambda: Estimator, "plug-in 'theirs' (their_package:Theirs) is no Estimator with a name"),
    ],
)
def test_a_broken_plug_in_is_one_line(monkeypatch: pytest.MonkeyPatch, load, says: str) -> None:
    entry_point(monkeypatch, load)
    assert says in refused("oracle")
