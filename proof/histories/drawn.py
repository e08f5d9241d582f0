"""A machine whose effect changes while it runs, its recordings, and what an ideal observer could tell of the change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from twinbench.data.recording import Recording
from twinbench.data.scenario import stream
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.changes import change_of
from twinbench.proof.concealed.generate import drawn_parameters, drawn_takes
from twinbench.proof.concealed.integrate import Parameters, Steps, run
from twinbench.proof.concealed.machine import Effect, Machine, clock
from twinbench.proof.concealed.machines import machine_of
from twinbench.proof.concealed.record import recorded
from twinbench.proof.concealed.severity import Take, Yardstick
from twinbench.proof.concealed.whiten import whitened

KINDS = ("constant", "ramp", "step")
EFFECTS = {
    "two_tanks": ("leak@h1_cm", "linear_leak@h2_cm", "offset@h2_cm"),
    "motor": ("coulomb_friction@omega_rad_s", "quadratic_friction@omega_rad_s", "constant_drop@current_A"),
}
"""Effects whose size is a number of the catalogue, too."""
SEVERITY = 1.0
BACKGROUND_SHARES = (0.0, 0.002)
"""Ripple that no catalogue has, either as likely."""
GROWS, SHRINKS = (0.5, 1.5), (-0.8, -0.3)
"""By which share of itself a size changes in all, either as likely."""
BEGINS = (0.0, 0.7)
"""Between which shares of the time that may be learnt from a change begins."""
CHUNK = 10
"""Samples for which a size is held."""
UNIFORM = 1.0 / np.sqrt(3.0)
"""sd of what is drawn evenly from -1 to 1."""
FREE_STARTS = 50.0
"""sd of a start state in steps: as good as unknown."""


@dataclass(frozen=True)
class Course:
    """How a size goes: as a share of what it is at first.

    Attributes:
        since_s, until_s: when a change begins, and when all of it is made, on the suite's clock.
    """

    kind: str
    change: float
    since_s: float
    until_s: float

    def factor(self, time_s: float) -> float:
        """What the size is multiplied by at a time on the suite's clock."""
        if self.kind == "ramp":
            return 1.0 + self.change * min(max((time_s - self.since_s) / (self.until_s - self.since_s), 0.0), 1.0)
        return 1.0 + self.change * (time_s >= self.since_s)

    @property
    def told(self) -> float:
        """What is to be told, as a share of the first size: the rate of a ramp per second, what a step changes."""
        return self.change / (self.until_s - self.since_s) if self.kind == "ramp" else self.change


class Drawn(NamedTuple):
    """A case.

    Attributes:
        size: the effect's at first, in its unit; ``course`` what becomes of it.
        learnt, held: recordings.
        ideal_sd: of the change, as a share of it, for whoever knows the truth's equations, and when it began.
        ideal_off: by how much that one's estimate from these readings is off, as a share of the change.
    """

    machine: Machine
    effect: Effect
    size: float
    course: Course
    learnt: list[Recording]
    held: list[Recording]
    ideal_sd: float
    ideal_off: float


