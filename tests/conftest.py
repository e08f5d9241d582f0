"""Which tests share a process, and which begin: what is costly is made once, and what lasts longest starts first."""

from __future__ import annotations

import fcntl
import gc
import importlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from twinbench.common.threads import pin

pin()  # before NumPy: threads of two processes that wait for each other on two cores take three times the work

import pytest  # noqa: E402
from helpers.documents import checking  # noqa: E402

from twinbench.common import store  # noqa: E402

TOGETHER = (
    ("test_engine", "test_evidence"),
    ("test_mismatch_report", "test_mismatch_page", "test_sheet", "test_layout"),
    ("test_online", "test_export", "test_soak", "test_cycle"),
    ("test_latency", "test_latency_peers", "test_cli", "test_cli_common"),
)
"""Files that share what takes long to make: a verdict on a motor, one on an oven, a trained twin, compiled peers."""
LONGEST = (
    "test_contract", "test_engine", "test_evidence", "test_prove", "test_opponents", "test_latency", "test_fuzz",
    "test_package", "test_real_recordings", "test_tutorial", "test_estimate", "test_additions", "test_notebooks",
    "test_runner",
)  # fmt: skip
"""Files that begin, so that none of them runs on alone at the end.

What trains DeepONet-Kalman comes after several others: it takes long to compile, and test_contract has done so by then.
"""

COMPILED_ON_IMPORT = (
    "twinbench.mismatch.machine", "twinbench.mismatch.sensors", "twinbench.mismatch.series",
    "twinbench.mismatch.tangent", "twinbench.proof.concealed.machines",
)  # fmt: skip
"""What numba compiles when it is imported is in these."""


def pytest_configure(config: pytest.Config) -> None:
    """Of several processes one compiles what is compiled on import. The others wait, and load it."""
    folder = os.environ.get("NUMBA_CACHE_DIR")
    if folder and hasattr(config, "workerinput"):
        Path(folder).mkdir(parents=True, exist_ok=True)
        with open(Path(folder) / "tests.lock", "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            for module in COMPILED_ON_IMPORT:
                importlib.import_module(module)


@pytest.fixture(scope="session", autouse=True)
def _documents_keep_their_schemas() -> Iterator[None]:
    """Whatever a test makes the product write for programs is held against its published schema there and then."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store, "write_atomically", checking(store.write_atomically))
        yield


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    rank = {name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.stem, len(rank)))


def pytest_collection_finish() -> None:
    """What is imported by now stays: no collection of garbage need look at it again, and statsmodels asks for many."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Files by process, in the order of collection."""
    if config.getvalue("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    group = {name: names[0] for names in TOGETHER for name in names}

    class Together(LoadFileScheduling):  # type: ignore[misc]
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            return group.get(file.rpartition("/")[2].removesuffix(".py"), file)

    config.option.loadscopereorder = False
    return Together(config, log)
