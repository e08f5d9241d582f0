"""The stages of naming: ground, picture, search, onsets, each hypothesis at its own fixed point, what else is there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from twinbench.mismatch.began import STARTS
from twinbench.mismatch.catalogue import positions_of, typical_rates
from twinbench.mismatch.fit import Problem
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.naming.discrepancy import discrepancy
from twinbench.mismatch.naming.effect import Effect
from twinbench.mismatch.naming.ground import Ground
from twinbench.mismatch.naming.marginal import LEARNT
from twinbench.mismatch.naming.misfit import misfit
from twinbench.mismatch.naming.onset import likeliest_forms, with_late
from twinbench.mismatch.naming.picture import LEAST_PROBE, MOST_PROBE, Painter, Picture
from twinbench.mismatch.naming.pruned import Whole, all_at_once, from_elsewhere
from twinbench.mismatch.naming.sets import MOST, Scored
from twinbench.mismatch.naming.settle import HOPELESS, SETTLED, Settled, columns_of, misfit_around, settled
from twinbench.mismatch.naming.steady import squares_beside
from twinbench.mismatch.naming.view import View
from twinbench.mismatch.variants import Variant, typical, variants
from twinbench.mismatch.visited import moved
from twinbench.physics.simulator import Array, Port, Simulator

SINGLES, SETS = 8, 4
"""Hypotheses of one effect, and of several, that are brought to their own fixed point: at a distance the picture is
wrong by tens of nats."""
NEAR = 12.0
"""Nats that a set may lie behind the best, in the picture or at its own fixed point, and still count."""
FAR_OFF, FAR_SINGLES = 3.0, 16
"""Mean square beyond the noise's, in noise variances, from which the calibrated machine is far off: the picture says
little then, and so many single effects are fitted."""
CHANCE = 2.0
"""Sds of a chi-square by which the squares that a set leaves may exceed the noise's share and still be noise alone: one
set in forty that is all there is exceeds it. Such a set costs time, as all the rest is then sought. What other limits
would change was not measured."""
TIMES = 24
"""Parts of a recording between which effects may have begun, where runs are asked for when: a fit finds its way from
half such a part away. What other numbers would change was not measured."""
SHARPENED, SIDES = 3, 6
"""Rounds of looking for the time at which effects began, and times tried to either side, each round closer."""
MOST_EFFECTS = 12
"""Effects that a set may grow to, one at a time."""
ADDED = 3
"""Further effects that are tried beside the best set, each time."""


@dataclass
class Naming:
    """What the recordings say.

    Attributes:
        null: nothing is missing.
        hypotheses: sets at their own fixed points, likeliest first; ``null`` among them.
        painter, picture: all candidates around the calibrated simulator.
        far: is the calibrated machine far off?
        reduced, rivalled: those of which each effect was left out, or replaced by others.
        together: what was left of all physics at once, if that was tried.
        alone: the problem that it was begun with, as long as no other way led as far and no other place was tried.
    """

    ground: Ground
    painter: Painter
    picture: Picture
    null: Settled
    hypotheses: list[Settled] = field(default_factory=list)
    reduced: list[Settled] = field(default_factory=list)
    rivalled: list[Settled] = field(default_factory=list)
    far: bool = False
    together: Settled | None = None
    alone: Problem | None = None
    _around: tuple[Settled, View] | None = None
    _whole: Painter | None = None

    @property
    def best(self) -> Settled:
        """The likeliest hypothesis."""
        return self.hypotheses[0]

    @property
    def explained(self) -> bool:
        """Does the likeliest set leave noise alone, and so little to a discrepancy that no other can be far better?

        Then none is sought far and wide. Half of the squares that a discrepancy explains is what others could gain.
        """
        best, readings = self.best, self.painter.readings
        if not best.effects or best.squares > readings + CHANCE * np.sqrt(2.0 * readings):
            return False
        return squares_beside(best, self.ground)[0] < 2.0 * NEAR

    def of(self, candidates: Sequence[int], since_s: float) -> Settled | None:
        """The hypothesis of these candidates that was weighed, if one was.

        Times at which they began while they were watched are one time, told anew.
        """
        wanted, late = sorted(candidates), since_s > -np.inf
        these = (h for h in self.hypotheses if sorted(h.candidates) == wanted and (h.since_s > -np.inf) == late)
        return next(these, None)

    def around(self, hypothesis: Settled) -> View:
        """The view around where a hypothesis stands, kept until another is asked for, as what is seen in it is.

        Columns of everything take much room.
        """
        if self._around is None or hypothesis is not self._around[0]:
            self._around, self._whole = (hypothesis, View.around(hypothesis.problem, hypothesis.z)), None
        return self._around[1]

    def whole(self, hypothesis: Settled) -> Painter:
        """All variants around where a hypothesis stands, its own effects as they are now among them."""
        view = self.around(hypothesis)
        if self._whole is None:
            probes = {}
            for e in hypothesis.now:
                size = abs(e.size / typical(hypothesis.problem.machine.candidates[e.variant.candidate]))
                probes[e.variant] = min(max(size, LEAST_PROBE), MOST_PROBE)
            listed = dict.fromkeys((*probes, *self.painter.listed))
            self._whole = Painter(
                view,
                self.ground,
                list(listed),
                probes | dict(self.painter.probes),
                hypothesis.wanders,
                hypothesis.share,
                hypothesis.since_s,
            )
        return self._whole

    def without(self, hypothesis: Settled, effect: int) -> Painter:
        """A hypothesis less one effect, with all that could stand in its place, itself first."""
        machine, now = hypothesis.problem.machine, hypothesis.now[effect].variant
        rest = [e.variant.candidate for k, e in enumerate(hypothesis.effects) if k != effect]
        others = [v for v in self.beside(machine, rest) if v != now]
        out = np.concatenate((hypothesis.entries(effect), hypothesis.wandering(effect)))
        return self.whole(hypothesis).less([now, *others], out, len(rest))

    def beside(self, machine: Machine, there: Sequence[int]) -> list[Variant]:
        """Variants of all families but those of some candidates."""
        families = {machine.candidates[c].family for c in there}
        return [v for v in self.painter.listed if machine.candidates[v.candidate].family not in families]

    def settle(self, problem: Problem, z: Array, effects: Sequence[Effect], s: Array) -> None:
        """Bring a hypothesis to its fixed point and keep it in its place; arguments as of ``settled``.

        Args:
            z: (K,) where the problem's unknowns stand, each in its own unit.
            s: (P,) discrepancy to begin with, per cent.
        """
        self.keep(settled(problem, z, effects, self.ground, s, self.far, self.best.log))

    def keep(self, hypothesis: Settled) -> None:
        """Put a settled hypothesis in its place; of several of the same effects the likeliest counts."""
        same = self.of(hypothesis.candidates, hypothesis.since_s)
        if same is not None:
            if same.log >= hypothesis.log:
                return
            self.hypotheses.remove(same)
        self.hypotheses.append(hypothesis)
        self.hypotheses.sort(key=lambda h: -h.log)


def named(problem: Problem, z: Array, floor: Array, progress: Callable[[float], None] = lambda share: None) -> Naming:
    """Weigh everything that may be missing.

    Args:
        problem: the calibrated simulator.
        z: (K,) where the problem's unknowns stand, each in its own unit.
        floor: (ny,) noise of block means by their second differences, in the outputs' units.
    """
    view = View.around(problem, z)
    ground = Ground.learnt(view, discrepancy(view.courses, common(view, moved(problem, view.z))), floor)
    progress(0.2)
    painter = Painter(view, ground, variants(problem.machine.candidates))
    shown = with_late(painter)
    progress(0.4)
    null = settled(problem, z, (), ground, ground.s)
    found = Naming(ground, painter, shown, null, [null])
    found.far = shown.excess > FAR_OFF
    if len(shown.sets.best().key) == MOST:
        _thinned_out(found)
    contenders = _contenders(shown, found.far)
    for k, scored in enumerate(contenders):
        if found.far and found.explained:
            break
        there, sizes = painter.start(shown, scored.key, scored.learnt.s)
        effects = shown.effects(scored.key, sizes)
        found.settle(_since(problem, shown, scored), z if found.far else there, effects, scored.learnt.s)
        progress(0.4 + 0.5 * k / len(contenders))
    if found.best.since_s > -np.inf or (found.far and not found.explained):
        _late(found)
    _sharpened(found)
    steps = (_one_is_not_enough, _another_way, _fuller, _plainer, _rivalled, _sharpened)
    while any(step(found) for step in steps):
        pass
    progress(1.0)
    return found


def _late(found: Naming) -> None:
    """Settle what is as of the beginning once more, from when its runs fit best: from afar columns do not say when."""
    for h in [h for h in found.hypotheses if h.effects and h.since_s == -np.inf]:
        shares = np.arange(1, TIMES) / TIMES
        times = [float(t.time_s[0] + share * np.ptp(t.time_s)) for t in h.problem.tracks for share in shares]
        since_s = _fitting_best(times, h, misfit(h.problem, found.ground, h.learnt.s))
        found.settle(begun(h.bare, since_s), h.own, h.now, h.learnt.s)


def begun(problem: Problem, since_s: float) -> Problem:
    """A problem with effects that begin at one time in all recordings."""
    return replace(problem, since=(since_s,) * len(problem.tracks))


def _fitting_best(times_s: Sequence[float], h: Settled, cost: Callable[[Array, Problem], float]) -> float:
    """The time from which a hypothesis fits best, as it stands."""
    return times_s[int(np.argmin([cost(h.z, begun(h.problem, since_s)) for since_s in times_s]))]


def _sharpened(found: Naming) -> bool:
    """Settle the best hypothesis again, and its near rivals, from when its own fit says that it began; does it help?"""
    best = found.best
    if best.since_s == -np.inf:
        return False
    view = found.around(best)
    cost = misfit_around(best, found.ground, view, columns_of(view, found.ground, best.wanders))
    since, gap = best.since_s, STARTS[0] * max(float(np.ptp(t.time_s)) for t in best.problem.tracks)
    for _ in range(SHARPENED):
        times = [since + gap * k / SIDES for k in range(-SIDES, SIDES + 1)]
        since, gap = _fitting_best(times, best, cost), gap / SIDES
    if abs(since - best.since_s) < gap / SIDES:
        return False
    for h in [h for h in found.hypotheses if h.log > best.log - NEAR and h.since_s == best.since_s]:
        found.settle(begun(h.bare, since), h.own, h.now, h.learnt.s)
    return found.best.log > best.log + SETTLED


def _one_is_not_enough(found: Naming) -> bool:
    """Is it several effects that are likeliest, and are those likelier that are left of all at once?"""
    best = found.best
    if len(best.effects) > 1 and found.together is None and not found.explained:
        _thinned_out(found)
    return found.best is not best


def _thinned_out(found: Naming) -> None:
    """Begin with all physics at once and leave out what is not needed."""
    null, shown, before = found.null, found.picture, found.best
    begun = _since(null.problem, shown, shown.sets.best()) if before is null else before.bare
    end = all_at_once(begun, null.z, all_physics(found), found.ground)
    found.together, found.alone = end, begun if end.log > before.log + LEARNT else None
    found.keep(end)


def _another_way(found: Naming) -> bool:
    """Where only all physics at once led to the likeliest, begin it elsewhere too; does another place lead further?"""
    best, problem, found.alone = found.best, found.alone, None
    if problem is None or best is not found.together or found.explained:
        return False
    for end in from_elsewhere(best, problem, found.null.z, all_physics(found), found.ground):
        found.keep(end)
    return found.best is not best


def all_physics(found: Naming) -> list[Effect]:
    """Each candidate of physics in its likeliest form, one of a family, as it was tried in the picture.

    Also what looks like a parameter under another name from afar: beside the others it may be more than that.
    """
    shown, effects, there = found.picture, [], set()
    for i in likeliest_forms(shown):
        candidate = shown.candidates[i]
        if candidate.mechanism.kind == "physics" and candidate.family not in there:
            there.add(candidate.family)
            effects += shown.effects([i], [found.painter.probes[shown.variants[i]] * typical(candidate)])
    return effects


def _since(problem: Problem, shown: Picture, scored: Scored) -> Problem:
    since = float(shown.since[scored.key[0]]) if scored.key else -np.inf
    return begun(problem, since) if since > -np.inf else problem


def _contenders(shown: Picture, far: bool) -> list[Scored]:
    """Sets that are near in the picture, and single ones even where they are not; none where nothing is the best."""
    known = sorted(shown.sets.known.values(), key=lambda s: -s.log)
    best, nothing = known[0], shown.sets.score(())
    if best is nothing:
        return []
    many, near = (FAR_SINGLES, np.inf) if far else (SINGLES, NEAR)
    singles: dict[object, Scored] = {}
    several: dict[object, Scored] = {}
    for s in known:
        late = bool(s.key and shown.since[s.key[0]] > -np.inf)
        group: object = late, tuple(sorted(shown.names[i] for i in s.key))
        if len(s.key) == 1 and len(singles) < many and s.log > nothing.log - near:
            # From far off the shape that looks best says nothing either.
            singles.setdefault((group, shown.variants[s.key[0]].shape) if far else group, s)
        elif len(s.key) > 1 and len(several) < SETS and s.log > best.log - NEAR and not far:
            several.setdefault(group, s)
    return [*singles.values(), *several.values()]


def _plainer(found: Naming) -> bool:
    """Leave each effect that may be needless out of the best set, from where that is; is something plainer likelier?"""
    best = found.best
    if len(best.effects) < 2 or best in found.reduced:
        return False
    found.reduced.append(best)
    whole = Whole(best, found.ground)
    for i in range(len(best.effects)):
        start = whole.less([i])
        if start.odds > -HOPELESS:
            found.keep(whole.settled_less(start, found.best.log, found.far))
    return found.best is not best


def _fuller(found: Naming) -> bool:
    """Look for one effect more beside the best set; is there one?"""
    best = found.best
    if not 0 < len(best.effects) < MOST_EFFECTS:
        return False
    others = found.beside(best.problem.machine, best.candidates)
    painter = found.whole(best).less(others, np.empty(0, dtype=int), len(best.effects))
    _settle_another(found, best, painter)
    return found.best is not best


def _rivalled(found: Naming) -> bool:
    """Put others in the place of each effect of the best set, in the best's own picture; is one of them likelier?"""
    best = found.best
    if not best.effects or best in found.rivalled:
        return False
    found.rivalled.append(best)
    for i in range(len(best.effects)):
        _settle_another(found, best, found.without(best, i), i)
    return found.best is not best


