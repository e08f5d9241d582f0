"""What every opponent starts from: the simulator calibrated as the engine does it, and what it says in the end."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.data.recording import Recording
from twinbench.mismatch.asked import Asked
from twinbench.mismatch.diagnosis import Fit
from twinbench.mismatch.fit import Unknown
from twinbench.mismatch.machine import Candidate, Machine
from twinbench.mismatch.model import whole_catalogue
from twinbench.mismatch.proof import Held, held_out
from twinbench.mismatch.solve import solve
from twinbench.mismatch.stage_audit import audited
from twinbench.mismatch.stage_calibrate import calibration
from twinbench.mismatch.steps import settle_step
from twinbench.mismatch.stuck import set_aside
from twinbench.mismatch.tracks import Track
from twinbench.mismatch.variants import Variant, switched
from twinbench.physics.simulator import Amplitude, Array, Mechanism, Simulator

Progress = Callable[[str, float], None]


def quiet(stage: str, share: float) -> None:
    """No progress is told."""


@dataclass(frozen=True)
class Plain:
    """The engine's own calibration of a simulator, with nothing in its catalogue.

    Attributes:
        tracks, held: recordings learnt from, and those held out.
        floor: (ny,) noise of block means, in the outputs' units.
        before: the fit; ``held_before`` is how it does on held-out recordings.
    """

    simulator: Simulator
    tracks: list[Track]
    held: list[Track]
    floor: Array
    before: Fit
    held_before: Held


@dataclass(frozen=True)
class Calibrated:
    """A simulator calibrated without any mechanism, and everything that might be missing from it.

    Attributes:
        found: the calibration.
        fit: the same on a machine that holds the whole catalogue, all of it absent.
    """

    found: Plain
    fit: Fit

    @property
    def candidates(self) -> list[Candidate]:
        return self.fit.problem.machine.candidates

    def after(self, sizes: Mapping[Variant, float], again: bool) -> Array:
        """Held-out errors (ny,), sample by sample, with variants switched on.

        Args:
            again: calibrate the parameters anew, the variants being there; they stay as they were otherwise.
        """
        problem, z = self.fit
        theta = problem.theta
        for variant, size in sizes.items():
            theta = switched(problem.machine, theta, variant, size)
        problem = replace(problem, theta=theta)
        z = solve(problem, z)[0] if again else z
        return held_out(problem, z, self.found.held, self.own()).rmse

    def own(self) -> list[Unknown]:
        """What each held-out recording has for itself."""
        one = [u for u in self.fit.problem.unknowns if u.recording == 0]
        return [replace(u, recording=r) for r in range(len(self.found.held)) for u in one]


_LAST: dict[Hashable, Plain] = {}


def calibrate(
    simulator: Simulator, recordings: Sequence[Recording], hold_out: Sequence[Recording], progress: Progress
) -> Plain:
    """The engine's own calibration, from an empty catalogue; arguments as for ``mismatch.diagnose``.

    The last one is kept: where several opponents answer a case in one process, the first pays for all.

    Raises:
        BadInput: as there.
    """
    key = (simulator, *((r.name, r.time_s.tobytes(), r.values.tobytes()) for r in (*recordings, *hold_out)))
    if key not in _LAST:
        seen = audited(Asked(simulator, recordings, hold_out, ()), progress)
        fit = calibration(seen, progress)
        before = Fit(fit.problem, fit.z)
        assert fit.held_first is not None  # an opponent is always given recordings that are held out
        held, _ = set_aside(fit.held, fit.held_first.readings, seen.floor)
        held_before = held_out(*before, held, fit.own, fit.held_first)
        _LAST.clear()
        _LAST[key] = Plain(simulator, fit.tracks, held, seen.floor, before, held_before)
    return _LAST[key]


def calibrated(
    simulator: Simulator,
    recordings: Sequence[Recording],
    hold_out: Sequence[Recording],
    catalogue: Sequence[Mechanism] | None,
    progress: Progress,
) -> Calibrated:
    """As ``calibrate``, with everything that might be missing at hand."""
    found = calibrate(simulator, recordings, hold_out, progress)
    listed = whole_catalogue(simulator) if catalogue is None else tuple(catalogue)
    machine = Machine(simulator, [m for m in listed if not _calibrated(simulator, m)])
    settle_step(machine, found.tracks, found.floor)
    problem = replace(found.before.problem, machine=machine, theta=machine.theta, starts=[])
    return Calibrated(found, Fit(problem, found.before.z))


def check_folds(found: Plain) -> None:
    """Refuse what cannot be cross-validated.

    Raises:
        BadInput: there are fewer than two recordings to learn from.
    """
    if len(found.tracks) < 2:
        raise BadInput("cross validation leaves out one recording at a time; give two or more, and others held out")


def _calibrated(simulator: Simulator, mechanism: Mechanism) -> bool:
    """Is the mechanism only a parameter that calibration moves anyway?"""
    free = simulator.calibrate or tuple(v.name for v in simulator.parameters)
    return isinstance(mechanism, Amplitude) and any(v.name in free for v in mechanism.parameters)


def told(
    found: Plain, says: str, findings: Sequence[Mapping[str, Any]] = (), after: Array | None = None
) -> dict[str, Any]:
    """A verdict like ``Verdict.to_dict()``, as far as a judge reads it.

    Args:
        after: held-out errors (ny,) of the mended simulator, in the outputs' units; those of the calibrated one if left
            out or not finite.
    """
    before = found.held_before.rmse
    kept = before if after is None or not np.isfinite(after).all() else after
    return {
        "verdict": findings[0]["kind"] if findings else "consistent",
        "says": says,
        "findings": list(findings),
        "fit": [
            {"channel": v.name, "held_out": True, "rmse_before": float(b), "rmse_after": float(a)}
            for v, b, a in zip(found.simulator.outputs, before, kept, strict=True)
        ],
    }


def finding(mechanism: Mechanism, size: float, low: float, high: float) -> dict[str, Any]:
    """One mechanism named, with its size and 90 % interval."""
    return {
        "kind": {"physics": "missing physics"}.get(mechanism.kind, "sensor fault"),
        "mechanism": mechanism.name,
        "indistinguishable_from": [],
        "port": str(mechanism.port),
        "ports": [{"port": str(mechanism.port), "probability": 1.0}],
        "since_s": None,
        "parameters": {mechanism.parameters[0].name: {"value": size, "low": low, "high": high}},
    }
