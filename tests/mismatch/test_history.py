"""A size over time, against closed forms: dense Gaussians, and a Kalman smoother of a linear machine."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from helpers.documents import check_verdict
from helpers.draughty import DRAUGHT, KNOWN, NOISE_C, PERIOD_S, TAU_S, record
from helpers.oven import loss_found
from helpers.plain import diagnosed
from scipy.stats import multivariate_normal

from twinbench.mismatch import Verdict
from twinbench.mismatch.findings import findings
from twinbench.mismatch.history.axis import Axis
from twinbench.mismatch.history.history import History
from twinbench.mismatch.history.linear import Line
from twinbench.mismatch.history.patterns import PATTERNS, RAMP, STEP, WALK, Pattern, Told, patterns, walk, weigh
from twinbench.mismatch.history.saying import says
from twinbench.physics.simulator import Array

SIGMA = 0.3
FROM_S, PER_S = 190.0, 0.004
"""Since when the draught grows, and how fast, K/s per second."""


def tracks(*ends: tuple[float, float]) -> Any:
    return [SimpleNamespace(name=f"day{k}", time_s=np.linspace(*end, 50)) for k, end in enumerate(ends, 1)]


def read_at_the_knots(axis: Axis, readings: Array, mean: float) -> Told:
    """What readings of the size itself tell, one at each knot."""
    columns = np.column_stack((np.ones(len(readings)), np.eye(len(readings)))) / SIGMA
    return Told(columns.T @ columns, columns.T @ readings / SIGMA, 0.0, mean)


def smoothed(readings: Array, time_s: Array, first: Array, per_s: float) -> tuple[Array, Array]:
    """A random walk's mean and sd by filterpy's Kalman filter and smoother."""
    kalman = KalmanFilter(dim_x=1, dim_z=1)
    kalman.x, kalman.P = first[:1].copy(), np.array([[first[1] ** 2]])
    kalman.F, kalman.H, kalman.R = np.eye(1), np.eye(1), np.array([[SIGMA**2]])
    Qs = [np.array([[per_s * dt]]) for dt in np.diff(time_s, prepend=time_s[0])]
    means, covs, _, _ = kalman.batch_filter(readings, Qs=Qs)
    mean, cov, _, _ = kalman.rts_smoother(means, covs, Qs=Qs)
    return mean[:, 0], np.sqrt(cov[:, 0, 0])


def test_a_walk_is_what_a_kalman_smoother_makes_of_it() -> None:
    axis = Axis.over(tracks((100.0, 160.0), (0.0, 60.0)))
    assert axis.clock
    order = axis.order
    readings = np.random.default_rng(1).normal(size=len(order)) + 0.02 * axis.along_s
    found = weigh([read_at_the_knots(axis, readings, 0.7)], Pattern(WALK, 1.0, walk(axis, 2.0)))
    along = axis.along_s[order]
    mean, sd = smoothed(readings[order], along, np.array([0.7, 1.0]), 4.0 / np.ptp(along))
    assert found.mean[order] == pytest.approx(mean, rel=1e-6)
    assert found.sd[order] == pytest.approx(sd, rel=1e-6)


@pytest.mark.parametrize("kind", PATTERNS)
def test_evidence_is_that_of_dense_gaussians(kind: str) -> None:
    axis = Axis.over(tracks((0.0, 60.0), (0.0, 40.0)))
    assert not axis.clock
    readings = np.random.default_rng(2).normal(size=len(axis.of)) + (axis.along_s > 50.0)
    told = read_at_the_knots(axis, readings, 0.4)
    some = [p for p in patterns(axis, 1.5) if p.kind == kind]
    several = [some[0], some[len(some) // 2], some[-1]]
    found = [weigh([told], p).log - np.log(p.prior) for p in several]
    dense = []
    for p in several:
        cov = SIGMA**2 * np.eye(len(readings)) + 1.0 + p.basis @ p.basis.T
        dense.append(multivariate_normal.logpdf(readings, np.full(len(readings), 0.4), cov))
    white = multivariate_normal.logpdf(readings, np.zeros(len(readings)), SIGMA**2 * np.eye(len(readings)))
    assert found == pytest.approx(np.array(dense) - white, rel=1e-9, abs=1e-6)


def test_the_courses_have_probabilities_that_sum_to_one() -> None:
    for spans in (((0.0, 60.0),), ((0.0, 60.0), (0.0, 40.0)), ((0.0, 60.0), (60.0, 80.0), (90.0, 95.0))):
        axis = Axis.over(tracks(*spans))
        assert sum(p.prior for p in patterns(axis, 1.0)) == pytest.approx(1.0)


def test_a_step_between_two_recordings_is_sharp() -> None:
    axis = Axis.over(tracks((0.0, 60.0), (0.0, 40.0)))
    first = int(np.flatnonzero(axis.of == 1)[0])
    at = axis.along_s[first]
    (step,) = (p for p in patterns(axis, 1.0) if p.kind == STEP and p.within_s == (at, at))
    assert np.array_equal(step.basis[:, 0], axis.of.astype(float))
    assert axis.place(axis.along_s[first]) == ("day2", 0.0)


@cache
def growing() -> Verdict:
    """Of an oven through which a draught goes that grows; nobody may change it."""

    def cooling(t: float) -> float:
        return 1.0 + PER_S * max(t - FROM_S, 0.0)

    several = [
        record(name, seed, cooling, begin_s) for name, seed, begin_s in (("monday", 1, 0.0), ("tuesday", 2, 200.0))
    ]
    return diagnosed(KNOWN, several, [record("sunday", 3, cooling, 400.0)], [DRAUGHT])


def history(verdict: Verdict) -> History:
    (finding,) = verdict.findings
    assert finding.history is not None
    return finding.history


def test_a_growing_effect_is_told_with_since_when_and_how_fast() -> None:
    verdict = growing()
    told = history(verdict)
    assert told.likeliest == RAMP
    assert told.odds["constant"] < 0.01
    assert told.rate.low < PER_S < told.rate.high
    assert told.rate.value == pytest.approx(PER_S, rel=0.15)
    assert told.since.low <= FROM_S <= told.since.high
    (finding,) = verdict.findings
    assert says(told)[1:] in finding.says
    assert "ts size grows by 0.2" in finding.says
    assert "(K/s)/min" in finding.says
    assert "that it is constant has probability below 0.01" in finding.says
    at = verdict.to_dict()["findings"][0]["history"]["since"]
    assert at["recording"] in ("monday", "tuesday")
    assert at["earliest"]["time_s"] <= FROM_S <= at["latest"]["time_s"]


def test_one_size_of_what_grows_is_told_as_what_it_is() -> None:
    d = growing().diagnosis
    named = replace(d, claims=tuple(replace(claim, names=(claim.found.name,)) for claim in d.claims if claim.found))
    (finding,) = findings(named)
    assert ", if it were constant: " in finding.says


def test_a_constant_effect_is_told_as_one() -> None:
    told = history(loss_found())
    assert told.odds["constant"] > 0.9
    assert told.rate.low < 0.0 < told.rate.high
    assert "its size is constant with probability 0.9" in says(told)
    check_verdict(loss_found())


def test_one_page_tells_one_interval_of_a_constant_size() -> None:
    (finding,) = loss_found().findings
    value, told = finding.parameters[0], history(loss_found())
    for point in told.points:
        assert (point.low, point.high) == pytest.approx((value.low, value.high), abs=0.05 * (value.high - value.low))


def test_a_form_that_is_not_exact_is_off_by_a_share_of_the_size_of_each_time() -> None:
    naming, chosen = growing().diagnosis.answer.naming, growing().diagnosis.answer.chosen
    view, d, k = naming.around(chosen), naming.ground.discrepancy, int(chosen.entries(0)[0])
    size = view.z[k] - view.problem.unknowns[k].mean
    plain = view.wandering(d, [k], 0.05)
    twice = view.wandering(d, [k], 0.05, {k: [np.full(len(c.grid.time_s), size) for c in view.courses]})
    for once, more in zip(plain, twice, strict=True):
        assert more == pytest.approx(2.0 * once)


def oracle(verdict: Verdict, amount: float) -> tuple[Array, Array]:
    """The draught in the last recording by a Kalman smoother that knows the machine, the noise and how much it walks.

    The first recording tells it where the draught stood; the temperature begins anew.
    """
    d = verdict.diagnosis
    decay = np.exp(-PERIOD_S / TAU_S)
    F, B = np.array([[decay, -TAU_S * (1.0 - decay)], [0.0, 1.0]]), np.array([1.0 - decay, 0.0])
    span = d.tracks[-1].time_s[-1] - d.tracks[0].time_s[0]
    Q, H = np.diag([0.0, amount**2 * PERIOD_S / span]), np.array([1.0, 0.0])
    x, P = np.array([150.0, 1.0]), np.diag([100.0**2, 10.0**2])
    for track in d.tracks:
        x, P = np.array([150.0, x[1]]), np.diag([100.0**2, P[1, 1]])
        ahead, behind = [], []
        for k, y in enumerate(track.y[:, 0]):
            if k:
                x, P = F @ x + B * track.u[k - 1, 0], F @ P @ F.T + Q
            ahead.append((x, P))
            gain = P @ H / (H @ P @ H + NOISE_C**2)
            x, P = x + gain * (y - H @ x), P - np.outer(gain, H @ P)
            behind.append((x, P))
    smooth = [behind[-1]]
    for (x, P), (x_ahead, P_ahead) in zip(behind[-2::-1], ahead[:0:-1], strict=True):
        C = P @ F.T @ np.linalg.inv(P_ahead)
        smooth.append((x + C @ (smooth[-1][0] - x_ahead), P + C @ (smooth[-1][1] - P_ahead) @ C.T))
    return np.array([x[1] for x, _ in smooth[::-1]]), np.sqrt([P[1, 1] for _, P in smooth[::-1]])


def test_on_a_linear_machine_a_walk_is_what_a_kalman_smoother_says() -> None:
    """Of the last recording, which all of them together tell of: means within half a sd, sds within two fifths."""
    d = growing().diagnosis
    naming, whole, axis = d.answer.naming, d.answer.chosen, Axis.over(d.tracks)
    # The oracle knows no equations that are a little wrong.
    chosen = replace(whole, wanders=[], mean=whole.mean[: len(whole.z)])
    line = Line.first(chosen, 0, axis, naming.around(whole), naming.ground.exact)
    told = line.told(line.with_noise(d.floor))
    amount = 0.8
    spread = float(chosen.sizes[0]) / line.large
    found = weigh(told, Pattern(WALK, 1.0, walk(axis, amount / spread)))
    last = axis.of == 1
    mean, sd = oracle(growing(), amount)
    time_s = d.tracks[1].time_s
    expected, wide = (np.interp(axis.knots[1], time_s, values) for values in (mean, sd))
    mine = chosen.z[-1] + spread * found.mean[last]
    inner = slice(2, -2)
    assert np.abs(mine - expected)[inner].max() < 0.5 * wide.max()
    assert (spread * found.sd[last])[inner] == pytest.approx(wide[inner], rel=0.4)