def draw(case: int, seed: int) -> Drawn:
    """Draw a case; the same number and seed give the same case."""
    names = [(machine, effect) for machine, effects in EFFECTS.items() for effect in effects]
    name, which = names[case // len(KINDS) % len(names)]
    machine, rng = machine_of(name, seed), stream(seed, "histories", case)
    effect = machine.effect(which)
    takes = drawn_takes(machine, "", rng)
    p = drawn_parameters(machine, "mechanism", 100.0 * float(rng.choice(BACKGROUND_SHARES)), rng)
    quiet = p.copy()
    quiet[machine.at("ripple")] = quiet[machine.at("ambient")] = 0.0
    yardstick = Yardstick(machine, takes, quiet)
    change = change_of(yardstick, effect)
    amplitude = yardstick.scale(change.of, change.start, change.most, SEVERITY)[0]
    course = _course(KINDS[case % len(KINDS)], machine, takes, rng)
    p[machine.at(effect.slot)] = amplitude
    channels, made, noise = (*machine.inputs, *machine.outputs), [], []
    for take in takes:
        y = _clean(machine, take, p, effect.slot, course, machine.fine)
        noisy = recorded(machine, channels, np.concatenate([take.u, y], axis=-1), rng)
        time_s = np.round(take.start_s + np.arange(len(take.u)) * machine.period_s, 6)
        made.append(Recording(take.name, time_s, channels, noisy))
        noise += [] if take.held_out else [noisy[:, len(machine.inputs) :] - y]
    learnt, held = ([r for r, t in zip(made, takes, strict=True) if t.held_out == out] for out in (False, True))
    size = effect.scale * amplitude
    sd, off = _ideal(machine, [t for t in takes if not t.held_out], p, effect.slot, course, noise)
    return Drawn(machine, effect, size, course, learnt, held, sd, off)


def _course(kind: str, machine: Machine, takes: tuple[Take, ...], rng: np.random.Generator) -> Course:
    last = [t for t in takes if not t.held_out][-1]
    until_s = last.start_s + len(last.u) * machine.period_s
    change = float(rng.uniform(*(GROWS if rng.random() < 0.5 else SHRINKS)))
    since_s = float(rng.uniform(*BEGINS)) * until_s
    return Course(kind, 0.0 if kind == "constant" else change, since_s, until_s)


def _clean(
    machine: Machine,
    take: Take,
    p: Array,
    slot: str,
    course: Course,
    substeps: int,
    moved: tuple[int, float] = (-1, 0.0),
) -> Array:
    """Clean readings (N, ny) of a take while a size goes its way.

    Args:
        p: (n_parameters,) the law's own at first, each in its unit.
        moved: a state, and by how much it starts elsewhere, in its unit.
    """
    at, now = machine.at(slot), p.copy()
    time_s = take.start_s + clock(len(take.u) * machine.period_s, machine.period_s)
    now[at] = p[at] * course.factor(take.start_s)
    x, y = machine.settled(take.u, now, take.start_s), []
    if moved[0] >= 0:
        x[moved[0]] += moved[1]
    for k in range(0, len(take.u), CHUNK):
        now[at] = p[at] * course.factor(time_s[k] + 0.5 * CHUNK * machine.period_s)
        # One sample more than is kept: the last one is only read.
        ahead = take.u[k : k + CHUNK + 1]
        steps = Steps(time_s[k], machine.period_s, substeps)
        read, x = run(machine.equations, steps, ahead, x, Parameters.steady(now.copy()))
        y.append(read[:CHUNK])
    return np.concatenate(y)


def _ideal(
    machine: Machine, learnt: Sequence[Take], p: Array, slot: str, course: Course, noise: Sequence[Array]
) -> tuple[float, float]:
    """sd of the change and how far off its estimate is, as shares of it.

    Parameters, starts and the size are free, all else is known.

    Args:
        p: (n_parameters,) the law's own at first, each in its unit.
        noise: of the readings, (N, ny) per take, in the channels' units.
    """
    if course.kind == "constant":
        return 0.0, 0.0
    spread = {n: machine.parameters[n] * s for n, s in machine.spread.items()} | dict(machine.offsets)
    columns, share = [], 0.01
    base = [_clean(machine, t, p, slot, course, machine.coarse) for t in learnt]

    def added(moved_p: Array, its: Course, step: float) -> None:
        several = [_clean(machine, t, moved_p, slot, its, machine.coarse) for t in learnt]
        columns.append(_white(machine, [(y - b) / step for y, b in zip(several, base, strict=True)]))

    for name in machine.calibrate:
        moved = p.copy()
        moved[machine.at(name)] += share * spread[name]
        added(moved, course, share / UNIFORM)
    larger = p.copy()
    larger[machine.at(slot)] *= 1.0 + share
    added(larger, course, share)
    added(p, replace(course, change=course.change * (1.0 + share)), share)
    for r, take in enumerate(learnt):
        for state, step in machine.slow.items():
            y = _clean(machine, take, p, slot, course, machine.coarse, (state, share * step))
            change = [np.zeros_like(b) for b in base]
            change[r] = (y - base[r]) / share * FREE_STARTS
            columns.append(_white(machine, change))
    J = np.stack(columns, axis=1)
    right = J.T @ _white(machine, noise)
    # What is known beforehand of the parameters is their nominal value.
    right[: len(machine.calibrate)] += [
        (machine.parameters[name] - p[machine.at(name)]) / (UNIFORM * spread[name]) for name in machine.calibrate
    ]
    cov, at = np.linalg.inv(J.T @ J + np.eye(J.shape[1])), len(machine.calibrate) + 1
    return float(np.sqrt(cov[at, at])), float(cov[at] @ right)


def _white(machine: Machine, several: Sequence[Array]) -> Array:
    """Changes of all readings, (N, ny) per take, in sds of the noise's innovations, in one row."""
    parts = []
    for y in several:
        for c, name in enumerate(machine.outputs):
            parts.append(whitened(machine.noise[name], machine.lsb[name], machine.period_s, y[:, c]))
    return np.concatenate(parts)
