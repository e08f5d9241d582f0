"""Which tests share a process, and which begin: what is costly is made once, and what lasts longest starts first."""

from __future__ import annotations

from twinbench.common.threads import pin

pin()  # before NumPy: threads of two processes that wait for each other on two cores take three times the work

import pytest  # noqa: E402

LONGEST = ()
"""Groups in the order in which they begin, as measured; what is not listed follows, file by file."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A group of its own for each file that names none, then the longest groups first."""
    rank = {name: k for k, name in enumerate(LONGEST)}
    for item in items:
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(item.path.stem))
    items.sort(key=lambda item: rank.get(_group(item), len(rank)))


def _group(item: pytest.Item) -> str:
    marker = item.get_closest_marker("xdist_group")
    assert marker is not None
    return str(marker.args[0])
