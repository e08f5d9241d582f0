"""Progress: named stages, time left, lines in a log, and what is over is told as over."""

from __future__ import annotations

import contextlib
import io
import logging
import re
import time

import pytest
from rich.console import Console

from twinbench.common import progress as module
from twinbench.common.progress import Progress, Stage, duration, each


def told(monkeypatch: pytest.MonkeyPatch, every_s: float = 30.0) -> tuple[Console, io.StringIO]:
    monkeypatch.setattr(module, "LINE_EVERY_S", every_s)
    text = io.StringIO()
    return Console(file=text, width=120), text


def test_a_log_has_a_line_where_a_stage_begins_and_ends_and_in_between(monkeypatch: pytest.MonkeyPatch) -> None:
    console, text = told(monkeypatch, every_s=0.05)
    with Progress(console) as progress, progress.stage("train", 4) as going:
        going.step()
        time.sleep(0.3)
    lines = text.getvalue().splitlines()
    assert lines[0] == "train: 4 to do"
    assert lines[-1] == "train: done in 0 s"
    assert len(lines) >= 4
    assert set(lines[1:-1]) == {"train: 1 of 4 after 0 s"}


def test_a_line_comes_at_least_every_half_minute() -> None:
    assert module.LINE_EVERY_S <= 30.0


def test_time_left_follows_from_the_pace_of_what_was_done_now(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [1000.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    stage = Stage("train", 8.0, done=2.0, resumed=2.0)
    now[0] += 60.0
    assert stage.status() == "2 of 8 after 1 min 0 s", "what an earlier run did tells no pace"
    stage.step()
    assert stage.status() == "3 of 8 after 1 min 0 s, about 5 min 0 s left"
    share = Stage("screen", None, done=0.25)
    now[0] += 30.0
    assert share.status() == "25 % after 30 s, about 1 min 30 s left"


def test_stages_that_never_tell_a_share_are_closed_when_the_next_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    console, text = told(monkeypatch)
    with Progress(console) as progress:
        for stage, share in (("audit", 0.0), ("screen", 0.2), ("refit", 0.1), ("screen", 0.6), ("prove", 0.0)):
            progress.report(stage, share)
        assert [s.over for s in progress._stages.values()] == [True, False, False, False]
    lines = text.getvalue().splitlines()
    assert lines[:3] == ["audit: begins", "audit: done in 0 s", "screen: begins"]
    assert sorted(line for line in lines if "done" in line) == [
        f"{stage}: done in 0 s" for stage in ("audit", "prove", "refit", "screen")
    ]


def test_what_takes_but_a_moment_is_not_told_where_nobody_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    console, text = told(monkeypatch)
    with Progress(console, after_s=5.0) as progress, progress.stage("estimate", 2):
        pass
    assert text.getvalue() == ""
    with Progress(console, after_s=0.05) as progress, progress.stage("estimate", 2):
        time.sleep(0.3)
    assert text.getvalue().splitlines()[:2] == ["estimate: 2 to do", "estimate: 0 of 2 after 0 s"]
    assert text.getvalue().splitlines()[-1] == "estimate: done in 0 s"
    assert list(each("estimate", [1, 2])) == [1, 2]


def test_what_breaks_off_is_not_told_as_done(monkeypatch: pytest.MonkeyPatch) -> None:
    console, text = told(monkeypatch)
    with contextlib.suppress(ValueError), Progress(console) as progress, progress.stage("train", 4) as going:
        going.step(3)
        raise ValueError
    assert text.getvalue().splitlines()[-1] == "train: broken off, 3 of 4 after 0 s"
    assert "done" not in text.getvalue()


def test_a_terminal_sees_every_stage_end(monkeypatch: pytest.MonkeyPatch) -> None:
    text = io.StringIO()
    with Progress(Console(file=text, width=100, force_terminal=True)) as progress:
        progress.report("audit", 0.0)
        progress.report("screen", 0.4)
        with progress.stage("latency", 3) as going:
            going.step(3)
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text.getvalue()).rstrip().splitlines()[-3:]
    assert [line.split()[0] for line in shown] == ["audit", "screen", "latency"]
    assert all("done in 0 s" in line for line in shown)


def test_verbose_lines_carry_the_time_and_no_bar_tears_them(caplog: pytest.LogCaptureFixture) -> None:
    text = io.StringIO()
    console = Console(file=text, force_terminal=True)
    with caplog.at_level(logging.INFO, logger="twinbench"), Progress(console) as progress:
        progress.report("audit", 0.0)
    assert text.getvalue() == ""
    assert [r.getMessage() for r in caplog.records] == ["audit: begins", "audit: done in 0 s"]


@pytest.mark.parametrize(
    ("seconds", "says"), [(0.4, "0 s"), (59.6, "1 min 0 s"), (185, "3 min 5 s"), (7800, "2 h 10 min")]
)
def test_durations_are_words(seconds: float, says: str) -> None:
    assert duration(seconds) == says
