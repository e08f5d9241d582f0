"""Items of work on the workers of a Dask cluster, if a command names one. All that knows of Dask is here."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import pickle
import platform
import tempfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextvars import ContextVar
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from twinbench.common.attempts import AT_WORK, MOST_LOST, Done, at_work, attempt
from twinbench.common.errors import BadInput, WorkerKilled
from twinbench.common.jobs import VARIABLE
from twinbench.common.threads import pin, pin_loaded
from twinbench.common.versions import own_source

CONNECT_S = 5.0
"""So long a scheduler may take to answer."""
_GLANCE_S = 1.0  # how often it is looked whether there are workers
_CLIENT: ContextVar[Any] = ContextVar("client", default=None)
_OTHER_CODE = "{} has not the Twinbench, or the libraries, of this machine; install the same and start it again"


@contextlib.contextmanager
def working_on(backend: str | None, scheduler: str = "", jobs: int | None = None) -> Iterator[None]:
    """Meanwhile ``side_by_side`` works there.

    Args:
        backend: "joblib", processes of this machine; "dask", a cluster; None: a cluster if ``scheduler`` names one.
        scheduler: its address, or the path of its scheduler file.
        jobs: how many processes of this machine somebody asked for.

    Raises:
        BadInput: the two do not fit together, Dask is not installed, or no scheduler answers.
    """
    if backend == "joblib" or not (backend or scheduler):
        if scheduler:
            raise BadInput("--scheduler is for --backend dask, and --backend is joblib; leave one of the two out")
        yield
        return
    if not scheduler:
        raise BadInput("--backend dask needs --scheduler ADDRESS, for example tcp://10.0.0.5:8786")
    if jobs is not None:
        raise BadInput("--jobs is for this machine alone; on a cluster each worker does one thing, so leave it out")
    with _connected(scheduler) as client:
        token = _CLIENT.set(client)
        try:
            yield
        finally:
            _CLIENT.reset(token)


def current() -> Any:
    """The client of the cluster that is worked on; None on this machine."""
    return _CLIENT.get()


@contextlib.contextmanager
def _connected(scheduler: str) -> Iterator[Any]:
    if find_spec("distributed") is None:
        raise BadInput("--backend dask needs Dask; install it with: pip install 'twinbench[dask]'")
    import dask
    from distributed import Client

    address = _address(scheduler)
    for name in ("distributed", "distributed.client"):  # a page about each lost connection; this says it in a line
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set({"distributed.comm.timeouts.connect": CONNECT_S}):
        try:
            client = Client(address)
        except (OSError, ValueError) as error:
            says = f"no Dask scheduler answers at {scheduler!r}; check the address and that it runs"
            raise BadInput(says) from error
        with client:
            yield client


def _address(scheduler: str) -> str:
    """What a scheduler file holds, or the address itself."""
    if not (scheduler.endswith(".json") or os.path.exists(scheduler)):
        return scheduler
    try:
        return str(json.loads(Path(scheduler).read_text(encoding="utf-8"))["address"])
    except (OSError, ValueError, LookupError, TypeError) as error:
        says = f"no Dask scheduler in {scheduler}; start one with: dask scheduler --scheduler-file {scheduler}"
        raise BadInput(says) from error


def on_cluster(
    client: Any,
    work: Callable[..., Any],
    several: Mapping[str, tuple[Any, ...]],
    say: Callable[[str], object],
    folder: Path,
) -> Iterator[tuple[str, Done]]:
    """How each item ended, as they end. Arguments as of ``side_by_side``."""
    import cloudpickle

    names = list(several)
    with _marks(folder) as marks:
        place = _Place(Path.cwd(), marks, own_source())
        works = [cloudpickle.dumps((work, arguments)) for arguments in several.values()]
        calls = [pickle.dumps(_Call((place, number, pickled))) for number, pickled in enumerate(works)]

        def submitted(number: int) -> Any:
            return client.submit(pickle.loads, calls[number], pure=False)

        going = {submitted(number): number for number in range(len(names))}
        staffed = True
        try:
            while going:
                for future in _ended(going):
                    number = going.pop(future)
                    done = _result(future, marks, number)
                    if done is None:
                        going[submitted(number)] = number
                    else:
                        yield names[number], done
                before, staffed = staffed, _staffed(client)
                if before and not staffed:
                    say("the cluster has no worker at the moment; waiting for one")
        except CancelledError as error:
            raise WorkerKilled(
                "the Dask scheduler has gone; start it and run the same command again to go on from what is finished"
            ) from error
        finally:
            client.cancel(list(going))


def _ended(going: Mapping[Any, int]) -> Any:
    """Those that have ended, if one does within a moment."""
    from distributed import wait

    try:
        return wait(list(going), timeout=_GLANCE_S, return_when="FIRST_COMPLETED").done
    except TimeoutError:
        return ()


def _staffed(client: Any) -> bool:
    """Is any worker there?"""
    try:
        return bool(client.nthreads())
    except OSError as error:
        raise CancelledError from error


def _result(future: Any, marks: Path, number: int) -> Done | None:
    """How an item ended; None if it has to be submitted again.

    The scheduler counts a worker's death against what only waited there, and may allow fewer than ``attempt`` does.
    """
    from distributed import KilledWorker

    try:
        return future.result()  # type: ignore[no-any-return]
    except KilledWorker:
        lost = at_work(marks, number)
        return Done(lost, given_up=True) if len(lost) >= MOST_LOST else None
    except (ImportError, AttributeError) as error:
        if "twinbench" not in str(error):
            raise
        raise BadInput(f"{_OTHER_CODE.format('a worker')} ({error})") from error


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


@dataclass(frozen=True)
class _Place:
    """What a worker needs to know of the command.

    Attributes:
        here: the folder where it was started; paths are relative to it.
        marks: a folder where its results go.
        source: what ``own_source`` returns there.
    """

    here: Path
    marks: Path
    source: str


@dataclass(frozen=True)
class _Call:
    """Unpickled, it is done: a worker without this Twinbench fails then, and not as it reads what it is sent."""

    arguments: tuple[_Place, int, bytes]

    def __reduce__(self) -> tuple[Any, ...]:
        return _on_worker, self.arguments


def _on_worker(place: _Place, number: int, call: bytes) -> Done:
    who = _settle_in(place.source)
    for path, seen in ((place.here, place.here), (place.marks.parent, place.marks)):
        if not seen.is_dir():
            raise BadInput(f"worker {who} does not see {path} of this machine; use a folder that all of them share")
    try:
        with contextlib.chdir(place.here):
            work, arguments = pickle.loads(call)
            return attempt(place.marks, number, who, lambda: work(*arguments))
    except BadInput as error:
        raise BadInput(f"{error} (worker {who} says so; it has to see all files that the command names)") from error


def _settle_in(source: str) -> str:
    """This worker is of the same code and works alone. Returns who it is."""
    from distributed import get_worker

    worker = get_worker()
    who = f"{worker.address} on {platform.node()}"
    if worker.state.nthreads > 1:
        raise BadInput(f"worker {who} has {worker.state.nthreads} threads; start it with --nthreads 1, and more of it")
    if own_source() != source:
        raise BadInput(_OTHER_CODE.format(f"worker {who}"))
    os.environ[VARIABLE] = "1"
    pin()
    pin_loaded()
    return who
