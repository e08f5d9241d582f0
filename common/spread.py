"""Items of work on the workers of a Dask cluster; an item whose worker dies goes to another one."""

from __future__ import annotations

import contextlib
import pickle
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Any

from twinbench.common.at_worker import OTHER_CODE, Call, Place
from twinbench.common.attempts import AT_WORK, Done, at_work
from twinbench.common.errors import BadInput, WorkerKilled
from twinbench.common.versions import own_source

_LOOK_S = 1.0  # how often it is looked whether there are workers
_DESERTED_S = 60.0  # without any worker, where one was lost; a nanny starts a new one in seconds


def on_cluster(
    client: Any,
    work: Callable[..., Any],
    several: Mapping[str, tuple[Any, ...]],
    say: Callable[[str], object],
    folder: Path | None,
) -> Iterator[tuple[str, Done]]:
    """How each item ended, as they end. Arguments as of ``side_by_side``."""
    import cloudpickle

    names = list(several)
    with _marks(folder or Path()) as marks:
        place = Place(Path.cwd(), marks, own_source())
        calls = [Call((place, number, cloudpickle.dumps((work, several[name])))) for number, name in enumerate(names)]
        going = {
            client.submit(pickle.loads, pickle.dumps(call), key=f"{marks.name}-{number}", pure=False): number
            for number, call in enumerate(calls)
        }
        watched = _Watch(client, say)
        try:
            while going:
                for future in _ended(going):
                    number = going.pop(future)
                    yield names[number], _result(future, marks, number)
                watched.look(lambda: [names[number] for number in going.values() if at_work(marks, number)])
        except (CancelledError, _SchedulerGone) as error:
            raise WorkerKilled(
                "the Dask scheduler has gone; start it and run the same command again to go on from what is finished"
            ) from error
        finally:
            client.cancel(list(going))


def _ended(going: Mapping[Any, int]) -> Any:
    """Those that have ended, if one does within a moment."""
    from distributed import wait

    try:
        return wait(list(going), timeout=_LOOK_S, return_when="FIRST_COMPLETED").done
    except TimeoutError:
        return ()


def _result(future: Any, marks: Path, number: int) -> Done:
    from distributed import KilledWorker

    try:
        return future.result()  # type: ignore[no-any-return]
    except KilledWorker:  # the scheduler allows fewer deaths
        return Done(at_work(marks, number), given_up=True)
    except (ImportError, AttributeError) as error:
        if "twinbench" not in str(error):
            raise
        raise BadInput(f"{OTHER_CODE.format('a worker')} ({error})") from error


class _SchedulerGone(Exception):
    """It no longer answers."""


class _Watch:
    """Says once that nobody works, and ends the wait where workers are gone for good."""

    def __init__(self, client: Any, say: Callable[[str], object]) -> None:
        self.client, self.say, self.told = client, say, False
        self.seen = time.monotonic()

    def look(self, begun: Callable[[], list[str]]) -> None:
        """Is any worker there? ``begun`` says which items a worker began and has not ended."""
        try:
            there = self.client.nthreads()
        except OSError as error:
            raise _SchedulerGone from error
        if there:
            self.seen, self.told = time.monotonic(), False
            return
        if time.monotonic() - self.seen > _DESERTED_S and (lost := begun()):
            raise WorkerKilled(
                f"all workers of the cluster have gone; they were at {'; '.join(lost)}. Start workers, and run the "
                "same command again to go on from what is finished"
            )
        if not self.told:
            self.told = True
            self.say("the cluster has no worker at the moment; waiting for one")


@contextlib.contextmanager
def _marks(folder: Path) -> Iterator[Path]:
    """A new folder in ``folder`` for the marks of attempts: who sees it, sees the same ``folder`` and no namesake."""
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryDirectory(prefix=f".{AT_WORK}", dir=folder, ignore_cleanup_errors=True) as marks:
            yield Path(marks).absolute()
    finally:
        if made:
            with contextlib.suppress(OSError):  # results are there
                folder.rmdir()
