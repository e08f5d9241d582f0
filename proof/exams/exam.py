"""What an exam is: somebody else's questions, what they say is true, and how an answer is marked.

A new exam is one file of this folder that holds ``EXAM = Exam(...)``: a loader, a simulator, the setter's truth and a
score. Nothing else has to be told of it.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import pandas as pd

Advance = Callable[[float], None]
"""Told the share of an exam that is done."""


@dataclass(frozen=True)
class Asked:
    """How an exam is sat.

    Attributes:
        seed: of everything that is drawn.
        data: folder with the setter's files, where they are not part of Twinbench; None if nobody has them.
        only: questions that are asked; all if left out.
    """

    seed: int = 0
    data: Path | None = None
    only: tuple[str, ...] = ()

    def wants(self, question: str) -> bool:
        return not self.only or question in self.only


class Answer(NamedTuple):
    """A question, the setter's answer and ours."""

    question: str
    truth: str
    ours: str
    right: bool
    note: str = ""


class Paper(NamedTuple):
    """An exam that was sat: the answers, and by name what tables it leaves besides."""

    answers: list[Answer]
    tables: Mapping[str, pd.DataFrame]


@dataclass(frozen=True)
class Exam:
    """An exam.

    Attributes:
        name: as commands and folders call it.
        says: what is asked, in words.
        setter: who set it, and under which licence.
        questions: their names, in order.
        sit: gives the answers.
        needs: packages whose versions its answers depend on, beside those that any result does.
    """

    name: str
    says: str
    setter: str
    questions: tuple[str, ...]
    sit: Callable[[Asked, Advance], Paper]
    needs: tuple[str, ...] = ()


def exams() -> dict[str, Exam]:
    """Every exam of this folder, by name."""
    names = sorted(module.name for module in pkgutil.iter_modules([str(Path(__file__).parent)]))
    modules = (importlib.import_module(f"{__package__}.{name}") for name in names if not name.startswith("_"))
    found = (getattr(module, "EXAM", None) for module in modules)
    return {exam.name: exam for exam in found if isinstance(exam, Exam)}


def to_table(name: str, paper: Paper) -> pd.DataFrame:
    """The answers, one a row, with the exam's name."""
    table = pd.DataFrame([answer._asdict() for answer in paper.answers], columns=list(Answer._fields))
    table.insert(0, "exam", name)
    return table


def to_markdown(table: pd.DataFrame) -> str:
    """What a page shows of the answers."""
    lines = ["| exam | question | setter's truth | ours | right | note |", "|---|---|---|---|:---:|---|"]
    for row in table.to_dict("records"):
        cells = [str(row[key]) for key in ("exam", "question", "truth", "ours")]
        lines.append("| " + " | ".join([*cells, "yes" if row["right"] else "no", str(row["note"])]) + " |")
    right = int(table["right"].sum())
    return "\n".join(lines) + f"\n\nRight: {right} of {len(table)}.\n"
