"""An FMU that can only be stepped: its columns are those of its equations, and its verdicts say what was asked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import stepped_tanks
from helpers.documents import check_verdict
from helpers.small_fmu import needs_gcc

from twinbench.common.errors import BadInput
from twinbench.mismatch import diagnose
from twinbench.mismatch.calibrate import block_noise, own_unknowns, shared_unknowns
from twinbench.mismatch.faults import faults
from twinbench.mismatch.fit import Problem
from twinbench.mismatch.naming.view import View
from twinbench.mismatch.report.sheet import sheet
from twinbench.mismatch.stepped import NOT_ASKED, machine_of
from twinbench.mismatch.tracks import prepare
from twinbench.mismatch.variants import Variant
from twinbench.physics.fmu.as_simulator import simulator_of
from twinbench.physics.simulator import Simulator, Term, Variable

pytestmark = needs_gcc
MADE = {"twinbench": "0", "commit": "", "time": "now"}


@pytest.fixture(scope="module")
def tanks(tmp_path_factory: pytest.TempPathFactory) -> Simulator:
    return simulator_of(stepped_tanks.STEPPED.build(tmp_path_factory.mktemp("fmu"), 3))


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Simulator:
    return simulator_of(stepped_tanks.TOLD.build(tmp_path_factory.mktemp("fmu")))


def problem_of(simulator: Simulator, linear: bool) -> Problem:
    tracks = prepare(stepped_tanks.days()[:2], simulator, linear=linear)
    listed = [f for f in faults(simulator) if "bias" in f.name or "lag" in f.name]
    unknowns = (*shared_unknowns(simulator), *own_unknowns(simulator, tracks))
    machine = machine_of(simulator, listed)
    machine.step_s = machine.block_step_s = 0.05
    return Problem(machine, tracks, unknowns, block_noise(tracks, simulator))


def close(found: np.ndarray, wanted: np.ndarray) -> None:
    """Within half a per cent of each column's largest: one is linearised, the other is not."""
    assert found.shape == wanted.shape
    ends = np.abs(wanted).max(axis=(0, 1))
    np.testing.assert_allclose(found / np.maximum(ends, 1e-12), wanted / np.maximum(ends, 1e-12), atol=0.005)


@pytest.mark.parametrize("linear", [False, True])
def test_runs_and_columns_are_those_of_the_same_equations_whose_rates_are_told(
    tanks: Simulator, told: Simulator, linear: bool
) -> None:
    stepped, exact = problem_of(tanks, linear), problem_of(told, linear)
    z = stepped.z0 + 0.1
    np.testing.assert_allclose(stepped.readings(0, z), exact.readings(0, z), rtol=1e-6)
    names = [c.name for c in exact.machine.candidates]
    assert names == [c.name for c in stepped.machine.candidates]
    views = [View.around(p, z) for p in (stepped, exact)]
    close(*(view.unknowns(by_runs=True)[1] for view in views))
    if linear:  # the other's columns of faults count whole samples
        return
    tried = [Variant(k, ()) for k in range(len(names))]
    between_samples_s = [stepped_tanks.PERIOD_S * (stepped_tanks.SAMPLES // 2 - 0.5)]
    close(*(view.of_variants(tried, np.full(len(tried), 0.005), between_samples_s)[0] for view in views))


def named(simulator: Simulator, verdict: str, **wrong: float) -> tuple[str, ...]:
    """The names that a verdict of some kind gives."""
    *learnt, held = stepped_tanks.days(**wrong)
    found = diagnose(simulator, learnt, hold_out=[held])
    assert found.verdict == verdict
    check_verdict(found)
    assert found.to_dict()["not_asked"] == found.points[0] == NOT_ASKED
    texts = " ".join(text.get_text() for text in sheet(found, MADE, missing="figures").texts)
    assert "can only be stepped" in texts
    return tuple(name for f in found.findings for name in f.names)


def test_a_sound_machine_is_not_blamed(tanks: Simulator) -> None:
    assert named(tanks, "consistent") == ()


def test_a_parameter_that_changed_is_told_as_one(tanks: Simulator) -> None:
    assert named(tanks, "parameter change", k2=1.2) == ()


def test_a_gain_concealed_in_what_drives_it_is_named(tanks: Simulator) -> None:
    # With all parameters free it is the same as others: whatever flows, flows faster.
    assert named(replace(tanks, calibrate=("k1", "k2")), "sensor fault", gain_q=0.08)[0] == "input_gain@q"


def test_what_a_balance_lacks_is_not_blamed_on_a_sensor(tanks: Simulator) -> None:
    assert named(tanks, "unexplained", hole=0.15) == ()


def test_what_needs_rates_is_refused_in_a_line(tanks: Simulator) -> None:
    leak = Term("hole", "", "balance:h1", (Variable("c", "", 0.0, 1.0, 0.1),), term=lambda x, u, theta: -theta[-1])  # type: ignore[arg-type]
    with pytest.raises(BadInput, match=r"'hole' is a term of the equations, .* can only be stepped"):
        diagnose(tanks, stepped_tanks.days(), catalogue=[leak])
    with pytest.raises(BadInput, match="'A' cannot drift"):
        diagnose(replace(tanks, drifts=("A",)), stepped_tanks.days())
    with pytest.raises(BadInput, match=r"measured 'q': .* can only be stepped"):
        diagnose(tanks, stepped_tanks.days(), measured={"q": 0.1})


def test_one_that_cannot_start_elsewhere_is_compared_from_its_own_start(tmp_path: Path) -> None:
    fixed = simulator_of(replace(stepped_tanks.STEPPED, starts=()).build(tmp_path))
    assert fixed.states == ()
    (track, *_) = prepare(stepped_tanks.days()[:1], fixed)
    problem = Problem(machine_of(fixed, ()), [track], shared_unknowns(fixed), np.full(2, 0.01))
    np.testing.assert_allclose(problem.readings(0, problem.z0)[0], [1.0, 1.0])
    assert problem.columns(problem.z0)[0].shape == (*track.means.shape, 3)


def test_one_whose_step_fails_is_refused_with_where(tmp_path: Path) -> None:
    failing = replace(stepped_tanks.STEPPED, status="h1 > 1.4 ? ERROR : OK")
    with pytest.raises(BadInput, match=r"reports an error at a step, on recording day. at .* s"):
        diagnose(simulator_of(failing.build(tmp_path)), stepped_tanks.days())
