"""The whole walk: audit, calibrate, screen, refit, test, prove."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from data.errors import BadInput
from data.recording import Recording
from mismatch.checks import Test, audit, residual_tests
from mismatch.climb import climb, gross
from mismatch.explanation import Explanation, present, refit, rewhitened
from mismatch.fit import DRIFT_S, KNOTS, NEARLY, Problem, Unknown, solve
from mismatch.guards import Guards
from mismatch.machine import Machine
from mismatch.many import MANY, completed, from_everything
from mismatch.model import whole_catalogue
from mismatch.noise import ORDER, Whitener, levels, noise_floor
from mismatch.onset import find_onsets, settled_onsets
from mismatch.picture import Picture, Variant, picture, variants
from mismatch.proof import BorneOut, Gain, Held, borne_out, gain, held_out
from mismatch.rivals import Rivals, alternatives, plainest, rivals
from mismatch.search import LARGEST, PENALTY, best_sets, local_search
from mismatch.stuck import Stuck, find_stuck, without
from mismatch.tracks import Track, prepare
from mismatch.transfer import Transfer, transfer
from mismatch.visited import resized
from mismatch.weigh import Beside, by_chance, contended, plainest_that_predicts, refusal
from physics.simulator import Array, Mechanism, Simulator

PRIOR = 4.0
"""Prior standard deviation of a parameter or start state, in its scales."""
LEAST_GAIN = 20.0
"""Log-likelihood units (twice) below which nothing is named, whatever the noise would allow."""
TURNS = 8
FINALISTS = 8
"""Explanations of gross errors that are weighed against the best at the end."""
PROVED = 3
"""Times that a plainer explanation than the last is looked for."""
PROMISING = 5
"""Sets that are fitted in full on the way; all at the end, where they may be rivals."""
ON_THE_WAY = 2
"""Rounds of fits that are not the last."""
SHORTEST_BLOCKS = 30
NULL_DRAWS, NULL_INFLATION = 400, 1.3
SPLIT = 0.7
"""Share of a single recording that is learnt from when none is held out."""


@dataclass(frozen=True)
class Diagnosis:
    """Everything that the walk found, for words, tables and figures.

    Attributes:
        before: the calibrated original model and its fit.
        chosen: the explanation that was accepted, or None.
        tried: explanations fitted in full, best first.
        rivals: for each effect of ``chosen``, what these data cannot tell from it.
        threshold: gain that noise alone reaches in one of a hundred recordings, or the least gain.
        share: what was gained on held-out recordings; None without any.
        there: is what ``best`` adds to the outputs in the held-out readings.
        transferred: do many sizes together hold on the held-out recordings; None if they are few.
        stuck: sensors that stand still; ``tracks`` and ``held`` are without their readings.
    """

    simulator: Simulator
    machine: Machine
    tracks: list[Track]
    held: list[Track]
    remarks: list[str]
    floor: Array
    before: Explanation
    shown: Picture
    tests: list[Test]
    tried: list[Explanation]
    chosen: Explanation | None
    best: Explanation | None
    rivals: list[Rivals]
    threshold: float
    held_before: Held | None
    held_after: Held | None
    share: Gain | None
    there: BorneOut | None
    transferred: Transfer | None
    refused: str
    stuck: list[Stuck]


def examine(
    simulator: Simulator,
    recordings: Sequence[Recording],
    hold_out: Sequence[Recording] = (),
    catalogue: Sequence[Mechanism] | None = None,
    progress: Callable[[str, float], None] = lambda stage, share: None,
    guards: Guards = Guards(),
    faults: Sequence[Mechanism] = (),
) -> Diagnosis:
    """The stages one after the other; ``mismatch.diagnose`` says what it takes."""
    progress("audit", 0.0)
    recordings, hold_out = _split(recordings, hold_out)
    period_s = float(np.median(np.concatenate([np.diff(r.time_s) for r in recordings])))
    listed = whole_catalogue(simulator, (), period_s) if catalogue is None else tuple(catalogue)
    known = {m.name for m in faults}
    listed = tuple(m for m in listed if not (_is_parameter(simulator, m) or m.name.startswith("sensor_stuck@")))
    machine = Machine(simulator, [m for m in listed if m.name not in known], faults)
    tracks, held = prepare(recordings, simulator), prepare(hold_out, simulator)
    machine.epoch_s = min(float(t.time_s[0]) for t in tracks)
    for track in (*tracks, *held):
        if len(track.starts) < SHORTEST_BLOCKS:
            raise BadInput(
                f"recording {track.name}: {len(track.time_s)} samples are too few to learn from; record at least "
                f"{SHORTEST_BLOCKS}"
            )
    remarks = audit(tracks, simulator)
    floor = _floor(tracks, simulator)
    try:
        coarse = machine.settle_step(tracks, floor)
    except ValueError as error:
        raise BadInput(str(error)) from error
    remarks += [coarse] if coarse else []

    progress("calibrate", 0.0)
    problem, z, cost = _calibrated(machine, tracks, floor)
    stuck: list[Stuck] = []
    if found := find_stuck(tracks, problem.residuals(z), floor):
        problem, z, cost = _calibrated(machine, without(tracks, found), floor)
        # Where it begins shows best against a fit that has not seen it.
        whole = dataclasses.replace(problem, tracks=tracks, offsets=()).refined(z)
        stuck = find_stuck(tracks, whole.residuals(z), floor) or found
        tracks = without(tracks, stuck)
        problem, z, cost = _calibrated(machine, tracks, floor)
    own = _own(simulator, held)
    held_first = held_out(problem, z, held, own) if held else None
    if held_first is not None and (found := find_stuck(held, held_first.residuals, floor)):
        held, stuck = without(held, found), [*stuck, *found]
    if held_first is not None:
        noise = levels(problem.residuals(z), held_first.residuals)
        held = [dataclasses.replace(t, level=level) for t, level in zip(held, noise, strict=True)]

    machine.candidates = resized(machine.candidates, problem, z, period_s)
    choices = variants(machine.candidates)
    before, best, tried, finalists, shown, threshold = _search(problem, z, cost, choices, floor, progress, guards)
    problem, z = before.problem, before.z

    progress("prove", 0.0)
    tests = residual_tests(tracks, problem.residuals(z), problem.whitener, floor, simulator)
    held_before = held_out(problem, z, held, own, held_first) if held else None
    held_after, share, there, transferred, refused, others = None, None, None, None, "", []
    if best is not None:
        if len(best.names) >= MANY and (fuller := completed(best, shown)) is not best:
            best = _again(dataclasses.replace(problem, offsets=best.problem.offsets), fuller)
            shown = _pictured(best.bare, best, choices, progress, TURNS, guards)
        fitted = [*tried, *alternatives(before, best, shown, guards.pairs)]
        if held_before is not None:
            held_after = held_out(best.problem, best.z, held, own)
            proved = contended(before, best, fitted, finalists, held_after, held, own)
            for _ in range(PROVED):
                if proved is not best:
                    best = _again(problem, proved)
                    held_after = held_out(best.problem, best.z, held, own, held_after)
                    at = dataclasses.replace(problem, offsets=best.problem.offsets)
                    shown = _pictured(at, best, choices, progress, TURNS, guards)
                    fitted += alternatives(before, best, shown, guards.pairs)
                proved = plainest_that_predicts(before, best, fitted, shown, held_before, held_after, held, own)
                if proved is best:
                    break
            variance = best.problem.whitener.variance()
            share, there = gain(held_before, held_after, variance), borne_out(held_before, held_after, variance)
            if len(best.names) >= MANY:
                transferred = transfer(best, held_after, held, own)
        refused = refusal(share, there) if guards.held_out_gate else ""
        if by_chance(best, before, threshold, refused, share):
            best, held_after, share, there, transferred, refused = None, None, None, None, None, ""
        else:
            also = () if held_after is None else (Beside(best, held_after, held, own).behind,)
            others = rivals(before, best, [*fitted, *finalists], *also)
    progress("prove", 1.0)
    chosen = best if best is not None and not refused else None
    return Diagnosis(
        simulator, machine, tracks, held, remarks, floor, before, shown, tests, tried, chosen, best, others,
        threshold, held_before, held_after, share, there, transferred, refused, stuck,
    )  # fmt: skip


def _calibrated(machine: Machine, tracks: list[Track], floor: Array) -> tuple[Problem, Array, float]:
    """The simulator as it came, fitted."""
    unknowns = (*_parameters(machine.simulator), *_own(machine.simulator, tracks))
    problem = Problem(machine, tracks, unknowns, Whitener(np.zeros((len(floor), 0)), floor))
    z, _ = solve(problem, problem.z0, 12, share=NEARLY)
    # What blocks leave out depends on where the fit is.
    problem = problem.refined(z)
    z, _ = solve(problem, z, 4, share=NEARLY)
    # The colour of the noise is learnt last: learnt on the misfit, it would take the misfit for noise.
    problem = rewhitened(problem.refined(z), z, floor, 0)
    return problem, *solve(problem, z, 4)


def _split(
    recordings: Sequence[Recording], hold_out: Sequence[Recording]
) -> tuple[Sequence[Recording], Sequence[Recording]]:
    if hold_out:
        return recordings, hold_out
    if len(recordings) > 1:
        return recordings[:-1], recordings[-1:]
    (only,) = recordings
    cut = int(SPLIT * len(only.time_s))
    return [_piece(only, slice(0, cut), "")], [_piece(only, slice(cut, None), " (end)")]


def _piece(recording: Recording, rows: slice, suffix: str) -> Recording:
    return dataclasses.replace(
        recording, name=recording.name + suffix, time_s=recording.time_s[rows], values=recording.values[rows]
    )


def _is_parameter(simulator: Simulator, mechanism: Mechanism) -> bool:
    """Is the mechanism only a parameter that calibration moves anyway?"""
    if mechanism.term is not None or mechanism.series is not None:
        return False
    return any(v.name in _free(simulator) for v in mechanism.parameters)


def _free(simulator: Simulator) -> tuple[str, ...]:
    return (*simulator.calibrate, *simulator.drifts) or tuple(v.name for v in simulator.parameters)


def _floor(tracks: Sequence[Track], simulator: Simulator) -> Array:
    """Noise (ny,) of block means; at least a ten-thousandth of what the channel does."""
    floor = noise_floor([t.means for t in tracks])
    whole = np.concatenate([t.means for t in tracks])
    scale = np.array([v.scale for v in simulator.outputs])
    span = np.array([np.nanstd(y) if np.isfinite(y).any() else 0.0 for y in whole.T])
    least = 1e-4 * np.where(span > 0, span, scale)
    return np.maximum(np.nan_to_num(floor), least)


def _parameters(simulator: Simulator) -> tuple[Unknown, ...]:
    names = _free(simulator)
    return tuple(
        Unknown(v.name, "parameter", i, v.low, v.high, v.nominal, PRIOR * v.scale, v.scale)
        for i, v in enumerate(simulator.parameters)
        if v.name in names and v.name not in simulator.drifts and v.low < v.high
    )


def _own(simulator: Simulator, tracks: Sequence[Track]) -> tuple[Unknown, ...]:
    """What each recording has for itself: where it starts, and how its drifting parameters go."""
    found = []
    for r, track in enumerate(tracks):
        for i, v in enumerate(simulator.states):
            found.append(
                Unknown(f"start of {v.name}", "start", i, -np.inf, np.inf, 0.0, PRIOR * v.scale, 0.2 * v.scale, r)
            )
        for name in simulator.drifts:
            i = simulator.index(name)
            v = simulator.parameters[i]
            found += [
                Unknown(name, "drift", i, v.low - v.nominal, v.high - v.nominal, 0.0, PRIOR * v.scale, v.scale, r, k)
                for k in range(max(KNOTS, 1 + round((track.time_s[-1] - track.time_s[0]) / DRIFT_S)))
            ]
    return tuple(found)


def null_threshold(shown: Picture, guards: Guards = Guards(), seed: int = 0) -> float:
    """Gain that the best single candidate reaches by noise alone in one of a hundred recordings, inflated."""
    if not guards.nominal_null:
        return float(chi2.isf(0.01, 1))
    rng = np.random.default_rng(seed)
    d = np.diag(shown.G)
    informative = d > 1e-3
    if not informative.any():
        return LEAST_GAIN
    G = shown.G[np.ix_(informative, informative)] / np.sqrt(np.outer(d[informative], d[informative]))
    w, V = np.linalg.eigh(G)
    root = V * np.sqrt(np.maximum(w, 0.0))
    draws = root @ rng.normal(size=(len(w), NULL_DRAWS))
    return max(LEAST_GAIN, NULL_INFLATION * float(np.quantile((draws**2).max(axis=0), 0.99)))


def _search(
    problem: Problem, z: Array, cost: float, choices: Sequence[Variant], floor: Array,
    progress: Callable[[str, float], None], guards: Guards,
) -> tuple[Explanation, Explanation | None, list[Explanation], list[Explanation], Picture, float]:  # fmt: skip
    """Picture, fit what looks best, picture again from there, until nothing changes; then judge with true noise.

    Returns:
        The calibrated model, the best explanation or None, all explanations in the order of merit, those that
        gross errors are explained by nearly as well, the last picture, and the gain that an effect must have.
    """
    order = ORDER if guards.whitening else 0
    before = Explanation((), (), problem, z, cost)
    best, finalists = before, []
    if gross(problem, z, floor):
        climbed = climb(before, choices, guards.pairs, lambda share: progress("screen", share / (TURNS + 1)))
        best, finalists = climbed[0], [e for e in climbed[1:] if e.names][:FINALISTS]
        problem = rewhitened(best.problem, best.z, floor, order, problem)
        best = _again(problem, best)
        problem = dataclasses.replace(problem, offsets=best.problem.offsets)
    for turn in range(0 if finalists else TURNS):
        shown = _pictured(problem, best, choices, progress, turn, guards)
        if best.names and _unchanged(shown, best, guards):
            break
        if not best.names and turn == 0 and (since := find_onsets(problem, best.z, shown)):
            problem = dataclasses.replace(problem, since=since)
            best = before = dataclasses.replace(before, problem=problem)
            shown = _pictured(problem, best, choices, progress, turn, guards)
        found = _refitted(problem, best, shown, PENALTY, progress, turn, guards)
        if not found or not found[0].score(PENALTY) < best.score(PENALTY) - 1.0:
            break
        best = found[0]
        # What is explained no longer counts as noise.
        problem = rewhitened(best.problem, best.z, floor, order, problem)
        best = _again(problem, best, ON_THE_WAY)
        problem = dataclasses.replace(problem, offsets=best.problem.offsets)
        if len(best.names) >= MANY:
            break
    if len(best.names) >= MANY and not finalists:
        # What seems to begin in mid-recording may be another effect that has not been thought of.
        problem = dataclasses.replace(problem, whitener=best.problem.whitener, since=())
        best = from_everything(best, problem, choices, 0.3 * floor)
        problem = dataclasses.replace(problem, since=best.problem.since)
    problem = rewhitened(best.problem, best.z, 0.3 * floor, order, problem)
    if problem.since:
        problem = dataclasses.replace(problem, since=settled_onsets(best.problem, best.z).since)
    best = _again(problem, best)
    before = _again(problem, dataclasses.replace(before, z=z))
    problem = dataclasses.replace(problem, offsets=best.problem.offsets)
    shown = _pictured(problem, best, choices, progress, TURNS, guards)
    threshold = null_threshold(shown, guards)
    # What was climbed to has earned its place by independent readings.
    tried = _refitted(problem, best, shown, threshold, progress, TURNS, guards) if not finalists else []
    if best.names:
        tried.append(best)
    finalists = [_again(problem, e) for e in finalists]
    tried.sort(key=lambda e: e.score(threshold))
    if not tried or not (finalists or tried[0].score(threshold) < before.cost):
        return before, None, tried, finalists, shown, threshold
    if not finalists and plainest(tried) is not best:
        best = _again(problem, plainest(tried))
        tried = [best, *(e for e in tried if e.names != best.names)]
        problem = dataclasses.replace(problem, offsets=best.problem.offsets)
        shown = _pictured(problem, best, choices, progress, TURNS, guards)
    return before, best, tried, finalists, shown, threshold


def _unchanged(shown: Picture, best: Explanation, guards: Guards) -> bool:
    """Would a search from what is there end where it is?"""
    here = tuple(range(len(best.chosen)))
    ends = local_search(shown, here, LARGEST, PENALTY, guards.pairs)
    owners = {shown.variants[i].candidate for i in ends}
    return owners == {v.candidate for v in best.chosen}


def _pictured(
    problem: Problem, at: Explanation, choices: Sequence[Variant], progress: Callable[[str, float], None], turn: int,
    guards: Guards,
) -> Picture:  # fmt: skip
    steps = len(choices) * len(problem.tracks)
    count = iter(range(steps))
    return picture(
        problem, at.z[: len(problem.unknowns)], choices, present(at),
        lambda: progress("screen", (turn + next(count, steps) / steps) / (TURNS + 1)), guards.projection,
    )  # fmt: skip


def _refitted(
    problem: Problem, at: Explanation, shown: Picture, penalty: float, progress: Callable[[str, float], None],
    turn: int, guards: Guards,
) -> list[Explanation]:  # fmt: skip
    """The promising sets fitted, the best of them with its shape parameters free; best first."""
    z = at.z[: len(problem.unknowns)]
    sets = best_sets(shown, LARGEST, penalty, guards.pairs, range(len(at.chosen)))
    if turn < TURNS:
        sets = sorted(sets, key=lambda s: -shown.score(s, penalty))[:PROMISING]
    found = []
    for k, chosen in enumerate(sets):
        progress("refit", (turn + k / len(sets)) / (TURNS + 1))
        found.append((refit(problem, z, shown, chosen), chosen))
    found.sort(key=lambda f: f[0].score(penalty))
    out = [e for e, _ in found]
    if found:
        out[0] = refit(problem, z, shown, found[0][1], rounds=4 if turn == TURNS else ON_THE_WAY)
    return sorted(out, key=lambda e: e.score(penalty))


def _again(problem: Problem, explanation: Explanation, rounds: int = 3) -> Explanation:
    """An explanation fitted again under another noise."""
    moved = dataclasses.replace(explanation.problem, whitener=problem.whitener, since=problem.since)
    moved = moved.refined(explanation.z)
    z, cost = solve(moved, explanation.z, rounds)
    return dataclasses.replace(explanation, problem=moved, z=z, cost=cost)


def residual_chi2(explanation: Explanation) -> tuple[float, float]:
    """Whitened mean square of the residuals, and the largest that noise alone makes in one of a thousand."""
    e = np.concatenate([explanation.problem.whitener(r).ravel() for r in explanation.problem.residuals(explanation.z)])
    e = e[np.isfinite(e)]
    return float(np.mean(e**2)), float(chi2.isf(1e-3, len(e)) / len(e))
