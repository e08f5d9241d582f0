"""What the command does with bad input."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.tiny_run import twinbench


def listing(folder: Path) -> list[Path]:
    """Every file and folder in it, but for what Python itself leaves."""
    return sorted(p for p in folder.rglob("*") if "__pycache__" not in p.parts)


def refused(folder: Path, capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Exit status 2, one line on stderr, nothing on stdout, no file or folder more or less; the line."""
    before = listing(folder)
    capsys.readouterr()
    try:
        status = twinbench(*arguments)
    except SystemExit as stopped:
        status = stopped.code
    out, err = capsys.readouterr()
    assert status == 2
    assert out == ""
    assert err.startswith("twinbench") and err.count("\n") == 1 and err.endswith("\n"), err  # noqa: PT018
    assert listing(folder) == before
    return err
