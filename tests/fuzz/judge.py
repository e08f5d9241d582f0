"""What came of a case: one of the orderly ends, or one of those that must not be."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fuzz.answers import ANSWERS, Answer, Nonsense
from fuzz.cases import CLOSE_OR_TOLD, REFUSED, SAME, SAME_OR_REFUSED, TOLD, Case
from fuzz.worker import Ended

GOOD = ("refused", "answered", "not_usable")
BAD = ("traceback", "hang", "nonsense", "unclear", "left_behind")
"""traceback: or a crash. unclear: a refusal that is not one line, or does not name what is at fault.
left_behind: a refusal that changed files, or any end that left one half-written."""
LONGEST_LINE = 2200
"""Characters of a refusal: longer is no line that anybody reads."""
NOT_USABLE = 3
NOTES = (
    " runs code from ", "blanks around column names are left out", "s (rate_Hz = ", "s, stamped at their ",
    "each keeps its own clock",
)  # fmt: skip
"""Said ahead of whatever comes, of a model.toml and of recordings."""
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f]")
HALF_WRITTEN = (".part", ".tmp")


@dataclass(frozen=True)
class Outcome:
    """How a case ended, and for a bad end what is wrong."""

    case: Case
    kind: str
    why: str
    ended: Ended

    @property
    def bad(self) -> bool:
        return self.kind in BAD


Listing = dict[str, tuple[int, int]]


def listing(folder: Path) -> Listing:
    """Every file and folder in it with size and time, but for what Python itself leaves."""
    found = {}
    for path in folder.rglob("*"):
        if "__pycache__" not in path.parts:
            about = path.lstat()
            found[str(path.relative_to(folder))] = (about.st_size, about.st_mtime_ns) if path.is_file() else (0, 0)
    return found


def judge(case: Case, ended: Ended, before: Listing, unspoilt: Callable[[Case], Answer]) -> Outcome:
    """Sort a case by how it ended.

    Args:
        before: what its folder held.
        unspoilt: the answer to the same command line with good input.
    """
    kind, why = _kind(case, ended, before, unspoilt)
    return Outcome(case, kind, why, ended)


def _kind(case: Case, ended: Ended, before: Listing, unspoilt: Callable[[Case], Answer]) -> tuple[str, str]:
    if ended.hung:
        return "hang", f"not done after {ended.seconds:.0f} s"
    if "Traceback (most recent call last)" in ended.err or ended.status < 0:
        return "traceback", (ended.err.strip().splitlines() or [f"signal {-ended.status}"])[-1]
    after = listing(case.folder)
    if half := [name for name in after if name.endswith(HALF_WRITTEN) and name not in before]:
        return "left_behind", f"half-written: {half[0]}"
    if ended.status in (2, NOT_USABLE) and after != before:
        changed = sorted(set(after.items()) ^ set(before.items()))
        return "left_behind", f"exit status {ended.status}, and {changed[0][0]} is new, gone or changed"
    if ended.status == 2:
        return _refused(case, ended)
    if ended.status == NOT_USABLE:
        if case.expects in (SAME, SAME_OR_REFUSED, REFUSED):
            return "nonsense", f"exit status 3 where it must be {case.expects}"
        return "not_usable", ""
    return _answered(case, ended, unspoilt)


def _refused(case: Case, ended: Ended) -> tuple[str, str]:
    lines = ended.err.splitlines()
    said = [line for line in lines if line.startswith("twinbench") and not any(note in line for note in NOTES)]
    if not lines or len(said) != 1 or lines[-1] != said[0]:
        return "unclear", f"a refusal of {len(said)} lines: {ended.err[:300]!r}"
    if len(said[0]) > LONGEST_LINE or CONTROL.search(said[0]):
        return "unclear", f"{len(said[0])} characters, control characters among them or too many: {said[0][:200]!r}"
    if not any(name in said[0] for name in case.names):
        return "unclear", f"names none of {', '.join(case.names)}: {said[0][:300]}"
    if case.expects == SAME:
        return "nonsense", f"refused where nothing is wrong: {said[0][:300]}"
    return "refused", said[0]


def _answered(case: Case, ended: Ended, unspoilt: Callable[[Case], Answer]) -> tuple[str, str]:
    if case.expects == REFUSED:
        return "nonsense", f"exit status {ended.status} where it must be refused"
    try:
        answer = ANSWERS[case.command](case.folder, ended)
        if case.expects in (SAME, SAME_OR_REFUSED):
            answer.same_as(unspoilt(case))
        elif case.expects == TOLD and not answer.told:
            return "nonsense", "a clean answer to input that is wrong"
        elif case.expects == CLOSE_OR_TOLD and not answer.told:
            answer.near(unspoilt(case))
    except Nonsense as why:
        return "nonsense", str(why)
    except Exception as error:  # what it wrote is not what it says it writes
        return "nonsense", f"its files cannot be read: {type(error).__name__}: {error}"[:300]
    return "answered", answer.says