def _settle_another(found: Naming, best: Settled, painter: Painter, out: int | None = None) -> None:
    """Settle a set with one effect more, or with another in the place of one; those that its own picture says most of.

    Args:
        painter: of the set, less the effect that is replaced.
        out: position of that effect.
    """
    shown = painter.picture()
    gains = shown.sets.quick((), best.learnt.s)
    # What replaces an effect is measured by what that itself does in the picture, where it stands first.
    none, least = (best.log, 0.0) if out is None else (best.log - gains[0], gains.max() - NEAR)
    rest, tried = [c for i, c in enumerate(best.candidates) if i != out], set[int]()
    for k in np.argsort(-gains):
        if not np.isfinite(gains[k]) or gains[k] < least or len(tried) == ADDED:
            break
        candidate = shown.variants[k].candidate
        known = found.of([*rest, candidate], best.since_s)
        if candidate in tried or (known is not None and none + gains[k] < known.log + SETTLED):
            continue
        tried.add(candidate)
        there, sizes = painter.start(shown, [k], best.learnt.s)
        others = [e for i, e in enumerate(best.effects_at(there)) if i != out]
        effects = [*others, *shown.effects([k], sizes)]
        found.settle(best.bare, there[: best.first], effects, best.learnt.s)


def common(view: View, there: Simulator) -> dict[Port, float]:
    """Where something without a name may act, with what commonly acts there.

    Args:
        there: the view's simulator, its scales those of where the machine was.
    """
    simulator = view.problem.machine.simulator
    if simulator.stepped is not None:
        groups = {"output": there.outputs, "input": there.inputs}
        return {Port(place, v.name): v.scale for place, group in groups.items() for v in group}
    exact, rates = set(positions_of(simulator).values()), typical_rates(there)
    found = {Port("balance", v.name): float(rates[i]) for i, v in enumerate(simulator.states) if i not in exact}
    fluxes = zip(simulator.fluxes, common_fluxes(view), strict=True) if simulator.fluxes else ()
    return found | {Port("flux", v.name): float(flux) for v, flux in fluxes}


def common_fluxes(view: View) -> Array:
    """(nf,) what each flux commonly is, in its unit."""
    simulator, course = view.problem.machine.simulator, view.courses[0]
    if simulator.flux is None:
        return np.empty(0)
    theta, n = course.setting.theta[: len(simulator.parameters)], len(simulator.states)
    some = range(0, len(course.u), max(1, len(course.u) // 100))
    return np.sqrt(np.mean([np.square(simulator.flux(course.means[k, :n], course.u[k], theta)) for k in some], axis=0))
