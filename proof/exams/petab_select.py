"""PEtab Select's test problems: which parameters of a reaction network are to be estimated, and which are fixed?

PEtab Select moves through each space of models as its problem says. Every likelihood is ours. What counts is that the
model which the setter expects is found, with the setter's criterion.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import yaml

from twinbench.data.formats.holdings import library
from twinbench.proof.exams.exam import Advance, Answer, Asked, Exam, Paper
from twinbench.proof.exams.likelihood import Fitted, Likelihood

CASES = Path(__file__).parent / "petab_cases"
"""As they are in the source distribution of petab-select 0.4.0."""
PROBLEMS = ("0001", "0002", "0003", "0004", "0005", "0006", "0007", "0008", "0009")
FAMOS = "0009"
FAMOS_STARTS = "0009 from random models"
STARTS = {False: 10, True: 1}
"""Fits from random values beside the first, of a time course and of a machine at rest."""
RANDOM_MODELS = 20
"""Models that FAMoS begins from, one after the other."""
NOISE = 1e-3
"""Criteria that differ by less are the same: tolerances of integration and fit move them as much."""
ESTIMATE = "estimate"


class Calibrated(NamedTuple):
    """A model of a problem's space that was fitted, with its criterion."""

    model: str
    free: tuple[str, ...]
    criterion: float
    fitted: Fitted


class Space:
    """A problem of PEtab Select, and the fits of its models. What was fitted once is not fitted again."""

    def __init__(self, number: str, seed: int, again: bool = True) -> None:
        """Read a problem.

        Args:
            number: of PROBLEMS.
            seed: of everything that is drawn.
            again: is each model fitted from random values too?
        """
        self.path = CASES / number / "petab_select_problem.yaml"
        self.seed, self.again = seed, again
        self._library = library("petab_select", "petab-select", "exams", self.path)
        with warnings.catch_warnings(action="ignore"):
            self.problem = self._library.Problem.from_yaml(self.path)
        self.problem.candidate_space_arguments.pop("summary_tsv", None)  # it would lie where the command is called
        self.criterion = self.problem.criterion
        self.fits: dict[tuple[str, tuple[tuple[str, Any], ...]], Fitted] = {}

    def walked(self, **arguments: Any) -> list[Calibrated]:
        """Every model that the problem's method comes by, in order.

        Args:
            arguments: in the place of the problem's own, as a ``predecessor_model`` that it begins at.
        """
        with warnings.catch_warnings(action="ignore"):
            return self._walked(arguments)

    def _walked(self, arguments: dict[str, Any]) -> list[Calibrated]:
        self.problem.state.reset()
        self.problem.model_space.reset_exclusions()
        space, going = self.problem.new_candidate_space(**arguments), True
        found: list[Calibrated] = []
        while going:
            begun = self._library.ui.start_iteration(problem=self.problem, candidate_space=space)
            models = begun["uncalibrated_models"]
            found += [self._calibrated(model) for model in models]
            ended = self._library.ui.end_iteration(
                problem=self.problem, candidate_space=begun["candidate_space"], calibrated_models=models
            )
            space, going = ended["candidate_space"], not ended["terminate"]
        return found

    def _calibrated(self, model: Any) -> Calibrated:
        free = model.get_estimated_parameter_ids()
        key = str(model.model_subspace_petab_yaml), tuple(sorted(model.parameters.items()))
        likelihood = likelihood_of(Path(model.model_subspace_petab_yaml).resolve())
        if key not in self.fits:
            table = likelihood.parameters
            fixed = {name: float(table.loc[name, "nominalValue"]) for name in table.index}
            fixed |= {name: float(value) for name, value in model.parameters.items() if value != ESTIMATE}
            first = {name: self._first(name, likelihood) for name in free}
            starts = STARTS[likelihood.at_rest] if self.again else 0
            others = {name: value for name, value in fixed.items() if name not in free}
            self.fits[key] = likelihood.fit(free, others, first, starts, self.seed)
        fitted = self.fits[key]
        model.set_criterion(self._library.constants.Criterion.NLLH, fitted.nllh)
        model.set_estimated_parameters(fitted.values)
        criterion = self._criterion(fitted.nllh, len(free), len(likelihood.read))
        model.set_criterion(self.criterion, criterion)
        return Calibrated(str(model.hash), tuple(sorted(free)), criterion, fitted)

    def _criterion(self, nllh: float, free: int, readings: int) -> float:
        """By the library's formulas; the problems have no priors."""
        of = self._library.criteria
        match self.criterion.value:
            case "AIC":
                return float(of.calculate_aic(nllh, free))
            case "AICc":
                return float(of.calculate_aicc(nllh, free, readings, 0))
            case _:
                return float(of.calculate_bic(nllh, free, readings, 0))

    def _first(self, name: str, likelihood: Likelihood) -> float:
        """The largest value that the space fixes a parameter to, or else the middle of its bounds."""
        spaces = self.problem.model_space.model_subspaces.values()
        fixed = [float(v) for space in spaces for v in space.parameters.get(name, ()) if v != ESTIMATE]
        return max(fixed) if fixed else likelihood.middle(name)

    def models(self, count: int) -> Iterator[Any]:
        """Models of the space that are drawn, each parameter as likely free as fixed."""
        rng = np.random.default_rng(self.seed)
        ((name, space),) = self.problem.model_space.model_subspaces.items()
        for _ in range(count):
            yield self.problem.get_model(name, rng.integers(0, 2, len(space.parameters)).tolist())


