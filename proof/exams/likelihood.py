"""The likelihood of a PEtab problem by our simulator and our fit: what a model selection compares.

A time course is fitted by the engine's own machine and solver (``mismatch.fit``, ``mismatch.solve``). A machine at rest
is fitted by scipy, on the steady state of the same equations.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit, types
from numpy.typing import NDArray
from scipy.optimize import least_squares

from twinbench.common.errors import BadInput
from twinbench.data.formats.holdings import library
from twinbench.mismatch.fit import Problem, Unknown
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.solve import solve
from twinbench.mismatch.tracks import Track
from twinbench.physics.compile import compiled
from twinbench.physics.integrate import MATRIX
from twinbench.physics.jit import FUNCTION, VECTOR
from twinbench.physics.simulator import Array
from twinbench.proof.exams.sbml import conserved, simulator_of

Places = NDArray[np.int64]
Bounds = Sequence[tuple[float, float]]
NETWORK_STEP_S = 0.05
"""A run's steps. Half of it moves no criterion of the exam by a millionth."""
STOP_AT = 1e-5
"""The spread, in an output's unit, that a fit is told. It stops where a step gains less than a share of that, and by so
small a one where the sum of squares is exact."""
REFITS = 3
"""Times that a fit goes on from where it ended, with what its blocks left out corrected there."""
EQUAL_NLL = 1e-4
"""A fit reaches the best if its negative log-likelihood is nearer than this."""
QUOTIENT_STEP = 1e-6
"""Step of a difference quotient of the rates, in the share of a value, or of one where that is more."""
LEAST_READING = 1e-300
"""Of a reading that goes by its logarithm."""
NOTHING = np.empty(0)
"""The inputs of a machine without any."""
STEPS_TO_REST, AT_REST = 50, 1e-12
"""Newton's steps to a steady state at most, and the step at which it is reached."""


class Fitted(NamedTuple):
    """The best of several fits.

    Attributes:
        nllh: its negative log-likelihood; infinite if every run diverged.
        values: of the parameters that were fitted, each in its unit.
        reached, tried: how many fits from random starts end as well, of how many.
    """

    nllh: float
    values: dict[str, float]
    reached: int
    tried: int


