"""All physics at once, then fewer: several effects that cover each other, and odds that one of them is needless."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motor import MOTOR
from motor_case import record
from scipy.optimize import lsq_linear
from scipy.special import gammaln

from twinbench.mismatch.asked import Asked
from twinbench.mismatch.began import late_odds
from twinbench.mismatch.catalogue import generic
from twinbench.mismatch.naming import pruned
from twinbench.mismatch.naming.effect import Effect
from twinbench.mismatch.naming.marginal import LEARNT
from twinbench.mismatch.naming.name import Naming, all_physics
from twinbench.mismatch.naming.odds import of_number
from twinbench.mismatch.naming.picture import Painter
from twinbench.mismatch.naming.pruned import BEGINNINGS, Whole, all_at_once, from_elsewhere
from twinbench.mismatch.naming.settle import AS_WIDE, Settled, settled
from twinbench.mismatch.naming.view import View, prior_mean
from twinbench.mismatch.naming.weighed import weighed
from twinbench.mismatch.variants import typical

SIZES = {
    "offset@current_A": 60.0,
    "quadratic_loss@current_A": 0.02,
    "coulomb_friction@omega_rad_s": 8.0,
    "offset@T_winding_K": 0.8,
}


def four(t, x, u):
    """Written out here on its own."""
    loss = SIZES["quadratic_loss@current_A"] * x[0] * abs(x[0])
    friction = SIZES["coulomb_friction@omega_rad_s"] * np.tanh(x[1] / 0.5)
    return np.array([SIZES["offset@current_A"] - loss, -friction, SIZES["offset@T_winding_K"]])


@cache
def naming() -> Naming:
    several = [record(f"run {s}", s, four) for s in (1, 2, 3)]
    return weighed(Asked(MOTOR, several[:2], several[2:], generic(MOTOR))).answer.naming


@cache
def left_over() -> Settled:
    null, everything = naming().null, all_physics(naming())
    assert len(everything) > 3 * len(SIZES)
    return all_at_once(null.problem, null.z, everything, naming().ground)


def names(found: Settled) -> list[str]:
    return list(found.names)


def name_in(found: Settled, effect: Effect) -> str:
    return found.problem.machine.candidates[effect.variant.candidate].name


def test_what_is_left_of_all_at_once_is_what_is_there_or_contains_it():
    found = left_over().problem.machine.candidates
    contains = {c.name: c.mechanism.contains or c.name for c in found}
    assert {contains[name] for name in names(left_over())} == set(SIZES)


@pytest.mark.parametrize(
    ("logs", "begun"),
    [([5.0, 4.99], 2), ([1.0, 9.0, 5.0, 8.95], 4), ([1.0, 1.05], 2), (list(np.arange(10) * 2.0 * LEARNT), BEGINNINGS)],
)
def test_all_at_once_is_begun_elsewhere_until_the_two_likeliest_ends_are_one(monkeypatch, logs, begun):
    first, *left = (SimpleNamespace(log=log) for log in logs)
    monkeypatch.setattr(pruned, "all_at_once", lambda *arguments: left.pop(0))
    found = [end.log for end in from_elsewhere(first, SimpleNamespace(unknowns=()), np.empty(0), (), None)]
    assert found == sorted(logs[:begun], reverse=True)


def test_what_is_there_is_the_likeliest_of_all():
    found = naming().best
    assert set(names(found)) == set(SIZES)
    for name, size, sd in zip(names(found), found.sizes, found.sds, strict=True):
        assert size == pytest.approx(SIZES[name], abs=3.0 * sd)
        assert sd < 0.3 * SIZES[name]


def test_the_odds_of_an_effects_absence_are_the_evidence_without_it():
    exact = naming().ground.exact
    found = left_over()
    more = [e for e in all_physics(naming()) if name_in(found, e) == "offset@omega_rad_s"]
    whole = settled(found.bare, found.own, [*found.now, *more], exact, exact.s)
    needless = names(whole).index("offset@omega_rad_s")
    fewer = settled(whole.bare, whole.own, whole.now[:needless], exact, exact.s)
    odds = [Whole(whole, exact).less([k]).odds for k in range(len(whole.effects))]
    assert odds[needless] == pytest.approx(fewer.log - whole.log, abs=1.0)
    assert max(np.delete(odds, needless)) < -5.0


def test_on_an_exact_ground_the_sizes_of_effects_are_the_same_everywhere():
    found, exact = left_over(), naming().ground.exact
    again = settled(found.bare, found.own, found.now, exact, exact.s)
    assert len(again.mean) == len(again.z)


def test_beside_a_discrepancy_the_odds_are_those_with_it_learnt_anew():
    found, ground = left_over(), naming().ground
    more = [e for e in all_physics(naming()) if name_in(found, e) == "offset@omega_rad_s"]
    whole = settled(found.bare, found.own, [*found.now, *more], ground, ground.s)
    fewer = settled(whole.bare, whole.own, whole.now[:-1], ground, whole.learnt.s)
    last = len(whole.effects) - 1
    assert Whole(whole, ground).less([last]).odds == pytest.approx(fewer.log - whole.log, abs=1.5)


def test_a_set_less_an_effect_begins_near_where_it_comes_to_rest():
    """Without the loss the others have to move: they begin moved, not where they were."""
    found, ground = left_over(), naming().ground
    out = names(found).index("quadratic_loss@current_A")
    begun = Whole(found, ground).less([out])
    rest = settled(found.bare, begun.own, begun.effects, ground, found.learnt.s)
    stayed = [e for k, e in enumerate(found.now) if k != out]

    def off(effects, own):
        sizes = [abs(a.size - b.size) / sd for a, b, sd in zip(effects, rest.now, rest.sds, strict=True)]
        scales = rest.bare.spreads
        return max(*sizes, *(abs(own - rest.own) / scales))

    assert off(begun.effects, begun.own) < 0.5 * off(stayed, found.own)


def test_an_effect_and_the_unknowns_begin_where_least_squares_puts_them():
    known, exact = naming().painter, naming().ground.exact
    painter = Painter(known.view, exact, known.listed, probes=known.probes)
    shown = painter.picture()
    i = shown.names.index("offset@current_A")
    z, (size,) = painter.start(shown, [i], exact.s)
    view, mean = painter.view, prior_mean(painter.view)
    own, tried = view.unknowns(), view.of_variants([shown.variants[i]], np.array([known.probes[shown.variants[i]]]))
    unit = shown.units[i] / abs(typical(shown.candidates[i]))
    columns = [np.concatenate((a, b * unit), axis=2) for a, b in zip(own, tried, strict=True)]
    white = np.concatenate([exact.whitened(r, c, view.residuals[r]) for r, c in enumerate(columns)])
    many = len(mean) + 1
    left, right = np.vstack((white[:, :-1], np.eye(many))), np.concatenate((white[:, -1], mean, [0.0]))
    unknowns, scales = view.problem.unknowns, view.problem.spreads
    ends = np.array([[u.low, u.high] for u in unknowns]).T - view.z
    low, high = (np.append(side / scales, end) for side, end in zip(ends, (-np.inf, np.inf), strict=True))
    step = lsq_linear(left, right, (low, high), method="bvls").x
    assert size == pytest.approx(step[-1] * shown.units[i], rel=1e-4)
    assert (z - view.z) / scales == pytest.approx(step[:-1], rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("times", [0.3, 30.0])
def test_a_prior_that_is_far_too_narrow_or_wide_becomes_as_wide_as_its_effect_is_large(times):
    found, ground = left_over(), naming().ground
    told = [replace(e, sd=times * abs(e.size), least_sd=1e-6 * abs(e.size)) for e in found.now]
    again = settled(found.bare, found.own, told, ground, found.learnt.s)
    assert sorted(names(again)) == sorted(names(found))
    for e, size in zip(again.effects, again.sizes, strict=True):
        assert abs(size) / AS_WIDE <= e.sd <= AS_WIDE * abs(size)
    assert again.sizes == pytest.approx(found.sizes, abs=float(3.0 * found.sds.max()))


@given(candidates=st.integers(1, 80))
def test_any_number_of_effects_is_as_likely_as_any_other(candidates):
    each = np.log(1.0 / candidates)
    logs = [
        gammaln(candidates + 1) - gammaln(k + 1) - gammaln(candidates - k + 1) + k * each for k in range(candidates)
    ]
    number = [of_number(k, candidates) for k in range(candidates)]
    assert np.add(logs, number) == pytest.approx(np.zeros(candidates), abs=1e-9)
    assert of_number(1, candidates) == pytest.approx(0.0, abs=1e-9)


def test_what_joins_a_set_that_began_late_is_not_charged_for_beginning_late():
    """Once per set: as in the odds of what settled."""
    problem, z = naming().null.problem, naming().null.z
    late_s = float(np.mean(problem.tracks[0].time_s))
    alone, beside = (
        Painter(View.around(problem, z), naming().ground, naming().painter.listed[:4], since_s=late_s, beside=there)
        .picture()
        .sets
        for there in (0, 1)
    )
    for sets, charged in ((alone, late_odds(problem.tracks)), (beside, 0.0)):
        free = replace(sets, late=0.0, known={})
        assert sets.score((0,)).log - free.score((0,)).log == pytest.approx(charged)
        assert sets.quick((), sets.s)[0] - free.quick((), sets.s)[0] == pytest.approx(charged)
    assert late_odds(problem.tracks) < -1.0


def test_what_is_seen_around_a_hypothesis_is_kept_until_another_is_asked_for():
    first, second = [h for h in naming().hypotheses if h.effects][:2]
    kept = naming().whole(first)
    assert naming().whole(first) is kept
    assert naming().around(first) is kept.view
    naming().around(second)
    assert naming().whole(first) is not kept


def test_a_hypothesis_less_an_effect_is_seen_as_if_made_of_what_is_left():
    """Columns whitened and multiplied anew, in place of products of the whole hypothesis."""
    found, ground = left_over(), naming().ground
    out = names(found).index("quadratic_loss@current_A")
    painter = naming().without(found, out)
    shown, view = painter.picture(), naming().around(found)
    gone = np.concatenate((found.entries(out), found.wandering(out)))
    size = int(found.entries(out)[0])
    own = view.unknowns()
    if found.wanders:
        wandering = view.wandering(ground.discrepancy, found.wanders, found.share)
        own = [np.concatenate((j, w), axis=2) for j, w in zip(own, wandering, strict=True)]
    residuals = [r - j[:, :, size] * prior_mean(view)[size] for r, j in zip(view.residuals, own, strict=True)]
    probes = {found.now[out].variant: 1.0} | dict(naming().painter.probes)
    tried = view.of_variants(shown.variants, np.array([probes[v] for v in shown.variants]))
    both = [np.concatenate((np.delete(j, gone, axis=2), c), axis=2) for j, c in zip(own, tried, strict=True)]
    anew = ground.products(replace(view, residuals=tuple(residuals)), both)
    for part, other in zip(shown.products, anew, strict=True):
        assert part == pytest.approx(other, rel=1e-6, abs=1e-6 * float(np.abs(other).max()))
    assert shown.names[0] == "quadratic_loss@current_A"
    assert names(found)[1 - out] not in shown.names
    there, turned = painter.cosines(1.0), painter.cosines(-1.0)
    assert there[0] == pytest.approx(1.0, abs=0.01)
    cubic, lag = shown.names.index("cubic_loss@current_A"), shown.names.index("time_constant@current_A")
    assert there[cubic] > 0.5
    assert turned[cubic] == 0.0  # a loss gives nothing back
    assert turned[lag] == there[lag] > 0.0
