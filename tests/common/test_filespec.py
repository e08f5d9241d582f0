"""``FILE[:NAME]`` on every system: the colon of a drive is not one that a name follows."""

from __future__ import annotations

from pathlib import Path, PurePosixPath, PureWindowsPath

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinbench.common.filespec import join_spec, moved, split_spec

FILES = [
    PureWindowsPath(r"C:\x\my.py"), PureWindowsPath("C:/x/my.py"), PureWindowsPath(r"\\server\share\my.py"),
    PureWindowsPath(r"C:my.py"), PureWindowsPath(r"D:\found\model.toml"), PureWindowsPath(r"..\my.py"),
    PurePosixPath("/x/my.py"), PurePosixPath("my.py"), PurePosixPath("a.b/my.v2.py"), PurePosixPath("12:30/my.py"),
]  # fmt: skip


@pytest.mark.parametrize("file", FILES, ids=str)
@pytest.mark.parametrize("name", ["", "TANKS", "Class:ablation"])
def test_a_file_and_a_name(file, name):
    assert split_spec(join_spec(file, name)) == (str(file), name)


@pytest.mark.parametrize("spec", ["compressor", "package.module:NAME", "deeponet_kalman:no_trust", "", ":", "C:"])
def test_what_names_no_file(spec):
    assert split_spec(spec) == ("", "")


@given(st.sampled_from(FILES), st.from_regex(r"\A[A-Za-z_]\w{0,5}\Z"))
def test_there_and_back(file, name):
    spec = join_spec(file, name)
    assert join_spec(*split_spec(spec)) == spec


def test_a_spec_told_from_another_folder():
    assert moved("tanks.py:TANKS", Path("/a/b"), Path("/a/b/found")) == "../tanks.py:TANKS"
    assert moved("/x/tanks.py", Path("/a"), Path("/a")) == "../x/tanks.py"
    assert moved("nominal", Path("/a"), Path("/b")) == "nominal"
