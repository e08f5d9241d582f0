"""The whole walk: audit, calibrate, screen, refit, test, prove."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from twinbench.common.errors import BadInput
from twinbench.data.recording import Recording
from twinbench.mismatch.calibrate import block_noise, calibrated, is_parameter, own_unknowns
from twinbench.mismatch.checks import Test, audit, residual_tests
from twinbench.mismatch.climb import climb, gross
from twinbench.mismatch.explanation import Explanation, present, refit, rewhitened
from twinbench.mismatch.fit import Problem, solve
from twinbench.mismatch.followed import Followed, told_followed
from twinbench.mismatch.guards import Guards
from twinbench.mismatch.joining import AUTO, LINEAR, Joined, how_joined
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.many import MANY, completed, from_everything
from twinbench.mismatch.model import whole_catalogue
from twinbench.mismatch.noise import ORDER, levels
from twinbench.mismatch.onset import find_onsets, settled_onsets
from twinbench.mismatch.picture import Picture, Variant, picture, variants
from twinbench.mismatch.proof import BorneOut, Gain, Held, Worse, borne_out, gain, held_out, worse_outputs
from twinbench.mismatch.rivals import Rivals, alternatives, losses, nearest, plainest, rivals
from twinbench.mismatch.search import LARGEST, PENALTY, best_sets, local_search
from twinbench.mismatch.spikes import Spike
from twinbench.mismatch.stuck import Stuck, find_stuck, without
from twinbench.mismatch.tracks import Track, prepare
from twinbench.mismatch.transfer import Transfer, transfer
from twinbench.mismatch.visited import resized
from twinbench.mismatch.weigh import Beside, HeldBack, by_chance, contended, plainest_that_predicts, refusal
from twinbench.physics.simulator import Array, Mechanism, Simulator

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


Progress = Callable[[str, float], None]
"""Told a stage's name and the share of it that is done."""


