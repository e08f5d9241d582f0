"""What hands the package on says what pyproject.toml says: the recipe, the container, the page on installation."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers.prose import ROOT
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]
EXTRAS = PROJECT["optional-dependencies"]
CONDA_NAMES = {
    "dask": "dask-core", "matplotlib": "matplotlib-base", "seaborn": "seaborn-base", "torch": "pytorch",
}  # fmt: skip
"""Where conda-forge calls a package otherwise, or has a smaller one that is enough."""
Wanted = dict[str, SpecifierSet]


def wanted(lines: list[str], names: dict[str, str] | None = None) -> Wanted:
    """By name which versions; without what names the package itself."""
    found = [Requirement(line) for line in lines]
    named = {canonicalize_name(r.name): r.specifier for r in found}
    return {(names or {}).get(name, name): which for name, which in named.items() if name != "twinbench"}


@pytest.fixture(scope="module")
def recipe() -> dict[str, Any]:
    text = (ROOT / "packaging/recipe.yaml").read_text(encoding="utf-8")
    values = yaml.safe_load(text)["context"]
    return yaml.safe_load(re.sub(r"\$\{\{ (\w+) \}\}", lambda m: values.get(m[1], m[0]), text))


def test_the_recipe_needs_what_the_package_needs(recipe: dict[str, Any]) -> None:
    needs = recipe["requirements"]
    python = {"python": SpecifierSet(PROJECT["requires-python"])}
    assert wanted(needs["run"]) == python | wanted(PROJECT["dependencies"], CONDA_NAMES)
    optional = [line for name, lines in EXTRAS.items() if name != "dev" for line in lines]
    assert wanted(needs["run_constraints"]) == wanted(optional, CONDA_NAMES)
    build = dict(line.partition(" ")[::2] for line in needs["host"])
    assert build.pop("python") == f"{recipe['context']['python_min']}.*"
    assert "pip" in build
    assert wanted(PYPROJECT["build-system"]["requires"]) == {"hatchling": SpecifierSet(build["hatchling"])}


def test_a_dependency_that_the_recipe_lacks_would_be_found(recipe: dict[str, Any]) -> None:
    assert wanted(recipe["requirements"]["run"][:-1]) != wanted(recipe["requirements"]["run"])
    assert wanted(["numpy >=2.0"]) != wanted(["numpy>=2.0,!=2.4.0"])


def test_the_recipe_is_of_this_version_and_runs_the_same_command(recipe: dict[str, Any]) -> None:
    assert recipe["package"] == {"name": PROJECT["name"], "version": PROJECT["version"]}
    assert recipe["build"]["python"]["entry_points"] == [f"{k} = {v}" for k, v in PROJECT["scripts"].items()]
    about = recipe["about"]
    assert (about["summary"], about["license"]) == (PROJECT["description"], PROJECT["license"])
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert (citation["version"], citation["license"]) == (PROJECT["version"], PROJECT["license"])


def test_the_classifiers_name_the_versions_of_python_that_the_package_takes() -> None:
    says = [c.rpartition(" ")[2] for c in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", c)]
    takes = SpecifierSet(PROJECT["requires-python"])
    assert says == [version for version in (f"3.{minor}" for minor in range(30)) if f"{version}.1" in takes]


def test_the_page_on_installation_has_every_extra_and_what_it_brings() -> None:
    page = (ROOT / "docs/install.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `([\w-]+)` \| ([^|]+) \|", page, re.MULTILINE))
    assert set(rows) == set(EXTRAS)
    for name, lines in EXTRAS.items():
        if name != "dev":
            assert set(wanted(lines)) <= set(rows[name].split(", ")), name


@pytest.mark.parametrize("room", ["pyproject", "dev"])
def test_every_dependency_is_pinned(room: str) -> None:
    pins = wanted((ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines())
    for name, which in wanted(PROJECT["dependencies"] if room == "pyproject" else EXTRAS["dev"]).items():
        (pin,) = pins[name]
        assert pin.operator == "=="
        assert pin.version in which, name


def instructions() -> list[tuple[str, str]]:
    """The container file's, each with what follows it."""
    text = (ROOT / "packaging/Containerfile").read_text(encoding="utf-8")
    lines = re.sub(r"\\\n", " ", re.sub(r"^#.*\n", "", text, flags=re.MULTILINE)).splitlines()
    return [(line.partition(" ")[0], line.partition(" ")[2]) for line in lines if line]


def told(word: str) -> list[str]:
    return [rest for name, rest in instructions() if name == word]


def test_the_container_does_what_make_bench_does() -> None:
    command = [yaml.safe_load(told(word)[-1]) for word in ("ENTRYPOINT", "CMD")]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    (bench,) = re.findall(r"^bench: .*\n\t\$\(BIN\)/(.*)$", makefile, re.MULTILINE)
    assert [*command[0], *command[1]] == shlex.split(bench)
    (extras,) = re.findall(r"\$\(PIP\) -e '\.(\[.*\])'\n\t@touch \$@\n\n", makefile)
    assert f'-c /wheels/constraints.txt "$(echo /wheels/twinbench-*.whl){extras}"' in told("RUN")[1]


def test_the_container_gets_all_that_the_wheel_holds_on_a_python_that_it_takes() -> None:
    copied = [rest.split() for rest in told("COPY")]
    for *sources, _ in copied:
        assert all((ROOT / s).exists() for s in sources if not s.startswith(("--from", "/"))), sources
    given = {source for *sources, _ in copied for source in sources}
    build = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    for needed in (*build["only-include"], *build["force-include"], PROJECT["readme"], *PROJECT["license-files"]):
        assert {needed, needed.split("/")[0]} & given, needed
    versions = [re.search(r"python:(3\.\d+)-slim", rest)[1] for rest in told("FROM")]  # type: ignore[index]
    assert len(set(versions)) == 1
    assert f"{versions[0]}.1" in SpecifierSet(PROJECT["requires-python"])


@pytest.mark.skipif(shutil.which("git") is None or shutil.which("make") is None, reason="no git or no make")
def test_publish_makes_the_site_the_only_content_of_a_branch(tmp_path: Path) -> None:
    def run(*command: str) -> str:
        return subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True).stdout

    run("git", "init", "--quiet", "--bare", "host.git")
    run("git", "init", "--quiet", ".")
    for key in ("user.name", "user.email"):
        run("git", "config", key, "somebody")
    run("git", "remote", "add", "host", "host.git")
    (tmp_path / "site").mkdir()
    shutil.copy(ROOT / "Makefile", tmp_path)
    for text in ("old", "new"):
        (tmp_path / "site" / "index.html").write_text(text)
        run("make", "-o", "docs", "publish", "REMOTE=host", f"BIN={Path(sys.executable).parent}", "PYTHON=none")
    assert run("git", "-C", "host.git", "show", "gh-pages:index.html") == "new"
    assert run("git", "-C", "host.git", "ls-tree", "--name-only", "gh-pages").split() == [".nojekyll", "index.html"]
    assert run("git", "-C", "host.git", "rev-list", "--count", "gh-pages") == "1\n"
