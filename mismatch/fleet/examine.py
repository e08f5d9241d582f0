"""A fleet examined: its folders read and checked, every machine asked, all of it weighed together and written."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from twinbench.common.documents import made_from, to_json
from twinbench.common.store import check_writable
from twinbench.mismatch.fleet.asking import asked, check_alike
from twinbench.mismatch.fleet.verdict import Fleet, conclude
from twinbench.mismatch.fleet.write import write_fleet
from twinbench.mismatch.report.explain import Request, read


class Examined(NamedTuple):
    """The verdict, and the text of ``fleet.json``."""

    fleet: Fleet
    told: str


def examined(requests: Mapping[str, Request], out: Path) -> Examined:
    """What a fleet says; writes ``fleet.json`` and each machine's own files.

    Raises:
        BadInput: the simulator, a recording or the catalogue cannot be used, or the machines differ in their sensors;
            nothing is written.
    """
    check_alike({name: read(request) for name, request in requests.items()})
    check_writable(out)
    made = made_from(next(iter(requests.values())).settings, _files(requests))
    fleet = conclude(asked(requests, out))
    document = {**fleet.to_dict(), "provenance": made}
    write_fleet(document, out)
    return Examined(fleet, to_json(document))


def _files(requests: Mapping[str, Request]) -> Iterator[dict[str, Any]]:
    """Every file once: the simulator's are read for each machine."""
    seen = set()
    for request in requests.values():
        for file in request.files():
            if file["path"] not in seen:
                seen.add(file["path"])
                yield file
