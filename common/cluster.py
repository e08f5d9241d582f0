"""Which Dask cluster works for this process, if any. Beside this file, ``spread`` and ``at_worker`` know of Dask."""

from __future__ import annotations

import contextlib
import json
import logging
import os
from collections.abc import Iterator
from contextvars import ContextVar
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from twinbench.common.errors import BadInput

CONNECT_S = 5.0
"""So long a scheduler may take to answer, or a worker that has a result; who takes longer is taken for dead."""
_CLIENT: ContextVar[Any] = ContextVar("client", default=None)


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


def _address(scheduler: str) -> str:
    """What a scheduler file holds, or the address itself."""
    if not (scheduler.endswith(".json") or os.path.exists(scheduler)):
        return scheduler
    try:
        return str(json.loads(Path(scheduler).read_text(encoding="utf-8"))["address"])
    except (OSError, ValueError, LookupError, TypeError) as error:
        says = f"no Dask scheduler in {scheduler}; start one with: dask scheduler --scheduler-file {scheduler}"
        raise BadInput(says) from error


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
