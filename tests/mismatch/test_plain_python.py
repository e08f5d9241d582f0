"""A simulator that numba refuses runs as the same one that it compiles, only slowly."""

from __future__ import annotations

import numpy as np
import pytest
from tank_files import TANK, tank_table, write_python, write_recording

from twinbench.mismatch import diagnose
from twinbench.mismatch.fit import Problem
from twinbench.mismatch.machine import Machine, Setting
from twinbench.mismatch.march import RUNGE_KUTTA, legendre
from twinbench.mismatch.model import load_simulator
from twinbench.mismatch.recordings import read_recordings
from twinbench.mismatch.tracks import prepare

PLAIN = TANK.replace("def rhs(x, u, theta):\n", "def rhs(x, u, theta):\n    SEEN.append(1)\n    SEEN.clear()\n")


@pytest.mark.parametrize("states", [False, True])
@pytest.mark.parametrize("blocks", [False, True])
def test_what_cannot_be_compiled_gives_the_same(tmp_path, blocks, states):
    path = write_recording(tmp_path, tank_table())

    def runs(text: str, name: str) -> np.ndarray:
        simulator = load_simulator(write_python(tmp_path, text, name))
        (track,) = prepare(read_recordings([path], simulator), simulator)
        machine = Machine(simulator, ())
        return machine.clean(Setting(track, machine.theta, machine.start(track)), blocks=blocks, states=states)

    with pytest.warns(RuntimeWarning, match="plain Python"):
        plain = runs("SEEN = []\n" + PLAIN, "plain.py")
    np.testing.assert_allclose(plain, runs(TANK, "tank.py"), rtol=1e-9)


@pytest.mark.parametrize("scheme", [RUNGE_KUTTA, legendre(3)], ids=["Runge-Kutta", "stabilised"])
def test_it_is_linearised_along_the_same_run(tmp_path, scheme):
    path = write_recording(tmp_path, tank_table())

    def means(text: str, name: str) -> np.ndarray:
        simulator = load_simulator(write_python(tmp_path, text, name))
        machine, tracks = Machine(simulator, ()), prepare(read_recordings([path], simulator), simulator)
        machine.scheme = scheme
        return Problem(machine, tracks, (), np.ones(1)).course(0, np.empty(0)).means

    with pytest.warns(RuntimeWarning, match="plain Python"):
        plain = means("SEEN = []\n" + PLAIN, "plain.py")
    np.testing.assert_allclose(plain, means(TANK, "tank.py"), rtol=1e-9)


@pytest.mark.slow
def test_it_is_diagnosed_as_the_same(tmp_path):
    paths = [write_recording(tmp_path, tank_table(), name) for name in ("day.csv", "next.csv")]

    def said(text: str, name: str) -> tuple[str, list[tuple[str, ...]], list[float]]:
        simulator = load_simulator(write_python(tmp_path, text, name))
        recordings = read_recordings(paths, simulator)
        verdict = diagnose(simulator, recordings[:1], recordings[1:])
        return verdict.verdict, [f.names for f in verdict.findings], [e.rmse_before for e in verdict.fit]

    with pytest.warns(RuntimeWarning, match="plain Python"):
        *plain, errors = said("SEEN = []\n" + PLAIN, "plain.py")
    *same, others = said(TANK, "tank.py")
    assert plain == same
    assert errors == pytest.approx(others, rel=0.01)
