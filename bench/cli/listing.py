"""``twinbench list``: what there is."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from twinbench.bench.cli.output import tell
from twinbench.bench.cli.parser import SIMULATOR_HELP, add_trust

if TYPE_CHECKING:
    from twinbench.physics.simulator import Mechanism

SAYS = "list estimators, ablations, machines, mechanisms or simulators"
EXAMPLE = "twinbench list estimators --json"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("what", nargs="?", default="estimators", choices=tuple(_LISTS))
    parser.add_argument(
        "--simulator",
        metavar="SIMULATOR",
        help=f"list the mechanisms that mismatch looks for in it, or what the simulator has: {SIMULATOR_HELP}",
    )
    add_trust(parser)


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from twinbench.common.errors import BadInput

    if a.simulator and a.what not in _OF_ONE:
        raise BadInput(f"list {a.what}: --simulator goes with {' or '.join(_OF_ONE)} only; leave it out")
    rows = _OF_ONE[a.what](a.simulator, a.trust) if a.simulator else _LISTS[a.what]()
    if a.json:
        tell(a, rows)
        return 0
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None)
    for column in rows[0] if rows else ():
        table.add_column(column)
    for row in rows:
        table.add_row(*(escape(str(v)) for v in row.values()))
    Console().print(table)
    return 0


def _estimators() -> list[dict[str, Any]]:
    from twinbench.bench.registry import discover
    from twinbench.bench.roster import ordered

    known = discover()
    return [{"name": n, "says": known[n].says, "module": known[n].__module__} for n in ordered(known)]


def _ablations() -> list[dict[str, Any]]:
    from twinbench.bench.registry import discover

    return [
        {"estimator": name, "ablation": ablation, "settings": {k: _finite(v) for k, v in settings.items()}}
        for name, kind in sorted(discover().items())
        for ablation, settings in kind.ablations.items()
    ]


def _finite(setting: Any) -> Any:
    """As it is, or in words: JSON has no infinity."""
    return str(setting) if isinstance(setting, float) and not math.isfinite(setting) else setting


def _mechanisms() -> list[dict[str, Any]]:
    from twinbench.physics.mechanisms import CATALOGUE

    return _said(CATALOGUE)


def _mechanisms_of(spec: str, trust: bool) -> list[dict[str, Any]]:
    from twinbench.mismatch.model import load_simulator, whole_catalogue

    return _said(whole_catalogue(load_simulator(spec, trust)))


def _said(mechanisms: Iterable[Mechanism]) -> list[dict[str, Any]]:
    return [
        {
            "name": m.name,
            "port": str(m.port),
            "parameter": ", ".join(f"{v.name} = {v.nominal:g} {v.unit}" for v in m.parameters),
            "says": m.says,
        }
        for m in mechanisms
    ]


def _simulators() -> list[dict[str, Any]]:
    from twinbench.physics.compressor import PLANT
    from twinbench.physics.nominal import NOMINAL

    return [
        {"name": s.name, "states": len(s.states), "parameters": len(s.parameters), "says": s.says}
        for s in (PLANT, NOMINAL)
    ]


def _variables_of(spec: str, trust: bool) -> list[dict[str, Any]]:
    """What was understood of a simulator: its variables, and what cannot be asked of it."""
    from twinbench.mismatch.model import load_simulator
    from twinbench.mismatch.stepped import CANNOT_BE_ASKED

    simulator, columns = load_simulator(spec, trust), ("name", "unit", "low", "high", "nominal", "scale", "says")
    rows = [
        {"kind": kind, **{c: _finite(getattr(variable, c)) for c in columns}}
        for kind in ("state", "input", "output", "parameter")
        for variable in getattr(simulator, f"{kind}s")
    ]
    if simulator.stepped is not None:
        nothing = dict.fromkeys(columns, "")
        rows.append({"kind": "not told", **nothing, "name": "rates of the states", "says": CANNOT_BE_ASKED})
    return rows


def _machines() -> list[dict[str, Any]]:
    """Of each machine a row for itself, then one for each state, health parameter and channel."""
    from twinbench.machines.load import BUILTIN, load_machine

    rows = []
    for machine in map(load_machine, BUILTIN):
        rows.append({"machine": machine.name, "kind": "", "name": "", "unit": "", "says": machine.says})
        groups = {"state": machine.estimated, "health": machine.health_names}
        groups |= {"input": machine.inputs, "output": machine.outputs}
        for kind, names in groups.items():
            for variable in (machine.variables[name] for name in names):
                about = {"name": variable.name, "unit": variable.unit, "says": variable.says}
                rows.append({"machine": machine.name, "kind": kind, **about})
    return rows


_LISTS = {
    "estimators": _estimators,
    "ablations": _ablations,
    "machines": _machines,
    "mechanisms": _mechanisms,
    "simulators": _simulators,
}
_OF_ONE = {"mechanisms": _mechanisms_of, "simulators": _variables_of}
"""What can be listed of one simulator."""
