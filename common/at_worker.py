"""A Dask worker's end of the work: it sees that it can be used, and does one item at a time as a process here would."""

from __future__ import annotations

import contextlib
import functools
import os
import pickle
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twinbench.common.attempts import Done, attempt
from twinbench.common.errors import BadInput
from twinbench.common.jobs import VARIABLE
from twinbench.common.threads import pin, pin_loaded
from twinbench.common.versions import own_source

OTHER_CODE = "{} has not the Twinbench, or the libraries, of this machine; install the same and start it again"


@dataclass(frozen=True)
class Place:
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
class Call:
    """Unpickled, it is done: a worker without this Twinbench fails then, and not as it reads what it is sent."""

    arguments: tuple[Place, int, bytes]

    def __reduce__(self) -> tuple[Any, ...]:
        return _on_worker, self.arguments


def _on_worker(place: Place, number: int, call: bytes) -> Done:
    who = settled(place.source)
    for path, seen in ((place.here, place.here), (place.marks.parent, place.marks)):
        if not seen.is_dir():
            raise BadInput(f"worker {who} does not see {path} of this machine; use a folder that all of them share")
    with contextlib.chdir(place.here):
        work, arguments = pickle.loads(call)
        return attempt(place.marks, number, who, lambda: work(*arguments))


@functools.cache
def settled(source: str) -> str:
    """Once in each worker: it is of the same code and works alone. Returns who it is."""
    from distributed import get_worker

    worker = get_worker()
    who = f"{worker.address} on {platform.node()}"
    if worker.state.nthreads > 1:
        raise BadInput(f"worker {who} has {worker.state.nthreads} threads; start it with --nthreads 1, and more of it")
    if own_source() != source:
        raise BadInput(OTHER_CODE.format(f"worker {who}"))
    os.environ[VARIABLE] = "1"
    pin()
    pin_loaded()
    return who
