"""Provenance names Twinbench's own commit, never that of the repository that it happens to be installed in."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from twinbench.common import versions

ROOT = Path(__file__).parents[2]


def git(folder: Path, *arguments: str) -> str:
    named = ("-c", "user.name=A", "-c", "user.email=a@b.c")
    done = subprocess.run(["git", *named, *arguments], cwd=folder, check=True, capture_output=True, text=True)
    return done.stdout.strip()


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """Somebody's repository with one commit."""
    git(tmp_path, "init", "-q")
    (tmp_path / "theirs.txt").write_text("theirs")
    git(tmp_path, "add", "theirs.txt")
    git(tmp_path, "commit", "-qm", "theirs")
    return tmp_path


def test_installed_in_a_users_repository_their_commit_is_not_ours(repository: Path) -> None:
    packages = repository / ".venv" / "lib" / "site-packages"
    packages.mkdir(parents=True)
    assert versions._commit(packages) == (None, None)
    assert versions._commit(repository) == (None, None)


def test_a_copy_in_a_users_repository_has_no_commit_of_its_own(repository: Path) -> None:
    inside = repository / "vendored"
    inside.mkdir()
    shutil.copy(ROOT / "pyproject.toml", inside)
    git(repository, "add", ".")
    git(repository, "commit", "-qm", "vendored")
    assert versions._commit(inside) == (None, None)


def test_unpacked_onto_a_users_repository_it_is_not_tracked(repository: Path) -> None:
    shutil.copy(ROOT / "pyproject.toml", repository)
    assert versions._commit(repository) == (None, None)


def test_a_checkout_names_its_commit_and_whether_files_differ(repository: Path) -> None:
    shutil.copy(ROOT / "pyproject.toml", repository)
    git(repository, "add", ".")
    git(repository, "commit", "-qm", "ours")
    commit = git(repository, "rev-parse", "HEAD")
    assert versions._commit(repository) == (commit, False)
    (repository / "results").mkdir()
    (repository / "results" / "table.csv").write_text("a,b\n")
    assert versions._commit(repository) == (commit, False), "what a run leaves is no change of what made it"
    (repository / "theirs.txt").write_text("changed")
    assert versions._commit(repository) == (commit, True)


def test_another_projects_root_is_not_ours(repository: Path) -> None:
    (repository / "pyproject.toml").write_text('[project]\nname = "theirs"\n')
    git(repository, "add", ".")
    git(repository, "commit", "-qm", "a project")
    assert versions._commit(repository) == (None, None)


def test_provenance_has_the_version_in_any_case(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(versions, "_commit", lambda: (None, None))
    assert versions.version() == versions.provenance()["twinbench"]
    assert versions.provenance()["commit"] is None
    monkeypatch.setattr(versions, "_commit", lambda: ("abc", True))
    assert versions.version().endswith(", commit abc, with uncommitted changes")


@pytest.mark.parametrize("start", [b"\xef\xbb\xbf", b"# -*- coding: latin-1 -*-\n# \xb5\n"])
def test_a_users_file_may_be_in_any_coding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, start: bytes) -> None:
    (tmp_path / "their_own_method.py").write_bytes(start + b"import twinbench.data.batch\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert "twinbench.data.batch" in versions._closure("their_own_method")
