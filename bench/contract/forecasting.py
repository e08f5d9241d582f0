"""Promises about the forecast."""

from __future__ import annotations

import numpy as np

from twinbench.bench.contract.outcome import at_most, need
from twinbench.bench.contract.promise import promise
from twinbench.bench.contract.subject import FLOAT32_ROUND_OFF, FLOAT64_ROUND_OFF, SHORT_RUN, Subject, same, snapshot


@promise("a forecast has its shape and is finite")
def _forecast(s: Subject) -> str:
    state = s.state_after(s.fitted, s.recordings["undisturbed"][:, :SHORT_RUN])
    for length in (1, 7, SHORT_RUN):
        said = s.fitted.forecast(state, s.ground.future(SHORT_RUN, length))
        shape = (2, length, len(s.machine.outputs))
        need(said.shape == shape, f"shape {said.shape}, must be {shape}")
        need(said.dtype == np.float64, f"it is {said.dtype}, must be float64")
        need(np.isfinite(said).all(), f"not finite within {length} ticks")
    return f"from 1 to {SHORT_RUN} ticks ahead"


@promise("a forecast leaves the state as it was")
def _forecast_is_pure(s: Subject) -> str:
    measured = s.recordings["undisturbed"]
    state, inputs = s.state_after(s.fitted, measured[:, :SHORT_RUN]), s.ground.future(SHORT_RUN, 100)
    given = snapshot((state, inputs))
    before = snapshot(s.fitted.step(state, s.ground.sample_at(measured, SHORT_RUN)))
    first = s.fitted.forecast(state, inputs)
    kept = first.copy()
    need(same((state, inputs), given), "forecast changed the state or the inputs it was given")
    need(
        same(s.fitted.step(state, s.ground.sample_at(measured, SHORT_RUN)), before),
        "a step after a forecast gives something else",
    )
    need(same(s.fitted.forecast(state, inputs), kept), "the same forecast gave something else later")
    return "health frozen with it: the step after a forecast is the step without"


@promise("a forecast does not look at later inputs")
def _forecast_is_causal(s: Subject) -> str:
    state, inputs = s.state_after(s.fitted, s.recordings["undisturbed"][:, :SHORT_RUN]), s.ground.future(SHORT_RUN, 200)
    other = inputs.copy()
    other[:, 80:] = 1.1 * inputs[::-1, 80:]
    long = s.fitted.forecast(state, inputs)
    gaps = [
        np.abs(said[:, :80] - long[:, :80]).max()
        for said in (s.fitted.forecast(state, inputs[:, :80]), s.fitted.forecast(state, other))
    ]
    at_most(
        float(gaps[1]), FLOAT64_ROUND_OFF * np.abs(long).max(), "other inputs from tick 80 on change earlier ticks by"
    )
    return at_most(float(gaps[0]), FLOAT32_ROUND_OFF, "the first 80 of 200 ticks differ from 80 alone by")
