"""What ``modelDescription.xml`` says of a Functional Mock-up Unit: FMI 2.0 and 3.0 (https://fmi-standard.org)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as xml

REAL = {"2": "Real", "3": "Float64"}
"""By version, what FMI calls a number."""


@dataclass(frozen=True)
class Scalar:
    """One variable of an FMU.

    Attributes:
        kind: its type in FMI's words; ``array`` of what has dimensions.
        reference: by which calls know it.
        low: lowest value that the FMU promises, in ``unit``; -inf if it says nothing.
        high: highest.
        start: where it starts, in ``unit``; NaN if it is calculated.
        size: FMI's ``nominal``: a typical magnitude, in ``unit``; 0 if it says nothing.
        exact: it starts at ``start``, and may be set to start elsewhere.
    """

    name: str
    kind: str
    reference: int
    causality: str
    variability: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    start: float = math.nan
    size: float = 0.0
    says: str = ""
    exact: bool = False


@dataclass(frozen=True)
class Description:
    """An FMU, as far as a simulator of it needs.

    Attributes:
        version: of FMI, ``2`` or ``3``.
        token: by which the binary knows that this description is its own.
        exchange: its name as a model for exchange; empty if it is none.
        simulates: its name in co-simulation; empty if it does not offer that.
        step_s: of the host, as the FMU proposes; 0 if it says nothing.
        once: one process may hold a single instance of it.
        needs_tool: it runs only where its authoring tool is.
        indicators: how many event indicators it has.
        states: its continuous states, in the order of the calls.
        rates: their derivatives, in the same order.
    """

    version: str
    name: str
    says: str
    token: str
    exchange: str
    simulates: str
    step_s: float
    once: bool
    needs_tool: bool
    indicators: int
    variables: tuple[Scalar, ...]
    states: tuple[Scalar, ...]
    rates: tuple[Scalar, ...]

    @property
    def identifier(self) -> str:
        """The name of its binary: as a model for exchange if it is one."""
        return self.exchange or self.simulates

    @property
    def starts(self) -> tuple[Scalar, ...]:
        """What may be set before it is stepped, beside parameters and inputs: its states, or as many as can be."""
        known = self.states or (*self.of("local"), *self.of("output"))
        return tuple(v for v in known if v.exact and v.variability == "continuous" and v.kind == REAL[self.version])

    def of(self, causality: str) -> tuple[Scalar, ...]:
        """The variables of a causality: input, output or parameter."""
        return tuple(v for v in self.variables if v.causality == causality)


def describe(text: str) -> Description:
    """Read ``modelDescription.xml``.

    Raises:
        ValueError: one line: it is no XML, of another version, or refers to a variable that is not there.
    """
    try:
        root = xml.fromstring(text)
    except xml.ParseError as error:
        raise ValueError(f"modelDescription.xml is no XML: {error}; export the FMU again") from None
    version = root.get("fmiVersion", "")
    if version[:1] not in REAL:
        raise ValueError(f"it is of FMI {version or 'without a version'}; export it as FMI 2.0 or 3.0")
    variables = _variables(root, version[:1])
    model, co = root.find("ModelExchange"), root.find("CoSimulation")
    said = model if model is not None else co if co is not None else xml.Element("none")
    pairs = _states(root, version[:1], variables)
    return Description(
        version=version[:1],
        name=root.get("modelName", ""),
        says=root.get("description", ""),
        token=root.get("guid", root.get("instantiationToken", "")),
        exchange=model.get("modelIdentifier", "") if model is not None else "",
        simulates=co.get("modelIdentifier", "") if co is not None else "",
        step_s=_number(_experiment(root), "stepSize", 0.0),
        once=said.get("canBeInstantiatedOnlyOncePerProcess") == "true",
        needs_tool=said.get("needsExecutionTool") == "true",
        indicators=int(root.get("numberOfEventIndicators", len(root.findall("ModelStructure/EventIndicator")))),
        variables=tuple(variables),
        states=tuple(state for state, _ in pairs),
        rates=tuple(rate for _, rate in pairs),
    )


def _variables(root: xml.Element, version: str) -> list[Scalar]:
    listed, types, found = root.find("ModelVariables"), _types(root), []
    for entry in listed if listed is not None else ():
        value = entry if version == "3" else entry[0]
        said = {**types.get(value.get("declaredType", ""), {}), **value.attrib}
        found.append(
            Scalar(
                name=entry.get("name", ""),
                kind="array" if entry.find("Dimension") is not None else value.tag,
                reference=int(entry.get("valueReference", -1)),
                causality=entry.get("causality", "local"),
                variability=entry.get("variability", "continuous"),
                unit=said.get("unit", ""),
                low=_number(said, "min", -math.inf),
                high=_number(said, "max", math.inf),
                start=_number(said, "start", math.nan),
                size=_number(said, "nominal", 0.0),
                says=entry.get("description", ""),
                exact=entry.get("initial") == "exact" and "start" in said,
            )
        )
    return found


def _experiment(root: xml.Element) -> Mapping[str, str]:
    said = root.find("DefaultExperiment")
    return said.attrib if said is not None else {}


def _types(root: xml.Element) -> dict[str, Mapping[str, str]]:
    """What the types declare that variables refer to."""
    found: dict[str, Mapping[str, str]] = {}
    for declared in root.findall("TypeDefinitions/*"):
        found[declared.get("name", "")] = declared[0].attrib if declared.tag == "SimpleType" else declared.attrib
    return found


def _number(said: Mapping[str, str], name: str, otherwise: float) -> float:
    try:
        return float(said[name])
    except (KeyError, ValueError):
        return otherwise


def _states(root: xml.Element, version: str, variables: Sequence[Scalar]) -> list[tuple[Scalar, Scalar]]:
    """Each state with its rate, as the structure lists them; FMI 2 counts variables from 1, FMI 3 has references.

    For co-simulation FMI 2 need not list them. Then every variable counts that says whose derivative it is.
    """
    listed, pairs = root.find("ModelVariables"), []
    entries = list(listed) if listed is not None else []
    by_reference = {v.reference: k for k, v in reversed(list(enumerate(variables)))}
    path = "Derivatives/Unknown" if version == "2" else "ContinuousStateDerivative"
    try:
        if version == "2":
            at = [int(rate.get("index", 0)) - 1 for rate in root.findall(f"ModelStructure/{path}")]
            for k in at or [k for k, entry in enumerate(entries) if entry[0].get("derivative")]:
                pairs.append((variables[int(entries[k][0].get("derivative", 0)) - 1], variables[k]))
        else:
            for rate in root.findall(f"ModelStructure/{path}"):
                k = by_reference[int(rate.get("valueReference", -1))]
                pairs.append((variables[by_reference[int(entries[k].get("derivative", -1))]], variables[k]))
    except (LookupError, ValueError):
        raise ValueError("its structure names a derivative of no state; export the FMU again") from None
    return pairs
