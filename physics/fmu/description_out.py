"""``modelDescription.xml`` of an FMU that is written: FMI 2.0, model exchange and co-simulation."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple
from xml.etree import ElementTree as xml

import numpy as np

from twinbench.common.versions import version
from twinbench.physics.fmu.probing import dependences
from twinbench.physics.simulator import Array, Simulator, Variable


class Row(NamedTuple):
    """A variable of the FMU: its name, what FMI calls its kind, and its start in its unit, NaN if it is calculated.

    ``of`` is the state whose rate it is, counted from 1 as FMI counts; 0 if it is no rate.
    """

    name: str
    variable: Variable
    kind: dict[str, str]
    start: float = math.nan
    of: int = 0


STATE = {"causality": "local", "variability": "continuous", "initial": "exact"}
RATE = {"causality": "local", "variability": "continuous"}
INPUT = {"causality": "input", "variability": "continuous"}
OUTPUT = {"causality": "output", "variability": "continuous"}
PARAMETER = {"causality": "parameter", "variability": "tunable"}


def identifier(simulator: Simulator) -> str:
    """The simulator's name as C takes names."""
    return re.sub(r"\W|^(?=\d)", "_", simulator.name, flags=re.ASCII) or "machine"


def description(simulator: Simulator, start: Array, token: str) -> str:
    """The text of the file; variables have the order of the wrapper's: states, rates, inputs, outputs, parameters.

    Args:
        start: (nx,) the states in which it starts, in their units.
        token: by which the binary knows that the description is its own.
    """
    root = xml.Element(
        "fmiModelDescription", fmiVersion="2.0", modelName=simulator.name, guid=token, description=simulator.says,
        generationTool=f"Twinbench {version()}", variableNamingConvention="flat", numberOfEventIndicators="0",
    )  # fmt: skip
    own = {"modelIdentifier": identifier(simulator), "canNotUseMemoryManagementFunctions": "true"}
    xml.SubElement(root, "ModelExchange", own | {"completedIntegratorStepNotNeeded": "true"})
    xml.SubElement(root, "CoSimulation", own | {"canHandleVariableCommunicationStepSize": "true"})
    rows = list(_rows(simulator, start))
    units = xml.SubElement(root, "UnitDefinitions")
    for unit in sorted({row.variable.unit for row in rows} - {"", "1"}):
        xml.SubElement(units, "Unit", name=unit)
    xml.SubElement(xml.SubElement(root, "LogCategories"), "Category", name="logStatusError")
    listed = xml.SubElement(root, "ModelVariables")
    for reference, row in enumerate(rows):
        about = {"name": row.name, "valueReference": str(reference), "description": row.variable.says, **row.kind}
        entry = xml.SubElement(listed, "ScalarVariable", {k: v for k, v in about.items() if v})
        xml.SubElement(entry, "Real", _numbers(row))
    root.append(_structure(simulator))
    xml.indent(root)
    return xml.tostring(root, encoding="unicode", xml_declaration=True)


def _rows(simulator: Simulator, start: Array) -> Iterator[Row]:
    """Every variable; a state or parameter whose name an output or input has is called after its kind, too."""
    taken = {v.name for v in (*simulator.outputs, *simulator.inputs)}

    def free(v: Variable, kind: str) -> str:
        name = v.name
        while name in taken:
            name = f"{kind}.{name}"
        taken.add(name)
        return name

    names = [free(v, "state") for v in simulator.states]
    for v, name, value in zip(simulator.states, names, start, strict=True):
        yield Row(name, v, STATE, float(value))
    for k, name in enumerate(names):
        yield Row(f"der({name})", Variable("", "", -math.inf, math.inf, 0.0), RATE, of=k + 1)
    for v in simulator.inputs:
        yield Row(v.name, v, INPUT, v.nominal)
    for v in simulator.outputs:
        yield Row(v.name, v, OUTPUT)
    for v in simulator.parameters:
        yield Row(free(v, "parameter"), v, PARAMETER, v.nominal)


def _numbers(row: Row) -> dict[str, str]:
    """The attributes of a number, those that say something."""
    v = row.variable
    if row.of:
        return {"derivative": str(row.of)}
    low, high = (v.low, v.high) if math.isnan(row.start) else (min(v.low, row.start), max(v.high, row.start))
    said = {"min": low, "max": high, "nominal": v.scale, "start": row.start}
    unit = {} if v.unit in ("", "1") else {"unit": v.unit}
    return unit | {name: repr(float(value)) for name, value in said.items() if math.isfinite(value)}


def _structure(simulator: Simulator) -> xml.Element:
    """Which variables are outputs and rates, and on which states and inputs they depend."""
    structure = xml.Element("ModelStructure")
    n, n_u, n_y = len(simulator.states), len(simulator.inputs), len(simulator.outputs)
    rates, readings = dependences(simulator)
    known = np.concatenate((np.arange(n), 2 * n + np.arange(n_u))) + 1
    places = {"Outputs": range(2 * n + n_u, 2 * n + n_u + n_y), "Derivatives": range(n, 2 * n)}
    for name, found in (("Outputs", readings), ("Derivatives", rates)):
        listed = xml.SubElement(structure, name)
        for place, on in zip(places[name], found, strict=True):
            xml.SubElement(listed, "Unknown", index=str(place + 1), dependencies=_spaced(known[on]))
    unknown = xml.SubElement(structure, "InitialUnknowns")
    for place in (*range(n, 2 * n), *places["Outputs"]):
        xml.SubElement(unknown, "Unknown", index=str(place + 1))
    return structure


def _spaced(numbers: Sequence[int] | np.ndarray) -> str:
    return " ".join(map(str, numbers))
