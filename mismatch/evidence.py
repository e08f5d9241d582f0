"""What a diagnosis holds in evidence, as figures that words and tables can be made of."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinbench.mismatch.diagnosis import Diagnosis
from twinbench.mismatch.explanation import Explanation
from twinbench.mismatch.noise import noise_floor
from twinbench.mismatch.onset import Onset, told_onsets
from twinbench.mismatch.picture import is_fault
from twinbench.mismatch.proof import piece_squares, resamples
from twinbench.mismatch.rivals import NEAR_UNITS
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array, Port

SELDOM = 0.01
"""Probability below which a port is not told."""


class OutputError(NamedTuple):
    """One output's error (rms) sample by sample, of the calibrated and of the mended simulator, in its unit.

    Attributes:
        change_low, change_high: 90 % interval of after minus before, paired over pieces of the recordings.
        noise_sd: of the sensor, by what neighbours differ by: a floor, since noise may remember.
    """

    channel: str
    unit: str
    held_out: bool
    rmse_before: float
    rmse_after: float
    change_low: float
    change_high: float
    noise_sd: float


class FaultAlone(NamedTuple):
    """The faults of sensors or inputs that alone explain most, and the errors (rms) that they leave where they learnt.

    Attributes:
        errors: per output its name, unit, and errors of the calibrated simulator, with the faults, with what was named.
    """

    names: tuple[str, ...]
    errors: tuple[tuple[str, str, float, float, float], ...]


def output_errors(d: Diagnosis) -> tuple[OutputError, ...]:
    """Errors where it learnt, then on what was held out; before is after where nothing was accepted."""
    after = d.chosen or d.before
    whole = [
        (
            False,
            d.tracks,
            learnt_rmse(d.before),
            learnt_rmse(after),
            d.before.problem.residuals(d.before.z),
            after.problem.residuals(after.z),
        )
    ]
    if d.held_before is not None:
        later = d.held_after if d.chosen is not None and d.held_after is not None else d.held_before
        whole.append((True, d.held, d.held_before.rmse, later.rmse, d.held_before.residuals, later.residuals))
    found = []
    for held_out, tracks, rmse_before, rmse_after, before, left in whole:
        for c, v in enumerate(d.simulator.outputs):
            b, a = (piece_squares(residuals, c) for residuals in (before, left))
            if not len(b) or len(a) != len(b):
                continue
            picks = resamples(len(b))
            # The change sample by sample, spread as the blocks' is.
            spread = np.sqrt(a[picks].mean(axis=1)) - np.sqrt(b[picks].mean(axis=1))
            spread += (rmse_after[c] - rmse_before[c]) - (np.sqrt(a.mean()) - np.sqrt(b.mean()))
            low, high = np.quantile(spread, (0.05, 0.95)).tolist()
            noise = _sensor_noise(tracks, [r[:, c : c + 1] for r in left], c)
            found.append(
                OutputError(v.name, v.unit, held_out, float(rmse_before[c]), float(rmse_after[c]), low, high, noise)
            )
    return tuple(found)


def learnt_rmse(e: Explanation) -> Array:
    """Errors (ny,) sample by sample where an explanation learnt."""
    return np.asarray(np.sqrt(np.mean([e.problem.squares(r, e.z) for r in range(len(e.problem.tracks))], axis=0)))


def _sensor_noise(tracks: list[Track], residuals: list[Array], channel: int) -> float:
    """Of single readings, by second differences of themselves or of what is left of block means, whichever is less.

    A sensor that reads in steps has the noise of a step at least.
    """
    readings = [t.y[:, channel : channel + 1] for t in tracks]
    samples = float(np.median(np.concatenate([t.coarse.samples for t in tracks])))
    values = np.unique(np.concatenate(readings))
    steps = np.diff(values[np.isfinite(values)])
    least = float(steps.min()) / np.sqrt(12.0) if len(steps) else 0.0
    noise = min(float(noise_floor(readings)[0]), float(noise_floor(residuals)[0]) * np.sqrt(samples))
    return float(max(noise, least))


def best_fault_alone(d: Diagnosis) -> FaultAlone | None:
    """The best explanation of faults only, beside the accepted one; None if none was fitted or none accepted."""
    candidates = d.machine.candidates
    alone = [e for e in d.fitted if e.names and all(is_fault(candidates[v.candidate]) for v in e.chosen)]
    if d.chosen is None or not alone:
        return None
    best = min(alone, key=lambda e: e.cost)
    outputs = d.simulator.outputs
    errors = zip(*(learnt_rmse(e).tolist() for e in (d.before, best, d.chosen)), strict=True)
    return FaultAlone(best.names, tuple((v.name, v.unit, *e) for v, e in zip(outputs, errors, strict=True)))


def weights(d: Diagnosis) -> dict[frozenset[str], float]:
    """Probability of each set of effects that was fitted in full, no effect at all among them; they sum to one.

    Five times as doubtful as the likelihood is (tempered), since no form is exact and no background modelled whole.
    """
    if not d.losses:
        return {}
    raw = {names: float(np.exp(-max(loss, 0.0) / NEAR_UNITS)) for names, loss in d.losses.items()}
    total = sum(raw.values())
    return {names: w / total for names, w in raw.items()}


def probabilities(d: Diagnosis) -> dict[str, float | None]:
    """Of each accepted effect, over all that was fitted; None where nothing else was fitted in its place."""
    if d.chosen is None:
        return {}
    # What contains an effect can become it, and is no other thing.
    family_of = {c.name: c.family for c in d.machine.candidates}
    chosen = {family_of[name] for name in d.chosen.names}
    weighed = [({family_of[name] for name in names}, w) for names, w in weights(d).items()]
    found = {}
    for name in d.chosen.names:
        rivalled = any(family_of[name] not in families and families - chosen for families, _ in weighed)
        weight = sum(w for families, w in weighed if family_of[name] in families)
        found[name] = min(weight, 1.0) if rivalled else None
    return found


def port_weights(d: Diagnosis) -> tuple[tuple[Port, float], ...]:
    """Ports by the weight of the explanations that have an effect there; more effects than one sum to more than one."""
    port_of = {c.name: c.mechanism.port for c in d.machine.candidates}
    found: dict[Port, float] = {}
    for names, weight in weights(d).items():
        for port in {port_of[name] for name in names}:
            found[port] = found.get(port, 0.0) + weight
    ranked = sorted(found.items(), key=lambda item: -item[1])
    return tuple((port, p) for port, p in ranked if p > SELDOM)


def candidates_for(d: Diagnosis, name: str) -> tuple[tuple[str, ...], ...]:
    """All names that cannot be told from an accepted effect's, its own group first; one group is one thing."""
    if d.chosen is None or name not in d.chosen.names:
        return ()
    groups = d.rivals[d.chosen.names.index(name)].groups
    return tuple(sorted(groups, key=lambda group: name not in group))


def onsets(d: Diagnosis) -> tuple[Onset, ...]:
    """Since when the accepted effects are there, recording by recording; nothing if they are there all the time."""
    since = d.chosen.problem.since if d.chosen is not None else ()
    return told_onsets(since, d.tracks) if since else ()
