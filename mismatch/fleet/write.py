"""A fleet's files: ``fleet.json`` for programs, and the page."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from twinbench.common.documents import to_json
from twinbench.common.page import Drawing, render, write_bytes, write_figures
from twinbench.common.store import write_text
from twinbench.mismatch.fleet.asking import MACHINES
from twinbench.mismatch.fleet.figures import histories, sizes_by_machine
from twinbench.mismatch.fleet.verdict import Fleet
from twinbench.mismatch.words import listed, probable

MOST_EFFECTS_DRAWN = 6


def write_fleet(document: Mapping[str, Any], out: Path) -> None:
    """Write ``fleet.json``.

    Raises:
        CannotWrite: the folder cannot be written to.
    """
    write_text(out / "fleet.json", to_json(document) + "\n")


def write_fleet_page(fleet: Fleet, simulator: str, out: Path) -> None:
    """Draw ``figures/`` and write ``report.html``.

    Raises:
        CannotWrite: the folder cannot be written to.
    """
    figures = write_figures(out / "figures", _drawn(fleet))
    rows = [
        {"name": name, "link": f"{MACHINES}/{name}/verdict.json", "cells": _cells(fleet, name)}
        for name in fleet.machines
    ]
    page = render(
        Path(__file__).parent / "templates" / "fleet.html.j2",
        headline=fleet.says.rstrip("."),
        simulator=simulator,
        fleet=fleet,
        figures=figures,
        heads=("machine", "unlike the others", "by itself", "findings by itself"),
        rows=rows,
        provenance=[("machines", listed(list(fleet.machines))), ("also written", f"fleet.json, {MACHINES}/")],
    )
    write_bytes(out / "report.html", page.encode())


def _cells(fleet: Fleet, name: str) -> tuple[str, str, str]:
    document = fleet.machines[name].document
    found = [f["mechanism"] or (f"perhaps {f['best']}" if f["best"] else "unnamed") for f in document["findings"]]
    return probable(fleet.odds[name]), document["verdict"], ", ".join(found) or "–"


def _drawn(fleet: Fleet) -> list[Drawing]:
    named = [c.name for c in fleet.common]
    own = [name for o in (*fleet.odd, *fleet.perhaps) for name, _ in o.effects]
    names = list(dict.fromkeys((*named, *own)))[:MOST_EFFECTS_DRAWN]
    missing = "nothing was found in any machine" if not names else ""
    sizes = Drawing(
        "sizes_by_machine",
        "Size from absence of each effect that is shared, or is some machine's own, with its 90 % interval. Line and "
        "band: the fleet's mean, and how far nine of ten machines scatter around it. Red: a machine unlike the others.",
        partial(sizes_by_machine, fleet, names)() if names else None,
        missing,
        "How large on each machine",
    )
    over_time = Drawing(
        "histories",
        f"Size of {names[0]} over time in the recordings that were learnt from, with its 90 % interval, as each "
        "machine's own recordings say. Red: a machine unlike the others."
        if names
        else "Sizes over time.",
        histories(fleet, names[0]) if names else None,
        missing,
        "Machine by machine",
    )
    return [sizes, over_time]
