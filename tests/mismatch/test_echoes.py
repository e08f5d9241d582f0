"""Several effects that draw one thing, which is none of them."""

from __future__ import annotations

from dataclasses import replace

import pytest
from motor_friction import friction_found

from twinbench.mismatch.naming.answer import answered
from twinbench.mismatch.naming.effect import Effect
from twinbench.mismatch.naming.settle import settled
from twinbench.mismatch.variants import Variant, typical

GAIN, LAG, OTHER = "sensor_gain@T_probe_K", "sensor_lag@T_probe_K", "sensor_bias@amps_A"
DRY, SQUARE = "coulomb_friction@omega_rad_s", "quadratic_friction@omega_rad_s"


@pytest.mark.parametrize(
    ("names", "echoes"),
    [
        ((GAIN, LAG), {GAIN, LAG}),
        ((GAIN, OTHER), set()),
        ((DRY, LAG, GAIN), {GAIN, LAG}),
        ((DRY, SQUARE), set()),
    ],
)
def test_two_faults_of_one_channel_are_one_thing(names, echoes):
    d = friction_found().diagnosis
    naming, candidates = d.answer.naming, d.machine.candidates
    effects = []
    for name in names:
        (j,) = (i for i, c in enumerate(candidates) if c.name == name)
        effects.append(Effect(Variant(j, ()), 0.1 * typical(candidates[j]), abs(typical(candidates[j])), -3.0))
    together = replace(settled(*d.before, effects, naming.ground, naming.ground.s), log=naming.best.log + 1e3)
    found = answered(replace(naming, hypotheses=[together, *naming.hypotheses])).found
    assert {f.name for f in found if f.evidence["echo"]} == echoes
