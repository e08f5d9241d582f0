"""Progress on stderr: named stages, what is done, for how long, and about how long it will take.

Where somebody looks on, a bar for each stage; elsewhere, as in a log, a line where a stage begins and ends and
one at least every LINE_EVERY_S between.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, TaskID, TextColumn
from rich.progress import Progress as Bars

T = TypeVar("T")
log = logging.getLogger(__name__)

LINE_EVERY_S = 30.0
REDRAWN_S = 0.2
TELLS_S = 2.0
"""How long a stage takes before it is foretold how long it takes."""


@dataclass
class Stage:
    """One stage.

    Attributes:
        total: how many steps it has; None: it tells the share that is done.
        done: steps, or the share.
        resumed: of them, those that an earlier run did: they say nothing about how long one takes.
        says: more to say, such as a pace.
    """

    name: str
    total: float | None
    done: float = 0.0
    resumed: float = 0.0
    says: str = ""
    over: bool = False
    told: bool = False
    since: float | None = field(default_factory=lambda: time.monotonic())
    spent_s: float = 0.0
    bar: TaskID | None = None

    @property
    def elapsed_s(self) -> float:
        """Time spent on it."""
        return self.spent_s + (0.0 if self.since is None else time.monotonic() - self.since)

    def step(self, steps: float = 1.0) -> None:
        """So many steps more are done."""
        self.done += steps

    def pause(self) -> None:
        """Nothing happens in it until it is come back to."""
        self.spent_s, self.since = self.elapsed_s, None

    def status(self) -> str:
        """``3 of 8 after 1 min 5 s, about 1 min 48 s left``."""
        if self.over:
            return f"done in {duration(self.elapsed_s)}"
        whole = self.total or 1.0
        parts = [f"{100 * self.done:.0f} %" if self.total is None else f"{self.done:g} of {self.total:g}"]
        if self.total == 1 or (self.total is None and not self.done):
            parts = []
        text = " ".join([*parts, f"after {duration(self.elapsed_s)}"])
        fresh = self.done - self.resumed
        if fresh > 0 and self.elapsed_s > TELLS_S and self.done < whole:
            text += f", about {duration(self.elapsed_s * (whole - self.done) / fresh)} left"
        return f"{text}; {self.says}" if self.says else text


class Progress:
    """Tells of one stage after the other.

    Args:
        after_s: in a log, stages that are over sooner are not told: for commands that mostly take a moment.
    """

    def __init__(self, console: Console | None = None, after_s: float = 0.0) -> None:
        self.after_s = after_s
        self.console = console or Console(stderr=True)
        self._stages: dict[str, Stage] = {}
        self._now: Stage | None = None
        self._over = threading.Event()
        # With --verbose there are lines on stderr that a bar would tear apart.
        drawn = self.console.is_terminal and not log.isEnabledFor(logging.INFO)
        self._bars = (
            Bars(
                TextColumn("{task.description:>15}"),
                BarColumn(),
                TextColumn("{task.fields[status]}"),
                console=self.console,
                auto_refresh=False,
            )
            if drawn
            else None
        )

    def __enter__(self) -> Progress:
        if self._bars:
            self._bars.start()
        self._thread = threading.Thread(target=self._tell, name="progress", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._over.set()
        self._thread.join()
        for stage in self._stages.values():
            if kind is None:
                self._close(stage)
            elif stage is self._now and stage.told:
                self._say(f"{stage.name}: broken off, {stage.status()}")
        if self._bars:
            self._draw()
            self._bars.stop()

    @contextlib.contextmanager
    def stage(self, name: str, total: float, resumed: float = 0.0) -> Iterator[Stage]:
        """A stage of so many steps, some of them done by an earlier run; whoever works on it tells its steps."""
        stage = self._begin(Stage(name, total, resumed, resumed))
        yield stage
        self._close(stage)

    def report(self, name: str, share: float) -> None:
        """The share of a stage that is done; the stage is the one that is going on until another is reported.

        A stage that never told a share is over when the next one begins. Others may be come back to, and are over
        at the end.
        """
        if self._now is None or self._now.name != name:
            if self._now is not None:
                self._pause(self._now)
            if name in self._stages:
                self._now = self._stages[name]
                self._now.since, self._now.over = time.monotonic(), False
            else:
                self._begin(Stage(name, None))
        assert self._now is not None
        self._now.done = max(self._now.done, share)

    def say(self, line: str) -> None:
        """Something that happened, above the bars or between the lines."""
        if log.isEnabledFor(logging.INFO):
            log.warning(line)
        else:
            self.console.print(line, highlight=False, markup=False, soft_wrap=True)

    def _begin(self, stage: Stage) -> Stage:
        self._now = self._stages[stage.name] = stage
        if self._bars:
            stage.bar = self._bars.add_task(stage.name, total=stage.total or 1.0, status="")
        if not self.after_s:
            self._say_begins(stage)
        return stage

    def _say_begins(self, stage: Stage) -> None:
        stage.told = True
        steps = f"{stage.total:g} to do" if stage.total and stage.total > 1 else "begins"
        self._say(f"{stage.name}: {steps}{f', {stage.resumed:g} of them done before' if stage.resumed else ''}")

    def _pause(self, stage: Stage) -> None:
        stage.pause()
        if stage.done in (0.0, 1.0):
            self._close(stage)

    def _close(self, stage: Stage) -> None:
        if stage.over:
            return
        stage.pause()
        stage.done, stage.over = stage.total or 1.0, True
        self._now = None if self._now is stage else self._now
        if stage.told:
            self._say(f"{stage.name}: {stage.status()}")

    def _tell(self) -> None:
        """Until the end: the bars, or a line for who reads a log."""
        wait_s = REDRAWN_S if self._bars else self.after_s or LINE_EVERY_S
        while not self._over.wait(wait_s):
            stage = self._now
            if self._bars:
                self._draw()
            elif stage is not None and not stage.told:
                self._say_begins(stage)
            elif stage is not None:
                self._say(f"{stage.name}: {stage.status()}")
                wait_s = LINE_EVERY_S

    def _draw(self) -> None:
        assert self._bars is not None
        for stage in list(self._stages.values()):
            if stage.bar is not None:
                self._bars.update(stage.bar, completed=stage.done, status=stage.status())
        self._bars.refresh()

    def _say(self, line: str) -> None:
        if log.isEnabledFor(logging.INFO):
            log.info(line)
        elif self._bars is None:
            self.say(line)


def each(name: str, several: Sequence[T]) -> Iterator[T]:
    """One after the other of several, as a stage; told if it takes more than a moment."""
    with Progress(after_s=TELLS_S) as progress, progress.stage(name, len(several)) as going:
        for one in several:
            yield one
            going.step()


def duration(seconds: float) -> str:
    """``48 s``, ``3 min 5 s``, ``2 h 10 min``."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
