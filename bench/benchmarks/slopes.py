"""What a slope of health is worth: in forecasts, and in the estimates of a filter that expects none.

Beside what the filter can make of its own estimates stands what nobody can have: forecasts from the true state with
health frozen at its true value, and with the true slope of health.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twinbench.bench.estimates import Estimates, ticks_ahead
from twinbench.bench.evaluate import run as evaluate
from twinbench.bench.profile import Evaluation
from twinbench.bench.statistics.aligned import truth_at
from twinbench.bench.statistics.ranked import ranked_from
from twinbench.data.batch import Array, Batch
from twinbench.methods.deeponet_kalman.cycle import roll_out
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.estimator import Info, Sample, State
from twinbench.physics.integrate import Varying, simulate

NO_SLOPE, CORRECTED = "health as it is", "corrected"
"""Names of rows: the filter's own, and its health corrected by its slopes."""
EVALUATION = Evaluation(stride=20, origin_every_s=60.0, leads_s=(60.0,))
OVER_S, SHARE = 60.0, 0.25
"""Health goes on for a share of the slope that its estimate had over so long. On validation recordings this pair erred
least of 20, 60 and 180 s with a share of 1/4, 1/2 and 1; with the whole slope forecasts err a tenth to a third more."""
MOVED_EVERY = 100
"""Ticks after which the health of a forecast is moved on: 5 s, in which no ramp moves it by a hundredth of a life."""
TRUE_OVER_S = 10.0
"""The true slope is that of the last seconds: a ramp is straight, so how many says little."""
STEEPEST = 0.3
"""Of a life in a minute: what moves faster is a step, which has no slope."""
PAST_S = (10.0, 30.0, 60.0, 120.0, 240.0)
"""Since when an estimate of health may have moved, where its own slopes are to correct it."""


class _Along:
    """Stands in for the estimator; its forecasts let health go on along its own slope."""

    def __init__(self, estimator: DeepONetKalman) -> None:
        self.estimator, self.parts = estimator, estimator.parts
        self.health = slice(self.parts.zeta, self.parts.noise)
        self.way: list[Array] = []

    def __getattr__(self, name: str) -> object:
        return getattr(self.estimator, name)

    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        after, info = self.estimator.step(state, sample)
        self.way.append(after.memory[0]["z"][:, self.health].copy())
        return after, info

    def forecast(self, state: State, inputs: Array) -> Array:
        back = min(round(OVER_S / self.estimator.machine.sample_period_s), len(self.way) - 1)
        slope = SHARE * (self.way[-1] - self.way[-1 - back]) / max(back, 1)
        memory, model = state.memory[0].copy(), (self.estimator.weights, self.estimator.twin)
        out = np.empty((*inputs.shape[:2], self.parts.outputs))
        for first in range(0, inputs.shape[1], MOVED_EVERY):
            piece = np.ascontiguousarray(inputs[:, first : first + MOVED_EVERY])
            said = np.empty((*piece.shape[:2], self.parts.outputs))
            memory["z"][:, self.health] += slope * piece.shape[1]
            roll_out(*model, memory, piece, said, self.estimator.room)
            memory["ticks"] = 0  # the window has taken in what it read last; the next piece begins after that
            out[:, first : first + MOVED_EVERY] = said
        return out


def along_own_slope(estimator: DeepONetKalman, batch: Batch, seed: int) -> Estimates:
    """Its estimates, with forecasts that let health go on along a share of its own slope."""
    return evaluate(_Along(estimator), batch.without_truth(), EVALUATION, seed)  # type: ignore[arg-type]


def from_truth(estimates: Estimates, batch: Batch, sloped: bool) -> Estimates:
    """The same with forecasts of the plant from its true state under its true inputs.

    Args:
        batch: the recordings with their truth.
        sloped: health goes on along its true slope; otherwise it stays as it is.
    """
    assert batch.truth is not None
    machine, period_s = batch.machine, batch.machine.sample_period_s
    ahead, back = int(ticks_ahead(estimates.leads_s[-1], period_s)), round(TRUE_OVER_S / period_s)
    rows = [batch.names.index(name) for name in estimates.names]
    forecast = estimates.forecast.copy()
    for o, origin in enumerate(np.searchsorted(batch.time_s, estimates.forecast_time_s - 0.5 * period_s)):
        for b, row in enumerate(rows):
            health = batch.truth.health[row, origin]
            slope = (health - batch.truth.health[row, max(origin - back, 0)]) / back
            slope[np.abs(slope) * 60.0 / period_s > STEEPEST * machine.span] = 0.0
            course = health + sloped * np.arange(ahead + 1)[:, None] * slope
            u = batch.truth.inputs[row, origin : origin + ahead + 1]
            varying = Varying(machine.health_names, course[None])
            x0 = batch.truth.states[row, origin]
            forecast[b, o, -1] = simulate(machine.plant, u[None], x0, dt_s=period_s, varying=varying)[1][0, -1]
    return replace(estimates, forecast=forecast)


def corrected(estimates: Estimates, batch: Batch) -> Estimates:
    """The same with health corrected by what its own last slopes say of its error.

    A filter that lags behind ramps errs in proportion to their slope. Least squares finds that proportion on the other
    recordings, of every parameter by itself.

    Args:
        batch: the recordings with their truth.
    """
    n, first_s = len(batch.machine.estimated), ranked_from(estimates.time_s)
    health = estimates.mean[..., n:].astype(np.float64)
    error = truth_at(batch, estimates.names, estimates.time_s).health - health
    moved = np.stack([health - _earlier(estimates.time_s, health, past_s) for past_s in PAST_S], axis=-1)
    ranked = estimates.time_s >= first_s
    mean = estimates.mean.copy()
    for b in range(len(health)):
        others = np.arange(len(health)) != b
        for i in range(health.shape[-1]):
            own, wrong = moved[others][:, ranked, i], error[others][:, ranked, i]
            share = np.linalg.lstsq(own.reshape(-1, len(PAST_S)), wrong.ravel(), rcond=None)[0]
            mean[b, :, n + i] = health[b, :, i] + moved[b, :, i] @ share
    return replace(estimates, mean=mean)


def _earlier(time_s: Array, values: Array, past_s: float) -> Array:
    """Values (B, M, nh) as they were so many seconds before each tick, at first those of the first one."""
    return values[:, np.searchsorted(time_s, np.maximum(time_s - past_s, time_s[0]))]


def with_slopes(estimator: DeepONetKalman, estimates: Estimates, batch: Batch) -> dict[str, Estimates]:
    """Rows of the tables by name: each forecast, then health corrected by its own slopes.

    Args:
        estimates: its own, as ``EVALUATION`` asks for them.
        batch: the recordings with their truth.
    """
    return {
        NO_SLOPE: estimates,
        "health along its own slope": along_own_slope(estimator, batch, estimates.seed),
        "true state, true health as it is": from_truth(estimates, batch, sloped=False),
        "true state, true slope of health": from_truth(estimates, batch, sloped=True),
        CORRECTED: corrected(estimates, batch),
    }