@dataclass(frozen=True)
class Diagnosis:
    """Everything that the walk found, for words, tables and figures.

    Attributes:
        floor: (ny,) least noise of block means, in the outputs' units.
        before: the calibrated original model and its fit.
        tried: explanations fitted in full on the way, best first.
        chosen: the explanation that was accepted, or None.
        rivals: for each effect of ``chosen``, what these data cannot tell from it.
        threshold: gain that noise alone reaches in one of a hundred recordings, or the least gain.
        share: what was gained on held-out recordings; None without any.
        there: is what ``best`` adds to the outputs in the held-out readings.
        transferred: do many sizes together hold on the held-out recordings; None if they are few.
        worse: held-out outputs that ``best`` spoils beyond chance; it is refused then.
        stuck: sensors that stand still; ``tracks`` and ``held`` are without their readings.
        spikes: readings that were taken out, of all recordings.
        joined: how inputs go between samples.
        fitted: everything that was fitted in full under the final noise.
        losses: units that each set of names among it lies behind ``best``, on fitted recordings and, where it is near,
            on those held out too; no effect at all is the empty set.
        weighed_on_held_out: explanations that the held-out recordings were used to choose among.
        followed: how much of each output the accepted simulator explains, or the calibrated one.
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
    worse: tuple[Worse, ...]
    stuck: list[Stuck]
    spikes: tuple[Spike, ...]
    joined: Joined
    fitted: list[Explanation]
    losses: dict[frozenset[str], float]
    weighed_on_held_out: int
    followed: tuple[Followed, ...]

    @property
    def unfollowed(self) -> tuple[Followed, ...]:
        """Outputs that do something which the simulator explains nothing of."""
        return tuple(f for f in self.followed if not f.follows)


def examine(
    simulator: Simulator,
    recordings: Sequence[Recording],
    hold_out: Sequence[Recording] = (),
    catalogue: Sequence[Mechanism] | None = None,
    progress: Progress = lambda stage, share: None,
    guards: Guards = Guards(),
    faults: Sequence[Mechanism] = (),
    inputs: str = AUTO,
) -> Diagnosis:
    """The stages one after the other; ``mismatch.diagnose`` says what it takes."""
    progress = _forward(progress)
    progress("audit", 0.0)
    recordings, hold_out = _split(recordings, hold_out)
    period_s = float(np.median(np.concatenate([np.diff(r.time_s) for r in recordings])))
    listed = whole_catalogue(simulator, (), period_s) if catalogue is None else tuple(catalogue)
    known = {m.name for m in faults}
    listed = tuple(m for m in listed if not (is_parameter(simulator, m) or m.name.startswith("sensor_stuck@")))
    machine = Machine(simulator, [m for m in listed if m.name not in known], faults)
    tracks, held = prepare(recordings, simulator), prepare(hold_out, simulator)
    machine.epoch_s = min(float(t.time_s[0]) for t in tracks)
    for track in (*tracks, *held):
        if len(track.starts) < SHORTEST_BLOCKS:
            raise BadInput(
                f"recording {track.name}: {len(track.time_s)} samples are too few to learn from; record at least "
                f"{SHORTEST_BLOCKS}"
            )
    progress("audit", 0.3)
    try:
        joined = (
            how_joined(machine, tracks, lambda share: progress("audit", 0.3 + 0.6 * share))
            if inputs == AUTO
            else Joined(inputs, "user")
        )
        if joined.inputs == LINEAR:
            tracks, held = ([dataclasses.replace(t, linear=True) for t in some] for some in (tracks, held))
        floor = block_noise(tracks, simulator)
        coarse = machine.settle_step(tracks, floor)
    except ValueError as error:
        raise BadInput(str(error)) from error
    progress("audit", 1.0)

    progress("calibrate", 0.0)
    problem, z, cost = calibrated(machine, tracks, floor, lambda share: progress("calibrate", 0.5 * share))
    followed = _with_followed_spikes(problem, z)
    if any(a is not b for a, b in zip(followed, tracks, strict=True)):
        tracks = followed
        problem, z, cost = calibrated(machine, tracks, floor, lambda share: progress("calibrate", 0.5 + 0.2 * share))
    stuck: list[Stuck] = []
    if found := find_stuck(tracks, problem.residuals(z), floor):
        problem, z, cost = calibrated(machine, without(tracks, found), floor)
        # Where it begins shows best against a fit that has not seen it.
        whole = dataclasses.replace(problem, tracks=tracks, offsets=()).refined(z)
        stuck = find_stuck(tracks, whole.residuals(z), floor) or found
        tracks = without(tracks, stuck)
        problem, z, cost = calibrated(machine, tracks, floor)
    progress("calibrate", 0.8)
    own = own_unknowns(simulator, held)
    held_first = held_out(problem, z, held, own) if held else None
    if held_first is not None:
        held = [t.followed(readings) for t, readings in zip(held, held_first.readings, strict=True)]
        if found := find_stuck(held, held_first.residuals, floor):
            held, stuck = without(held, found), [*stuck, *found]
        noise = levels(problem.residuals(z), held_first.residuals)
        held = [dataclasses.replace(t, level=level) for t, level in zip(held, noise, strict=True)]
    remarks = [*audit([*tracks, *held], simulator), *([coarse] if coarse else [])]
    machine.candidates = resized(machine.candidates, problem, z, period_s)
    choices = variants(machine.candidates)
    progress("calibrate", 1.0)

    before, best, tried, finalists, shown, threshold = _search(problem, z, cost, choices, floor, progress, guards)
    problem, z = before.problem, before.z
    progress("screen", 1.0)
    progress("refit", 1.0)

    progress("prove", 0.0)
    tests = residual_tests(tracks, problem.residuals(z), problem.whitener, floor, simulator)
    back = HeldBack(held, own)
    held_before = held_out(problem, z, held, own, held_first) if held else None
    held_after, share, there, transferred, refused, others = None, None, None, None, "", []
    worse: tuple[Worse, ...] = ()
    fitted, behind, compared = list(tried), {}, 0
    if best is not None:
        if len(best.names) >= MANY and (fuller := completed(best, shown)) is not best:
            best = _again(dataclasses.replace(problem, offsets=best.problem.offsets), fuller)
            shown = _pictured(best.bare, best, choices, progress, TURNS, guards)
        fitted += alternatives(before, best, shown, guards.pairs, lambda share: progress("prove", 0.3 * share))
        if held_before is not None:
            held_after = back.predicted(best)
            proved = contended(
                before, best, fitted, finalists, held_after, back, lambda share: progress("prove", 0.3 + 0.2 * share)
            )
            for turn in range(PROVED):
                progress("prove", 0.5 + 0.4 * turn / PROVED)
                if proved is not best:
                    best = _again(problem, proved)
                    held_after = back.predicted(best, held_after)
                    at = dataclasses.replace(problem, offsets=best.problem.offsets)
                    shown = _pictured(at, best, choices, progress, TURNS, guards)
                    fitted += alternatives(before, best, shown, guards.pairs)
                proved = plainest_that_predicts(before, best, fitted, shown, held_before, held_after, back)
                if proved is best:
                    break
            compared = len(back.asked) if len(back.asked) > 1 else 0
            variance = best.problem.whitener.variance()
            share, there = gain(held_before, held_after, variance), borne_out(held_before, held_after, variance)
            worse = worse_outputs(held_before, held_after, simulator.outputs)
            if len(best.names) >= MANY:
                transferred = transfer(best, held_after, held, own)
        progress("prove", 0.9)
        refused = refusal(share, there, worse) if guards.held_out_gate else ""
        fitted += finalists
        if by_chance(best, before, threshold, refused, share):
            best, held_after, share, there, transferred, refused, worse = None, None, None, None, None, "", ()
        else:
            fitted += nearest(before, best, shown, fitted)
            also = () if held_after is None else (Beside(best, held_after, back).behind,)
            others = rivals(before, best, fitted, *also)
            behind = losses(before, best, fitted, *also)
    chosen = best if best is not None and not refused else None
    held_now = held_after if chosen is not None else held_before
    accepted = chosen or before
    residuals = accepted.problem.residuals(accepted.z) if held_now is None else held_now.residuals
    seen = tracks if held_now is None else held
    followed_by = told_followed(seen, residuals, simulator.outputs, held_now is not None)
    progress("prove", 1.0)
    return Diagnosis(
        simulator,
        machine,
        tracks,
        held,
        remarks,
        floor,
        before,
        shown,
        tests,
        tried,
        chosen,
        best,
        others,
        threshold,
        held_before,
        held_after,
        share,
        there,
        transferred,
        refused,
        worse,
        stuck,
        tuple(s for t in (*tracks, *held) for s in t.spikes),
        joined,
        fitted,
        behind,
        compared,
        followed_by,
    )


def _forward(progress: Progress) -> Progress:
    """Progress that never goes back: a stage that was done is not told of again."""
    told: dict[str, float] = {}

    def report(stage: str, share: float) -> None:
        if told.get(stage, -1.0) < min(share, 1.0):
            told[stage] = min(share, 1.0)
            progress(stage, told[stage])

    return report


def _with_followed_spikes(problem: Problem, z: Array) -> list[Track]:
    """The recordings with those spikes put back that the calibrated simulator follows."""
    return [t.followed(problem.readings(r, z)) if t.spikes else t for r, t in enumerate(problem.tracks)]


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
    problem: Problem,
    z: Array,
    cost: float,
    choices: Sequence[Variant],
    floor: Array,
    progress: Progress,
    guards: Guards,
) -> tuple[Explanation, Explanation | None, list[Explanation], list[Explanation], Picture, float]:
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
        best = from_everything(
            best, problem, choices, 0.3 * floor, lambda share: progress("refit", (TURNS - 1 + share) / (TURNS + 1))
        )
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
    problem: Problem,
    at: Explanation,
    choices: Sequence[Variant],
    progress: Progress,
    turn: int,
    guards: Guards,
) -> Picture:
    steps = len(choices) * len(problem.tracks)
    count = iter(range(steps))
    return picture(
        problem,
        at.z[: len(problem.unknowns)],
        choices,
        present(at),
        lambda: progress("screen", (turn + next(count, steps) / steps) / (TURNS + 1)),
        guards.projection,
    )


def _refitted(
    problem: Problem,
    at: Explanation,
    shown: Picture,
    penalty: float,
    progress: Progress,
    turn: int,
    guards: Guards,
) -> list[Explanation]:
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
