"""Cases made, run and judged."""

from __future__ import annotations

import contextlib
import functools
import importlib
import multiprocessing
import os
import pkgutil
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from fuzz import worker
from fuzz.answers import ANSWERS, Answer
from fuzz.cases import Case
from fuzz.commands import make, unspoilt
from fuzz.judge import Outcome, judge, listing
from fuzz.world import World, build

PATIENCE_S = {"latency": 120.0, "mismatch": 30.0}
"""Processor time that these may take. latency starts Python anew for the memory of each of its peers. mismatch tries
every candidate where none explains the recordings, some 13 s alone and more beside another, and says how far it is."""


class Fuzz:
    """A world, and cases in it."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.seed = folder, seed
        self.world: World = build(folder / "world")
        self._unspoilt = functools.cache(self._answer)

    def outcome(self, command: str, index: int, keep: bool = False) -> Outcome:
        """Make, run and judge a case; its folder goes, unless it is kept."""
        folder = self.folder / f"{command}-{index}"
        case = make(command, index, self.seed, folder, self.world)
        before = listing(folder)
        ended = self._run(case)
        result = judge(case, ended, before, lambda c: self._unspoilt(c.command, "model.toml" in c.arguments))
        if not keep:
            shutil.rmtree(folder, ignore_errors=True)
        return result

    def _run(self, case: Case) -> worker.Ended:
        with tempfile.TemporaryDirectory(dir=self.folder) as logs:
            longest_s = PATIENCE_S.get(case.command, worker.LONGEST_S)
            return worker.run(case.arguments, case.folder, Path(logs), longest_s)

    def _answer(self, command: str, model: bool) -> Answer:
        """What the command says of good input."""
        case = unspoilt(command, self.folder / f"{command}-unspoilt-{model}-{os.getpid()}", self.world, model)
        ended = self._run(case)
        if ended.status not in (0, 1):
            raise RuntimeError(f"{command} does not take good input: {ended.err}")
        return ANSWERS[command](case.folder, ended)


@contextlib.contextmanager
def started(seed: int) -> Iterator[Fuzz]:
    """A fuzz in a folder that goes when it ends."""
    _import_all()
    with tempfile.TemporaryDirectory(prefix="twinbench-fuzz-") as folder:
        yield Fuzz(Path(folder), seed)


def _import_all() -> None:
    """What the commands import late: forks share it. One process, whatever the machine has."""
    os.environ["LOKY_MAX_CPU_COUNT"] = "1"
    for room in ("bench", "data", "mismatch"):
        package = importlib.import_module(f"twinbench.{room}")
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            importlib.import_module(module.name)


def outcomes(fuzz: Fuzz, cases: Sequence[tuple[str, int]], jobs: int) -> Iterator[Outcome]:
    """In the order of the cases, by so many forks of this process."""
    fork = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(jobs, fork, initializer=_share, initargs=(fuzz,)) as pool:
        yield from pool.map(_outcome, cases)


_shared: list[Fuzz] = []


def _share(fuzz: Fuzz) -> None:
    _shared[:] = [fuzz]


def _outcome(case: tuple[str, int]) -> Outcome:
    return _shared[0].outcome(*case)