class Likelihood:
    """Readings, the simulator that makes them, and their noise.

    Noise is normal with one standard deviation for all readings: a number, or a parameter. One that is free is where
    the likelihood is greatest. Readings are taken as they are, or all by their logarithm.
    """

    def __init__(self, path: Path) -> None:
        """Read a problem.

        Args:
            path: of the YAML file that names its tables and its one SBML model.

        Raises:
            BadInput: PEtab is not installed, or the problem holds what is not read here.
        """
        reader = library("petab.v1", "petab", "exams", path)
        with warnings.catch_warnings(action="ignore"):
            petab = reader.Problem.from_yaml(path)
        self.parameters = petab.parameter_df
        table, observables = petab.measurement_df, petab.observable_df
        self._time_s = table["time"].to_numpy(dtype=np.float64)
        self.read = table["measurement"].to_numpy(dtype=np.float64)
        self._logs = _only(path, observables.get("observableTransformation", ["lin"]), "lin", "log") == "log"
        noise = _only(path, observables["noiseFormula"])
        by_row = _only(path, table["noiseParameters"]) if "noiseParameters" in table else ""
        self._noise = by_row if str(noise).startswith("noiseParameter") else noise
        self._ids = list(dict.fromkeys(table["observableId"]))
        self._which = np.array([self._ids.index(one) for one in table["observableId"]])
        outputs = {one: observables.loc[one, "observableFormula"] for one in self._ids}
        self.simulator = simulator_of(path.parent / petab.model.rel_path, outputs)
        self.at_rest = bool(np.isinf(self._time_s).all())
        if self.at_rest != self._logs:
            raise BadInput(f"{path}: read are time courses as they are and steady states by their logarithm alone")

    def fit(
        self, free: Sequence[str], fixed: Mapping[str, float], first: Mapping[str, float], starts: int, seed: int
    ) -> Fitted:
        """The best of a fit from ``first`` and of so many from random starts within the parameters' bounds.

        Args:
            free: names of the parameters that are fitted.
            fixed: the values of all others, each in its unit.
            first: values that the first fit begins from, of ``free``.
        """
        moved = [name for name in free if name != self._noise]
        theta = self.simulator.theta()
        for name, value in fixed.items():
            if name in (v.name for v in self.simulator.parameters):
                theta[self.simulator.index(name)] = value
        at = np.array([self.simulator.index(name) for name in moved], dtype=np.int64)
        within = [self._bounds(name) for name in moved]
        rng = np.random.default_rng(seed)
        begins = [np.array([first[name] for name in moved])]
        begins += [np.array([self._draw(name, rng) for name in moved]) for _ in range(starts if moved else 0)]
        squares = self._at_rest if self.at_rest else self._in_time
        found = [squares(theta, at, within, begin) for begin in begins]
        nllhs = [self._nllh(ss, free, fixed) for _, ss in found]
        best = int(np.argmin(nllhs))
        values = dict(zip(moved, found[best][0].tolist(), strict=True))
        if self._noise in free:
            values[str(self._noise)] = self._sigma(found[best][1])
        reached = sum(bool(one < nllhs[best] + EQUAL_NLL) for one in nllhs[1:])
        return Fitted(float(nllhs[best]), values, reached, len(nllhs) - 1)

    def _nllh(self, squares: float, free: Sequence[str], fixed: Mapping[str, float]) -> float:
        if not np.isfinite(squares):
            return np.inf
        free_noise = self._noise in free
        sigma = self._sigma(squares) if free_noise else float(fixed.get(str(self._noise), 0.0) or self._noise)
        n = len(self.read)
        jacobian = float(np.sum(np.log(self.read))) if self._logs else 0.0
        return n * np.log(np.sqrt(2.0 * np.pi) * sigma) + 0.5 * squares / sigma**2 + jacobian

    def _sigma(self, squares: float) -> float:
        low, high = self._bounds(str(self._noise))
        return float(np.clip(np.sqrt(squares / len(self.read)), low, high))

    def _bounds(self, name: str) -> tuple[float, float]:
        row = self.parameters.loc[name]
        return float(row["lowerBound"]), float(row["upperBound"])

    def _scale(self, name: str) -> str:
        return str(self.parameters.loc[name, "parameterScale"])

    def middle(self, name: str) -> float:
        """The middle of a parameter's bounds, on its scale."""
        low, high = self._bounds(name)
        return float(np.sqrt(low * high)) if self._scale(name) == "log10" else 0.5 * (low + high)

    def _draw(self, name: str, rng: np.random.Generator) -> float:
        """Evenly within the bounds, on the scale that the table of parameters says."""
        low, high = self._bounds(name)
        if self._scale(name) == "log10":
            return float(10.0 ** rng.uniform(np.log10(low), np.log10(high)))
        return float(rng.uniform(low, high))

    @cached_property
    def _machine(self) -> Machine:
        machine = Machine(self.simulator, [])
        machine.step_s = machine.block_step_s = NETWORK_STEP_S
        return machine

    @cached_property
    def _track(self) -> Track:
        times = np.unique(self._time_s)
        y = np.full((len(times), len(self._ids)), np.nan)
        y[np.searchsorted(times, self._time_s), self._which] = self.read
        return Track("petab", times, np.empty((len(times), 0)), y, np.arange(len(times)), y.copy())

    def _in_time(
        self, theta: Array, at: np.ndarray, within: list[tuple[float, float]], begin: Array
    ) -> tuple[Array, float]:
        """Where the engine's fit ends, and the sum of squares there."""
        spread = np.full(len(self._ids), STOP_AT)
        unknowns = tuple(
            Unknown(self.simulator.parameters[i].name, "parameter", int(i), low, high, z, np.inf, 0.1)
            for i, (low, high), z in zip(at, within, begin, strict=True)
        )
        whole = np.concatenate((theta, self._machine.theta[len(theta) :]))
        problem, z = Problem(self._machine, [self._track], unknowns, spread, theta=whole), begin
        for _ in range(REFITS if len(at) else 0):
            if not np.isfinite(problem.cost(z)):
                return z, np.inf
            problem = problem.refined(z)
            z, _ = solve(problem, z, 30, chords=0)
        off = self._track.y - problem.readings(0, z)
        lost = np.isnan(off) & np.isfinite(self._track.y)
        return z, np.inf if lost.any() else float(np.nansum(off**2))

    @cached_property
    def _means(self) -> tuple[Array, Array, float]:
        """Readings of each output and their mean, and the sum of squares that they have among themselves."""
        read = np.log(self.read)
        groups = [read[self._which == i] for i in range(len(self._ids))]
        within = sum(float(np.sum((g - g.mean()) ** 2)) for g in groups)
        return np.array([float(len(g)) for g in groups]), np.array([g.mean() for g in groups]), within

    @cached_property
    def _kept(self) -> Array:
        """(nx, nx) projection on what is conserved: with it the rates' slopes have an inverse."""
        rows = conserved(self.simulator)
        return np.asarray(rows.T @ rows)

    def _positive(self, x: Array, theta: Array) -> Array:
        """(ny,) readings at rest, above zero, as those that go by their logarithm are."""
        return np.maximum(compiled(self.simulator).output(x, NOTHING, theta), LEAST_READING)

    def _at_rest(
        self, theta: Array, at: np.ndarray, within: list[tuple[float, float]], begin: Array
    ) -> tuple[Array, float]:
        """Where scipy's fit of the steady state ends, by the parameters' logarithms, and the sum of squares there."""
        count, mean, among = self._means
        theta = theta.copy()

        def residuals(logs: Array) -> Array:
            theta[at] = np.exp(logs)
            read = self._positive(self.steady(theta), theta)
            return np.asarray(np.sqrt(count) * (mean - np.log(read)))

        if not len(at):
            return begin, among + float(np.sum(residuals(np.empty(0)) ** 2))
        low, high = (np.log([each[k] for each in within]) for k in (0, 1))
        found = least_squares(
            residuals, np.clip(np.log(begin), low, high), self._slopes(theta, at), bounds=(low, high), **ENOUGH_EXACT
        )
        return np.exp(found.x), among + 2.0 * float(found.cost)

    def steady(self, theta: Array) -> Array:
        """The state (nx,) at which nothing moves any more, with what is conserved as it was at the start.

        Args:
            theta: (n_theta,) the parameters, each in its unit.
        """
        rhs, x0 = compiled(self.simulator).rhs, self.simulator.initial(NOTHING, NOTHING, theta)
        x, kept = x0, self._kept
        for _ in range(STEPS_TO_REST):
            step = np.linalg.solve(quotients(rhs, x, theta, False) + kept, kept @ (x0 - x) - rhs(x, NOTHING, theta))
            x = x + step
            if np.abs(step).max() < AT_REST:
                break
        return np.asarray(x)

    def _slopes(self, theta: Array, at: Places) -> Callable[[Array], Array]:
        """Slopes of the residuals by the parameters' logarithms, by the implicit function."""
        both, (count, _, _) = compiled(self.simulator), self._means

        def jacobian(logs: Array) -> Array:
            theta[at] = np.exp(logs)
            x = self.steady(theta)
            pushed = quotients(both.rhs, x, theta, True)[:, at] * theta[at]
            moved = -np.linalg.solve(quotients(both.rhs, x, theta, False) + self._kept, pushed)
            slopes = quotients(both.output, x, theta, False) @ moved
            return np.asarray(-np.sqrt(count)[:, None] * (slopes / self._positive(x, theta)[:, None]))

        return jacobian


