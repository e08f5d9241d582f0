"""Reaction networks in SBML as simulators: species are states, and every parameter of the file is one of theirs.

Read are species in concentrations, compartments of constant size, function definitions and kinetic laws. What else a
file may hold, as rules or events, is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.data.formats.holdings import library
from twinbench.physics.compile import compiled
from twinbench.physics.simulator import Array, Equation, Simulator, Variable

UNREAD = ("Rules", "Events", "InitialAssignments", "Constraints")
"""Lists of an SBML model that are not read."""


def simulator_of(path: Path, outputs: Mapping[str, str]) -> Simulator:
    """The simulator of a reaction network. It has no inputs, and starts where the file says.

    Args:
        outputs: by name what each reads, a formula of species and parameters.

    Raises:
        BadInput: no such file, one that libSBML cannot read, or one that holds what is not read here.
    """
    sympy = library("sympy", "sympy", "exams", path)
    model = _model(path)
    species = [s.getId() for s in model.getListOfSpecies()]
    sizes = {c.getId(): c.getSize() for c in model.getListOfCompartments()}
    values = {p.getId(): p.getValue() for p in model.getListOfParameters()}
    names = {name: sympy.Symbol(name) for name in (*species, *sizes, *values)}

    def formula(text: str) -> Any:
        return sympy.sympify(text.replace("^", "**"), locals=names).subs(sizes)

    rates = dict.fromkeys(species, sympy.Integer(0))
    for reaction in model.getListOfReactions():
        law = formula(_text(reaction.getKineticLaw()))
        for side, sign in ((reaction.getListOfReactants(), -1), (reaction.getListOfProducts(), 1)):
            for one in side:
                volume = sizes[model.getSpecies(one.getSpecies()).getCompartment()]
                count = one.getStoichiometry() if one.isSetStoichiometry() else 1.0
                rates[one.getSpecies()] += sign * count * law / volume
    start = np.array([model.getSpecies(name).getInitialConcentration() for name in species])
    places = {name: f"x[{i}]" for i, name in enumerate(species)} | {n: f"theta[{i}]" for i, n in enumerate(values)}
    return Simulator(
        name=model.getId(),
        states=tuple(Variable(name, "1", 0.0, np.inf, float(start[i]), 1.0) for i, name in enumerate(species)),
        inputs=(),
        outputs=tuple(Variable(name, "1", -np.inf, np.inf, 0.0, 1.0) for name in outputs),
        parameters=tuple(Variable(name, "1", -np.inf, np.inf, value, 0.1) for name, value in values.items()),
        rhs=_equation("rhs", list(rates.values()), places),
        output=_equation("output", [formula(text) for text in outputs.values()], places),
        initial=lambda u0, y0, theta: start.copy(),
        says=f"reaction network of {path.name}",
    )


def conserved(simulator: Simulator) -> Array:
    """(n, nx) sums of the states, one a row, that no rate of the network changes, whatever its parameters."""
    rng, n = np.random.default_rng(0), len(simulator.states)
    drawn = rng.uniform(0.1, 1.0, (2 * n, n + len(simulator.parameters)))
    rhs = compiled(simulator).rhs
    rates = np.array([rhs(row[:n].copy(), np.empty(0), row[n:].copy()) for row in drawn])
    _, sizes, rows = np.linalg.svd(rates)
    return rows[np.sum(sizes > 1e-9 * sizes[0]) :]


def _model(path: Path) -> Any:
    libsbml = library("libsbml", "python-libsbml", "exams", path)
    if not path.is_file():
        raise BadInput(f"{path}: no such file")
    document = libsbml.readSBMLFromFile(str(path))
    if document.getNumErrors(libsbml.LIBSBML_SEV_ERROR) or document.getModel() is None:
        raise BadInput(f"{path}: libSBML cannot read it as SBML; mend it")
    expand = libsbml.ConversionProperties()
    expand.addOption("expandFunctionDefinitions", True)
    document.convert(expand)
    model = document.getModel()
    if more := [what for what in UNREAD if getattr(model, f"getNum{what}")()]:
        raise BadInput(f"{path}: holds {more[0]}, which are not read; only reactions are")
    model._document = document  # it dies with what holds it
    return model


def _text(law: Any) -> str:
    import libsbml

    return str(libsbml.formulaToL3String(law.getMath()))


def _equation(name: str, formulas: list[Any], places: Mapping[str, str]) -> Equation:
    """A function of the formulas, as text that numba compiles."""
    import sympy

    symbols = {sympy.Symbol(key): sympy.Symbol(place) for key, place in places.items()}
    entries = ", ".join(sympy.pycode(sympy.sympify(f).subs(symbols)) for f in formulas)
    space: dict[str, Any] = {"np": np, "math": __import__("math")}
    exec(f"def {name}(x, u, theta):\n    return np.array([{entries}], dtype=np.float64)\n", space)
    return space[name]  # type: ignore[no-any-return]
