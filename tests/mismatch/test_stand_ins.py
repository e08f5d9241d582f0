"""What has no name may mend the simulator all the same, if the held-out recordings show that it does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from motor import MOTOR
from motor_case import record
from motor_friction import CATALOGUE, dry_friction

from twinbench.mismatch import stage_prove
from twinbench.mismatch.asked import Asked
from twinbench.mismatch.naming.answer import Unnamed
from twinbench.mismatch.naming.decision import FEATURES, Claim, Rule, decided, learnt_rule
from twinbench.mismatch.naming.weighed import Weighed, weighed
from twinbench.mismatch.proof import Held
from twinbench.mismatch.stuck import Stuck, without
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array, Port

DRY = "coulomb_friction@omega_rad_s"
SILENT = Rule(learnt_rule().weights, say_name=1.1, say_set=1.1)


@pytest.fixture(scope="module")
def found() -> Weighed:
    fitted = [record(f"run {s}", s, dry_friction) for s in (1, 2)]
    return weighed(Asked(MOTOR, fitted, [record("held out", 9, dry_friction, reach=1.3)], CATALOGUE))


@pytest.fixture(scope="module")
def asked_of(found: Weighed) -> stage_prove.Tested:
    return stage_prove.tested(found.answer, found.fit, found.seen.floor)


def ends(found: Weighed, asked_of: stage_prove.Tested, claims: tuple[Claim, ...]) -> stage_prove.Proved:
    return stage_prove.proved(asked_of, claims, found.fit, found.seen.floor)


def foretelling(asked_of: stage_prove.Tested, nats: float) -> stage_prove.Tested:
    """Had the chosen effects foretold the held-out recordings by so much better than nothing does."""
    effects = tuple(replace(f, evidence={**f.evidence, "held_gain": nats}) for f in asked_of.answer.found)
    return asked_of._replace(answer=replace(asked_of.answer, found=effects))


def spoilt(asked_of: stage_prove.Tested) -> stage_prove.Tested:
    """Had the chosen effects made the errors of one output larger by a fifth."""
    before, after = asked_of.held_before, asked_of.held_after
    assert before is not None
    assert after is not None
    residuals = [
        np.column_stack((1.2 * b[:, :1] + 0.1 * a[:, 1:2], a[:, 1:]))
        for b, a in zip(before.residuals, after.residuals, strict=True)
    ]
    return asked_of._replace(held_after=Held(residuals, *after[1:]))


def test_without_a_name_the_simulator_is_mended_where_that_is_shown(
    found: Weighed, asked_of: stage_prove.Tested
) -> None:
    claims = decided(asked_of.answer, [1.0], SILENT)
    assert [c.names for c in claims] == [()]
    end = ends(found, asked_of, claims)
    assert end.mended is asked_of.mended
    assert end.held_after is not None
    assert end.held_before is not None
    assert end.held_after.rmse[1] < 0.8 * end.held_before.rmse[1]


def test_what_foretells_nothing_mends_nothing(found: Weighed, asked_of: stage_prove.Tested) -> None:
    end = ends(found, foretelling(asked_of, 1.0), decided(asked_of.answer, [1.0], SILENT))
    assert end.mended is None
    assert end.refused == ""


def test_what_removes_little_mends_nothing_without_a_name(found: Weighed, asked_of: stage_prove.Tested) -> None:
    before, after = asked_of.held_before, asked_of.held_after
    assert before is not None
    assert after is not None
    assert stage_prove.removed(asked_of) > 0.9
    residuals = [0.8 * b + 0.2 * a for b, a in zip(before.residuals, after.residuals, strict=True)]
    little = asked_of._replace(held_after=Held(residuals, *after[1:]))
    assert 0.1 < stage_prove.removed(little) < stage_prove.STANDS_IN
    assert ends(found, little, decided(asked_of.answer, [1.0], SILENT)).mended is None
    assert ends(found, little, decided(asked_of.answer, [1.0])).mended is not None, "a name mends in any case"


def test_what_spoils_an_output_mends_nothing_without_a_name(found: Weighed, asked_of: stage_prove.Tested) -> None:
    end = ends(found, spoilt(asked_of), decided(asked_of.answer, [1.0], SILENT))
    assert end.mended is None
    assert end.refused.startswith("it makes the held-out errors of speed_rad_s grow from ")


def test_a_name_that_foretells_more_may_err_by_what_its_parameters_do(
    found: Weighed, asked_of: stage_prove.Tested
) -> None:
    claims = decided(asked_of.answer, [1.0])
    assert [c.names for c in claims] == [(DRY,)]
    assert ends(found, spoilt(asked_of), claims).mended is asked_of.mended
    unproved = ends(found, spoilt(foretelling(asked_of, 1.0)), claims)
    assert unproved.mended is None
    assert [c.names for c in unproved.claims] == [()]


def test_a_name_is_refused_where_an_output_held_back_is_not_followed(
    found: Weighed, asked_of: stage_prove.Tested
) -> None:
    """A constant would foretell the current better than the mended simulator; the calibrated one errs still more."""
    before, after = asked_of.held_before, asked_of.held_after
    assert before is not None
    assert after is not None
    (amps,) = [t.means[:, 1] - np.nanmean(t.means[:, 1]) for t in asked_of.held]
    at_amps = np.arange(after.residuals[0].shape[1]) == 1
    worst, bad = (
        Held([r + times * np.outer(amps, at_amps) for r in after.residuals], *after[1:]) for times in (30.0, 1.5)
    )
    lost = asked_of._replace(held_before=worst, held_after=bad)
    end = ends(found, lost, decided(asked_of.answer, [1.0]))
    assert [c.names for c in end.claims] == [()]
    assert end.refused == "with it the simulator does not follow amps_A"
    assert not end.worse
    assert end.mended is asked_of.mended, "it stands in: it removes nearly all of the error"


@pytest.mark.parametrize("explained", [True, False])
def test_what_the_chosen_effects_explain_is_no_sensor_that_stands_still(
    found: Weighed, monkeypatch: pytest.MonkeyPatch, explained: bool
) -> None:
    """By the calibrated simulator the speed stands still; the one with dry friction is asked too."""
    (whole,) = found.fit.held
    still = Stuck(whole.name, 0, 20.0, 60.0, 0.0, 9.0)
    asked: list[float] = []

    def set_aside(tracks: list[Track], readings: list[Array], floor: Array) -> tuple[list[Track], list[Stuck]]:
        asked.append(float(np.std(tracks[0].y[:, 1] - readings[0][:, 1])))
        seen = [] if explained and len(asked) > 1 else [still]
        return without(tracks, seen), seen

    monkeypatch.setattr(stage_prove, "set_aside", set_aside)
    end = stage_prove.tested(found.answer, found.fit, found.seen.floor)
    assert asked[1] < 0.8 * asked[0], "the simulator with the effects is asked second"
    assert end.stuck == ([] if explained else [still])
    assert np.isnan(end.held[0].y[:, 0]).sum() == (
        0 if explained else np.sum((whole.time_s >= 20.0) & (whole.time_s <= 60.0))
    )
    assert end.held_after is not None


@pytest.mark.parametrize(("constant", "share"), [(-50.0, 0.0), (0.0, 0.5), (50.0, 1.0)])
def test_without_a_name_it_is_where_a_name_acts_or_something_unnamed(
    asked_of: stage_prove.Tested, constant: float, share: float
) -> None:
    """The names' ports as likely as that the right name is among them, the rest by something unnamed in its place."""
    rule = Rule({"constant": constant, **dict.fromkeys(FEATURES, 0.0)}, np.inf, np.inf)
    (effect,) = asked_of.answer.found
    elsewhere = Port("balance", "T_winding_K")
    unnamed = (Unnamed(elsewhere, 3.0, 1.0), Unnamed(Port("balance", "omega_rad_s"), 3.0 - np.log(3.0), 1.0))
    doubtful = replace(effect, weights={DRY: 1.0}, unnamed=unnamed)
    (claim,) = decided(replace(asked_of.answer, found=(doubtful,)), [1.0], rule)
    assert dict(claim.ports)[elsewhere] == pytest.approx(0.75 * (1.0 - share))
    assert sum(p for _, p in claim.ports) == pytest.approx(1.0)
    assert claim.port == (elsewhere if share < 0.3 else Port("balance", "omega_rad_s"))
