"""The scenes of the paper's Figs. 3, 4 and 6c: load ramps, three ways of wearing, an abrupt fault, a sensor's bias.

Where the paper gives numbers they are the paper's: capacity 1.00 to 0.88 over 18 minutes, leakage 0.015 to
0.052, cooling impaired in two stages. Their load moves as in the benchmark, on a machine that is fresh at first.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twinbench.data.batch import Batch
from twinbench.data.benchmark import run
from twinbench.data.corrupt import Corruption
from twinbench.data.fresh import HEALTHY, MIX, WORN, draw
from twinbench.data.scenario import Change, Scenario
from twinbench.machines.compressor import SAMPLE_PERIOD_S, Loads

WARMUP_MINUTES = 5.0
SCENE_MINUTES = 30.0
RAMP_MINUTES = 9.0
ONSET_S = 480.0
"""When, after the warm-up, what is abrupt happens."""
FADING_S = 18 * 60.0
STAGED_S = 9 * 60.0
"""Both stages of the impaired cooling and the pause between them, as long as each."""
RAMPS = ((2.4, 4.6), (2.8, 4.0), (4.6, 2.6), (3.2, 4.8), (4.0, 2.4))
"""Pressure ratio that the valve aims at before and after each load ramp."""
SPEEDS_RPM = ((1100.0, 1100.0), (950.0, 1500.0), (1300.0, 1300.0), (1700.0, 1200.0), (1000.0, 1750.0))
RAMP_NAMES = tuple(f"ramp-{i + 1}" for i in range(len(RAMPS)))
RAMP_BEGINS_S, RAMP_S = 60.0, (5.0, 10.0, 20.0, 40.0, 60.0)
MIDDLE = np.full(MIX, 0.5)
"""Loads of no particular lean, for ``draw``."""


def load_ramps(seed: int, level: Corruption = Corruption()) -> Batch:
    """Five healthy machines whose load moves once, from RAMP_BEGINS_S on, faster or slower; four minutes each."""
    warm = 60.0 * WARMUP_MINUTES
    scenarios = []
    for name, ratio, speed, ramp_s in zip(RAMP_NAMES, RAMPS, SPEEDS_RPM, RAMP_S, strict=True):
        still = draw(name, "none", seed, RAMP_MINUTES, WARMUP_MINUTES, MIDDLE)
        assert isinstance(still.drive, Loads)
        drive = replace(
            still.drive,
            N_rpm=_ramp(speed, warm + RAMP_BEGINS_S, ramp_s),
            ratio=_ramp(ratio, warm + RAMP_BEGINS_S, ramp_s),
            p_suc_bar=np.array([[0.0, 0.95], [still.seconds, 0.95]]),
        )
        scenarios.append(replace(still, drive=drive))
    return run(tuple(scenarios), WARMUP_MINUTES, level)


def _ramp(ends: tuple[float, float], begin_s: float, seconds: float) -> np.ndarray:
    return np.array([[0.0, ends[0]], [begin_s, ends[0]], [begin_s + seconds, ends[1]]])


def wearing(seed: int, level: Corruption = Corruption()) -> Batch:
    """Six machines of 25 minutes: ``capacity``, ``leakage``, ``cooling``, ``normal``, ``fouling``, ``bias``."""
    warm = 60.0 * WARMUP_MINUTES
    early, onset = warm + 120.0, warm + ONSET_S
    at_once = onset + SAMPLE_PERIOD_S
    changes = {
        "capacity": (Change("capacity", early, early + FADING_S, 0.88),),
        "leakage": (Change("leakage", early, early + FADING_S, 0.052),),
        "cooling": (Change("heat_transfer", early, early + STAGED_S, float(WORN[3]), stages=2),),
        "normal": (),
        "fouling": (Change("capacity", onset, at_once, 0.93), Change("heat_transfer", onset, at_once, 0.80)),
        "bias": (Change("T_bias_K", onset, at_once, 5.0),),
    }
    scenarios = tuple(_wearing(name, seed, change) for name, change in changes.items())
    return run(scenarios, WARMUP_MINUTES, level)


def _wearing(name: str, seed: int, changes: tuple[Change, ...]) -> Scenario:
    fresh = draw(name, "none", seed, SCENE_MINUTES, WARMUP_MINUTES, MIDDLE)
    return replace(fresh, start=HEALTHY.copy(), changes=changes)
