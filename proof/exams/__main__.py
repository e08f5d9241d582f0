"""Exams that others set: ``python -m twinbench.proof.exams`` lists them, and with a name sits one.

python -m twinbench.proof.exams petab_select --out results/exams/petab_select
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from twinbench.common.threads import pin

pin()

from rich.console import Console  # noqa: E402  threads are pinned before NumPy is there

from twinbench.common.errors import BadInput  # noqa: E402
from twinbench.common.progress import Progress  # noqa: E402
from twinbench.common.store import check_writable, write_text  # noqa: E402
from twinbench.common.versions import write_manifest  # noqa: E402
from twinbench.proof.command import refusing  # noqa: E402
from twinbench.proof.exams.exam import Asked, Exam, exams, to_markdown, to_table  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
COMMAND = "python -m twinbench.proof.exams"
HUNDREDTHS = 100
"""Parts in which progress is told."""


@refusing("twinbench.proof.exams")
def main(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    asked = _parser().parse_args(arguments)
    known = exams()
    if asked.exam is None:
        for exam in known.values():
            print(f"{exam.name}: {exam.says}\n  {exam.setter}; {len(exam.questions)} questions")
        return 0
    if asked.exam not in known:
        raise BadInput(f"no exam {asked.exam!r}; there are: {', '.join(known)}")
    exam = known[asked.exam]
    if unknown := [name for name in asked.only if name not in exam.questions]:
        raise BadInput(f"exam {exam.name} has no question {unknown[0]!r}; it has: {', '.join(exam.questions)}")
    out = (asked.out or ROOT / "results" / "exams" / exam.name).absolute()
    check_writable(out)
    _sat(exam, Asked(asked.seed, asked.data, tuple(asked.only)), out)
    return 0


def _sat(exam: Exam, asked: Asked, out: Path) -> None:
    """Sit the exam, and write the answers, its other tables and a manifest."""
    with Progress(Console(stderr=True)) as progress, progress.stage(exam.name, HUNDREDTHS) as going:
        told = 0

        def advance(share: float) -> None:
            nonlocal told
            while told < round(share * HUNDREDTHS):
                going.step()
                told += 1

        paper = exam.sit(asked, advance)
    table = to_table(exam.name, paper)
    for name, more in paper.tables.items():
        write_text(out / f"{name}.csv", more.to_csv(index=False, float_format="%.10g"))
    write_text(out / "answers.csv", table.to_csv(index=False))
    write_text(out / "answers.md", to_markdown(table))
    only = f" --only {' '.join(asked.only)}" if asked.only else ""
    data = " --data FOLDER" if asked.data else ""
    command = f"{COMMAND} {exam.name} --seed {asked.seed}{data}{only}"
    packages = {name: version(name) for name in exam.needs}
    write_manifest(out, command, asked.seed, setter=exam.setter, packages=packages)
    print(to_markdown(table), end="")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=COMMAND, description=(__doc__ or "").splitlines()[0])
    parser.add_argument("exam", nargs="?", help="which one; without it all are listed")
    parser.add_argument("--only", nargs="+", default=[], metavar="QUESTION", help="ask these alone")
    parser.add_argument("--data", type=Path, metavar="FOLDER", help="the setter's recordings, where you have them")
    parser.add_argument("--seed", type=int, default=0, help="of everything that is drawn")
    parser.add_argument("--out", type=Path, help="for the tables; results/exams/EXAM if left out")
    return parser


if __name__ == "__main__":
    sys.exit(main())
