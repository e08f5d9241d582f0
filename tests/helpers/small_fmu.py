"""FMUs written and built here, from equations in C: sources are kept, binaries are not."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from twinbench.physics.fmu.unpack import LONG, SUFFIX

SOURCE = Path(__file__).with_suffix(".c")
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="builds an FMU; install gcc")


@dataclass(frozen=True)
class SmallFMU:
    """What an FMU is to be: names with C expressions in all names, or with values and attributes.

    Attributes:
        states: their rates.
        inputs: where they start.
        outputs: their expressions.
        parameters: their values.
        more: attributes of a variable's Real or Float64, by its name.
        relation: an expression that is looked at at events alone, known to the equations as ``settled``.
        tells: in co-simulation its states can be set, and read with their rates, before it is stepped. If not, it can
            only be stepped.
        starts: then states in which it may be told to start all the same.
    """

    states: Mapping[str, str]
    inputs: Mapping[str, float] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    more: Mapping[str, str] = field(default_factory=dict)
    relation: str = "0"
    jumps: str = "0"
    timetable: int = 0
    status: str = "OK"
    indicators: int = 0
    exchange: str = "ModelExchange"
    tells: bool = True
    starts: tuple[str, ...] = ()
    flags: str = ""

    def build(self, folder: Path, version: int = 2, name: str = "small") -> Path:
        """The FMU's file, built in a folder."""
        inside = folder / f"{name}_{version}"
        where = (
            ("linux64" if sys.platform == "linux" else "darwin64") if version == 2 else f"x86_64-{LONG[sys.platform]}"
        )
        (inside / "binaries" / where).mkdir(parents=True)
        (inside / "equations.h").write_text(self._header(version))
        binary = inside / "binaries" / where / f"{name}{SUFFIX[sys.platform]}"
        command = ["gcc", "-O2", "-shared", "-fPIC", "-I", str(inside), "-o", str(binary), str(SOURCE), "-lm"]
        subprocess.run(command, check=True)
        (inside / "modelDescription.xml").write_text(self._description(version, name))
        file = folder / f"{name}_fmi{version}.fmu"
        with zipfile.ZipFile(file, "w") as archive:
            for path in (inside / "modelDescription.xml", binary):
                archive.write(path, path.relative_to(inside))
        return file

    def _places(self) -> list[str]:
        rates = [f"der({state})" for state in self.states]
        return [*self.states, *rates, *self.inputs, *self.outputs, *self.parameters, "time"]

    def _header(self, version: int) -> str:
        places = self._places()

        def in_c(expression: str) -> str:
            words = sorted((p for p in places if "(" not in p), key=len, reverse=True)
            pattern = "|".join(rf"\b{re.escape(w)}\b" for w in (*words, "settled"))
            return re.sub(
                pattern, lambda m: "m->settled" if m[0] == "settled" else f"m->v[{places.index(m[0])}]", expression
            )

        lines = [f"v[{places.index(o)}] = {in_c(text)};" for o, text in self.outputs.items()]
        lines += [f"v[{places.index(f'der({s})')}] = {in_c(text)};" for s, text in self.states.items()]
        start = [1.0 if p in self.states else self.inputs.get(p, self.parameters.get(p, 0.0)) for p in places]
        sizes = {"NX": self.states, "NU": self.inputs, "NY": self.outputs, "NP": self.parameters}
        defined = {
            "FMI": version, "TOKEN": '"{small}"', **{name: len(group) for name, group in sizes.items()},
            "EQUATIONS": " ".join(lines), "START": f"{{{', '.join(map(repr, start))}}}", "JUMPS": in_c(self.jumps),
            "RELATION": in_c(self.relation), "TIMETABLE": self.timetable, "STATUS": in_c(self.status),
            "CO": int(self.exchange == "CoSimulation"), "TELLS": int(self.tells),
            "SETTABLE": f"{{{', '.join(str(int(s in self.starts)) for s in self.states) or 0}}}",
        }  # fmt: skip
        return "".join(f"#define {name} {value}\n" for name, value in defined.items())

    def _description(self, version: int, name: str) -> str:
        places, lines, rates = self._places(), [], []
        for k, place in enumerate(places[:-1]):
            if not self.tells and (place.startswith("der(") or (place in self.states and place not in self.starts)):
                continue
            causality = next(
                (
                    c
                    for c, group in (("input", self.inputs), ("output", self.outputs), ("parameter", self.parameters))
                    if place in group
                ),
                "local",
            )
            start = {**dict.fromkeys(self.states, 1.0), **self.inputs, **self.parameters}.get(place)
            said = self.more.get(place, "") + (f' start="{start}"' if start is not None else "")
            if place.startswith("der("):
                of = places.index(place[4:-1])
                said += f' derivative="{of + 1 if version == 2 else of}"'
                rates.append(k)
            variability = "fixed" if causality == "parameter" else "continuous"
            common = f'name="{place}" valueReference="{k}" causality="{causality}" variability="{variability}"'
            common += ' initial="exact"' if place in self.starts else ""
            lines.append(
                f"<ScalarVariable {common}><Real {said}/></ScalarVariable>"
                if version == 2
                else f"<Float64 {common} {said}/>"
            )
        if version == 2:
            head = f'fmiVersion="2.0" guid="{{small}}" numberOfEventIndicators="{self.indicators}"'
            listed = "".join(f'<Unknown index="{k + 1}"/>' for k in rates)
            structure = f"<Derivatives>{listed}</Derivatives>"
        else:
            head = 'fmiVersion="3.0" instantiationToken="{small}"'
            structure = "".join(f'<ContinuousStateDerivative valueReference="{k}"/>' for k in rates)
            structure += '<EventIndicator valueReference="0"/>' * self.indicators
        return (
            f'<fmiModelDescription modelName="{name}" {head}><{self.exchange} modelIdentifier="{name}" {self.flags}/>'
            f"<ModelVariables>{''.join(lines)}</ModelVariables><ModelStructure>{structure}</ModelStructure>"
            "</fmiModelDescription>"
        )