@cache
def likelihood_of(path: Path) -> Likelihood:
    """That of a PEtab problem; several spaces share one."""
    return Likelihood(path)


def expected(number: str) -> dict[str, Any]:
    """What the setter says is found."""
    found: dict[str, Any] = yaml.safe_load((CASES / number / "expected.yaml").read_text())
    return found


def sit(asked: Asked, advance: Advance) -> Paper:
    """Ask for each problem's model, and how often random beginnings come to that of the largest space."""
    answers, models, starts = [], [], []
    wanted = [name for name in EXAM.questions if asked.wants(name)]
    for k, name in enumerate(wanted):
        if name == FAMOS_STARTS:
            answer, rows = _from_random_models(asked.seed, _part(advance, k, len(wanted)))
            starts += rows
        else:
            answer, rows = _found(name, asked.seed)
            models += rows
        answers.append(answer)
        advance((k + 1) / len(wanted))
    tables = {"models": pd.DataFrame(models), "starts": pd.DataFrame(starts)}
    return Paper(answers, {name: table for name, table in tables.items() if len(table)})


def _part(advance: Advance, k: int, of: int) -> Advance:
    """Tells ``advance`` of the k-th of so many parts."""
    return lambda share: advance((k + share) / of)


def _found(number: str, seed: int) -> tuple[Answer, list[dict[str, Any]]]:
    """The answer to one problem, and a row for each model that was fitted on the way."""
    space, true = Space(number, seed), expected(number)
    walked = space.walked()
    best = min(walked, key=lambda one: one.criterion)
    criterion = space.criterion.value
    apart = best.criterion - true["criteria"][criterion]
    tried = sum(one.fitted.tried for one in walked)
    note = f"{space.problem.method.value}; models fitted: {len(walked)}"
    weights = {one.model: np.exp(0.5 * (best.criterion - one.criterion)) for one in walked}
    if len(weights) > 1:
        note += f"; weight {weights[best.model] / sum(weights.values()):.2f} among {len(weights)} models"
    if tried:
        reached = sum(one.fitted.reached for one in walked)
        note += f"; {100.0 * reached / tried:.0f} % of {tried} random fits reach the best"
    answer = Answer(
        number,
        f"{true['model_hash']}, {criterion} {true['criteria'][criterion]:.6f}",
        f"{best.model}, {criterion} {best.criterion:.6f} (apart {apart:.1e})",
        best.model == true["model_hash"] and abs(apart) < NOISE,
        note,
    )
    rows = [
        {
            "problem": number,
            "model": one.model,
            "free": " ".join(one.free),
            "nllh": one.fitted.nllh,
            criterion: one.criterion,
            "random_fits": one.fitted.tried,
            "reach_best": one.fitted.reached,
        }
        for one in walked
    ]
    return answer, rows


def _from_random_models(seed: int, advance: Advance) -> tuple[Answer, list[dict[str, Any]]]:
    """How often FAMoS ends at the expected model, begun at drawn ones, and a row for each beginning."""
    space, true = Space(FAMOS, seed, again=False), expected(FAMOS)
    least = true["criteria"][space.criterion.value]
    rows = []
    for k, model in enumerate(space.models(RANDOM_MODELS), 1):
        begun = str(model.hash)
        best = min(space.walked(predecessor_model=model), key=lambda one: one.criterion)
        rows.append(
            {
                "begun_at": begun,
                "ended_at": best.model,
                "criterion": best.criterion,
                "above_expected": best.criterion - least,
                "expected_model": best.model == true["model_hash"],
            }
        )
        advance(k / RANDOM_MODELS)
    reached = sum(row["expected_model"] for row in rows)
    nearest = min(row["above_expected"] for row in rows)
    answer = Answer(
        FAMOS_STARTS,
        "usually less than 5 % of starts end at the best model",
        f"{reached} of {len(rows)} starts end there",
        nearest > -NOISE,
        f"none ends below it: the lowest criterion is {nearest:+.1e} from the expected",
    )
    return answer, rows


EXAM = Exam(
    name="petab_select",
    says="which parameters of a small ODE model are there, among up to 2^32 models",
    setter="test problems of PEtab Select 0.4.0 (BSD-3-Clause)",
    questions=(*PROBLEMS, FAMOS_STARTS),
    needs=("petab", "petab-select", "python-libsbml"),
    sit=sit,
)
