"""The contract battery: what every estimator promises, tried on a small simulated benchmark.

A promise is a function of a ``Subject``, an estimator fitted on that benchmark. It returns what it
measured in one line, and raises ``Broken`` where the promise is not kept or ``NotOffered`` where
the estimator does not make it.
"""

from __future__ import annotations

from typing import NamedTuple

from twinbench.bench.contract import diagnostics, faults, filtering, forecasting, learning, stepping
from twinbench.bench.contract.outcome import Broken, NotOffered
from twinbench.bench.contract.promise import DECLARED
from twinbench.bench.contract.subject import Subject
from twinbench.common.threads import pin_torch
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.machine import Machine
from twinbench.methods.estimator import Estimator

__all__ = ["PROMISES", "Result", "Subject", "judge", "run_battery"]

_ORDER = (learning, stepping, faults, diagnostics, forecasting, filtering)
PROMISES = {n: p for module in _ORDER for n, p in DECLARED.items() if p.__module__ == module.__name__}
"""Every promise by its plain-language name, in the order they are tried."""


class Result(NamedTuple):
    """One promise: kept, broken or not made, and what was measured."""

    name: str
    status: str  # pass, fail or skip
    detail: str  # one plain line


def run_battery(kind: type[Estimator], machine: Machine = COMPRESSOR) -> list[Result]:
    """Every promise, tried on one estimator of a machine."""
    subject = Subject(kind, machine)
    return [judge(name, subject) for name in PROMISES]


def judge(name: str, subject: Subject) -> Result:
    """One promise, tried; an exception out of the estimator fails it."""
    pin_torch()
    try:
        return Result(name, "pass", PROMISES[name](subject))
    except NotOffered as reason:
        return Result(name, "skip", str(reason))
    except Broken as fault:
        return Result(name, "fail", str(fault))
    except (Exception, SystemExit) as error:  # who ends Python keeps no promise either
        return Result(name, "fail", f"{type(error).__name__}: {error}".splitlines()[0])
