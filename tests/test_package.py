"""What somebody gets who installs the package: one name, and commands that work wherever they stand."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest
from helpers.tiny_profile import PROFILE
from jsonschema import Draft202012Validator

ROOT = Path(__file__).parents[1]
OWN = "raise RuntimeError('a user file of this name was imported')\n"


def build(source: Path, folder: Path, *targets: str) -> None:
    """Make the wheel, the source distribution or both in a folder."""
    made = [sys.executable, "-m", "hatchling", "build", "--directory", str(folder)]
    made += [word for target in targets for word in ("--target", target)]
    subprocess.run(made, check=True, cwd=source, capture_output=True)


def content(wheel: Path) -> dict[str, int]:
    """Every file of a wheel, with its checksum."""
    with zipfile.ZipFile(wheel) as files:
        return {file.filename: file.CRC for file in files.infolist()}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the source distribution."""
    folder = tmp_path_factory.mktemp("package")
    build(ROOT, folder, "sdist", "wheel")
    return folder


def share_machine_code(packages: Path) -> None:
    """Let the installed files find what is compiled of the checkout's, which are the same: numba keeps it by folder."""
    kept = Path(os.environ["NUMBA_CACHE_DIR"])  # twinbench sets it when it is imported
    for theirs in (path.parent for path in (packages / "twinbench").rglob("__init__.py")):
        ours = ROOT / theirs.relative_to(packages)
        source, target = (kept / f"{f.name}_{hashlib.sha1(str(f).encode()).hexdigest()}" for f in (ours, theirs))
        target.mkdir(parents=True, exist_ok=True)
        for file in source.glob("*.nb[ci]"):
            shutil.copy(file, target)


@pytest.fixture(scope="module")
def installed(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python of an environment that holds the wheel, and of ours what it depends on."""
    folder = tmp_path_factory.mktemp("installed")
    venv.create(folder / "env", with_pip=False, symlinks=True)
    python = folder / "env" / "bin" / "python"
    code = "import sysconfig; print(sysconfig.get_path('purelib'))"
    packages = Path(subprocess.run([python, "-c", code], check=True, capture_output=True, text=True).stdout.strip())
    (wheel,) = built.glob("twinbench-*.whl")
    pip = [
        sys.executable,
        "-m",
        "pip",
        "--disable-pip-version-check",
        "--quiet",
        "install",
        "--no-deps",
        "--no-compile",
    ]
    subprocess.run([*pip, "--target", str(packages), str(wheel)], check=True)
    # A path in a .pth file is looked in, and .pth files that it holds are not: the checkout stays out.
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    share_machine_code(packages)
    return python


@pytest.fixture
def workplace(tmp_path: Path) -> Path:
    """A folder with files and folders of a user's, named as ours are."""
    for name in ("bench", "common", "methods", "mismatch"):
        (tmp_path / f"{name}.py").write_text(OWN)
    for name in ("data", "machines", "physics"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(OWN)
    return tmp_path


def said(installed: Path, workplace: Path, *arguments: str, status: int = 0) -> str:
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [installed, *arguments], cwd=workplace, capture_output=True, text=True, env=environment, check=False
    )
    assert done.returncode == status, done.stderr
    return done.stdout


def test_an_index_would_take_both_distributions(built: Path) -> None:
    both = sorted(str(path) for path in built.iterdir())
    assert [path.rpartition(".")[2] for path in both] == ["whl", "gz"]
    done = subprocess.run(
        [sys.executable, "-m", "twine", "check", "--strict", *both], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
    assert done.stdout.count("PASSED") == 2


def test_the_source_distribution_makes_the_same_wheel(built: Path, tmp_path: Path) -> None:
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as files:
        assert all(file.isfile() for file in files.getmembers()), "links are of a checkout alone"
        files.extractall(tmp_path, filter="data")
    (source,) = tmp_path.iterdir()
    build(source, tmp_path / "again", "wheel")
    (wheel,), (again,) = built.glob("*.whl"), (tmp_path / "again").glob("*.whl")
    assert content(again) == content(wheel)


def test_one_name_joins_the_users_packages(installed: Path) -> None:
    packages = next((installed.parents[1] / "lib").glob("python*/site-packages"))
    names = {path.name for path in packages.iterdir() if path.suffix not in (".pth", ".dist-info")}
    assert names - {"bin", "__pycache__"} == {"twinbench"}
    assert not any(path.is_symlink() for path in (packages / "twinbench").rglob("*"))
    assert (packages / "twinbench" / "py.typed").is_file()


def test_the_public_names_come_from_the_package(installed: Path, workplace: Path) -> None:
    code = "import twinbench; print(twinbench.__file__, *[getattr(twinbench, n).__module__ for n in twinbench.__all__])"
    file, *modules = said(installed, workplace, "-c", code).split()
    assert str(installed.parents[1]) in file
    assert all(module.startswith("twinbench.") for module in modules)


def test_help_and_lists(installed: Path, workplace: Path) -> None:
    assert "mismatch" in said(installed, workplace, "-m", "twinbench", "--help")
    assert "deeponet_kalman" in said(installed, workplace, "-m", "twinbench", "list")


def test_the_first_verdict_of_the_tutorial(installed: Path, workplace: Path) -> None:
    page = (ROOT / "docs" / "mismatch_tutorial.md").read_text(encoding="utf-8")
    for block in page.split("```python\n# ")[1:]:
        name, _, text = block.partition("\n")
        (workplace / name).write_text(text.partition("```")[0])
    said(installed, workplace, "logger.py")
    line = next(line for line in page.splitlines() if line.startswith("twinbench mismatch"))
    assert "coulomb_friction" in said(installed, workplace, "-m", *line.split(), status=10)
    for name in ("report.html", "report.pdf"):
        assert (workplace / "found" / name).is_file()
    verdict = json.loads((workplace / "found" / "verdict.json").read_text(encoding="utf-8"))
    schema = json.loads(said(installed, workplace, "-m", "twinbench", "schema", "verdict"))
    Draft202012Validator(schema).validate(verdict)
    assert verdict["provenance"]["commit"] is None, "around a package lies somebody else's code"
    assert "estimate" in said(installed, workplace, "-m", "twinbench", "schema", "summary")


def test_a_tiny_run_with_a_users_estimator(installed: Path, workplace: Path) -> None:
    (workplace / "tiny.toml").write_text(PROFILE)
    (workplace / "mine.py").write_text((ROOT / "examples" / "regression.py").read_text())
    run = ("-m", "twinbench", "run", "--profile", "tiny.toml", "--only", "mine.py", "--out", "out", "--jobs", "1")
    assert "report:" in said(installed, workplace, *run)
    assert (workplace / "out" / "report.html").is_file()