ENOUGH_EXACT: dict[str, Any] = {"ftol": 1e-8, "xtol": 1e-8, "gtol": 1e-8, "max_nfev": 200}
"""scipy's fit stops where a step gains less than this share of the squares, which no criterion shows."""


@njit(MATRIX(FUNCTION, VECTOR, VECTOR, types.boolean), cache=True, error_model="numpy")
def quotients(equation, x, theta, by_theta):  # type: ignore[no-untyped-def]
    """(n, k) difference quotients of an equation (n,) without inputs, by its states or its parameters."""
    nothing = np.empty(0)
    here, at = equation(x, nothing, theta), (theta if by_theta else x).copy()
    found = np.empty((here.size, at.size))
    for i in range(at.size):
        value = at[i]
        step = QUOTIENT_STEP * max(1.0, abs(value))
        at[i] = value + step
        moved = equation(x, nothing, at) if by_theta else equation(at, nothing, theta)
        found[:, i] = (moved - here) / step
        at[i] = value
    return found


def _only(path: Path, values: Any, *known: str) -> str:
    """The one value of a column."""
    found = {str(value) for value in values}
    if len(found) > 1 or (known and not found <= set(known)):
        raise BadInput(f"{path}: noise or scale {sorted(found)} is not read here; only one for all is")
    return found.pop()
