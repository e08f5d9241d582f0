"""The paper's scenes in the runner, in the figures and in the table of claims."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from helpers.sample_run import make_estimates
from helpers.tiny_run import parts, twinbench, write_estimator, write_profile
from scipy.stats import chi2

from twinbench.bench.report.claims import claims, claims_table
from twinbench.bench.report.evidence import Evidence, add_scenes, gather
from twinbench.bench.report.figures.scenes import flow_parity, innovations, r_squared, ramps, wear
from twinbench.bench.results import HARDER
from twinbench.bench.robustness import METRICS
from twinbench.bench.roster import LABELS
from twinbench.bench.statistics.scores import score
from twinbench.bench.statistics.summary import summarise
from twinbench.data.batch import Batch, Truth
from twinbench.data.disturb import CONDITIONS
from twinbench.data.scenes import ONSET_S, load_ramps, wearing
from twinbench.machines.compressor import ESTIMATED

EVERY = 20


def thinned(batch: Batch) -> Batch:
    """At 1 Hz: what ``make_estimates`` takes."""
    truth = batch.truth
    fields = (truth.states, truth.health, truth.outputs, truth.inputs)
    fewer = Truth(*(f[:, ::EVERY] for f in fields))
    return Batch(batch.names, batch.time_s[::EVERY], batch.measured[:, ::EVERY], fewer)


@pytest.fixture(scope="module")
def recordings() -> list[Batch]:
    return [thinned(load_ramps(3)), thinned(wearing(3))]


@pytest.fixture(scope="module")
def evidence(recordings) -> Evidence:
    """The oracle, and a proposed method that is twice as far off."""
    found = Evidence()
    levels = {"oracle": 1.0, "deeponet_kalman": 2.0}
    add_scenes(found, [(b, make_estimates(b, e, 0, level)) for e, level in levels.items() for b in recordings])
    return found


def claimed(found, says):
    (claim,) = [c for c in found if c.says.startswith(says)]
    return claim


def nothing() -> tuple:
    scores = pd.DataFrame(columns=["estimator", "seed", "sequence", "metric", "value"])
    timed = pd.DataFrame(columns=["estimator", "p50_us", "p99_us", "memory_kB"])
    return pd.DataFrame(columns=list(HARDER)), timed, scores


def test_every_scene_is_there_with_everybodys_track(evidence):
    assert len(evidence.scenes) == 11
    assert all(set(e.tracks) == {"oracle", "deeponet_kalman"} for e in evidence.scenes.values())


def test_the_legend_of_everybodys_tracks_fits_into_the_figure(evidence):
    scene = evidence.scenes["capacity"]
    everybody = replace(scene, tracks=dict.fromkeys(LABELS, scene.tracks["oracle"]))
    figure = wear(everybody, "capacity")
    figure.draw_without_rendering()
    (legend,) = figure.legends
    inside, whole = legend.get_window_extent(), figure.bbox
    assert whole.x0 <= inside.x0 < inside.x1 <= whole.x1
    assert whole.y0 <= inside.y0 < inside.y1 <= whole.y1


def test_innovations_are_of_the_time_after_what_is_abrupt(evidence, recordings):
    assert set(evidence.nis) == {"normal", "fouling", "bias"}
    assert len(evidence.nis["normal"]) == len(recordings[1].time_s)
    assert len(evidence.nis["fouling"]) == len(evidence.nis["bias"]) == 300
    late = replace(make_estimates(recordings[1], "deeponet_kalman", 0, 1.0))
    late.nis[:, late.time_s < ONSET_S] = np.nan
    again = Evidence()
    add_scenes(again, [(recordings[1], late)])
    assert np.isfinite(again.nis["bias"]).all()


def test_figures_of_the_scenes_show_what_they_should(evidence):
    left, right = ramps(evidence.scenes, 0).axes
    assert len(left.lines) == 10
    assert len([line for line in right.lines if len(line.get_xdata()) > 2]) == 10
    panel = wear(evidence.scenes["capacity"], "capacity").axes[0]
    assert len(panel.lines) == 3
    assert len(innovations(evidence.nis).axes) == 3


def test_parity_is_of_eight_thousand_points_and_perfect_where_the_estimate_is(recordings):
    cell = make_estimates(recordings[1], "deeponet_kalman", 0, 0.0)
    flow = gather([cell], recordings[1], {}).flow
    assert flow.shape == (2, 8000)
    assert r_squared(flow) == pytest.approx(1.0, abs=1e-6)
    assert r_squared(np.stack([flow[0], np.full(8000, flow[0].mean())])) == pytest.approx(0.0)
    assert flow_parity(flow).axes[0].collections


def test_claims_that_the_run_does_not_tell_are_dashes():
    harder, latency, scores = nothing()
    table = claims_table(claims(summarise(scores, {}), Evidence(), scores, harder, latency), True)
    assert all(row[2].text == "–" for row in table.rows)
    assert all(row[1].text != "–" for row in table.rows)


def test_what_did_not_recover_in_its_scene_was_not_reached(evidence):
    harder, latency, scores = nothing()
    found = claims(summarise(scores, {}), evidence, scores, harder, latency)
    never = [c._replace(ours=np.nan) if c.says.startswith("Fig. 4c") else c for c in found]
    (row,) = [row for row in claims_table(never, True).rows if row[0].text.startswith("Fig. 4c")]
    assert row[2].text == "not reached"
    assert row[3].text not in ("–", "not reached")


def test_claims_are_what_the_scenes_hold(evidence, recordings):
    harder, latency, scores = nothing()
    found = claims(summarise(scores, {}), evidence, scores, harder, latency)
    largest = claimed(found, "Fig. 3a")
    assert 0.0 < largest.reference < largest.ours
    i = ESTIMATED.index("capacity")
    scene = evidence.scenes["capacity"]
    last = scene.time_s > scene.time_s[-1] - 60.0
    off = np.abs(scene.tracks["oracle"].mean[last, i] - scene.truth[last, i]) / scene.truth[last, i]
    assert claimed(found, "Fig. 4a, terminal").reference == pytest.approx(100.0 * off.mean())
    assert claimed(found, "Fig. 4a, effective delay").reference < 20.0
    assert 90.0 < claimed(found, "Fig. 4b").ours <= 100.0
    expected = np.median(evidence.nis["fouling"]) / chi2.median(3)
    assert claimed(found, "Fig. 6c").ours == pytest.approx(expected)


def test_claims_of_the_comparison_come_from_the_scores(recordings):
    _, latency, _ = nothing()
    names = ("oracle", "deeponet_kalman", "gru_kf", "deeponet", "deeponet_kalman:no_feasibility")
    tables = [
        score(make_estimates(recordings[1], n, 0, level), recordings[1]).assign(estimator=n, seed=0)
        for level, n in enumerate(names, 1)
    ]
    scores = pd.concat(tables)
    whole = scores[~scores["estimator"].str.contains(":")]
    rows = [
        ("deeponet_kalman", 0, c.group, c.name, "s", m, 10.0 if c.corruption.noise > 1.5 else 1.0)
        for c in CONDITIONS
        for m in METRICS
    ]
    harder = pd.DataFrame(rows, columns=list(HARDER))
    timed = {"estimator": "deeponet_kalman", "p50_us": 20.0, "p99_us": 50.0, "memory_kB": 900.0}
    latency = pd.DataFrame([timed])
    found = claims(summarise(whole, {}), Evidence(), scores, harder, latency)
    means = scores.groupby(["estimator", "metric"])["value"].mean()
    assert claimed(found, "discharge pressure").reference == pytest.approx(means["oracle", "p_nrmse_pct"])
    assert claimed(found, "GRU + KF, mean parameter").ours == pytest.approx(means["gru_kf", "parameter_error_pct"])
    without = means["deeponet_kalman:no_feasibility", "p_nrmse_pct"]
    assert claimed(found, "without the feasibility").ours == pytest.approx(without)
    assert claimed(found, "Fig. 6a").ours == 1.0
    assert claimed(found, "Fig. 7a").ours == pytest.approx(0.02)
    assert claimed(found, "weights").ours == pytest.approx(0.9)


def test_a_run_keeps_its_scenes_and_shows_them(tmp_path):
    out, profile = tmp_path / "out", write_profile(tmp_path)
    profile.write_text(profile.read_text().replace("scenes = false", "scenes = true"))
    arguments = ("run", "--profile", profile, "--out", out, "--only", write_estimator(tmp_path, "steady"))
    assert twinbench(*arguments) == 0
    assert len(json.loads((out / "manifest.json").read_text())["scenes"]["takes"]) == 2
    assert (out / "figures" / "fig4a_capacity.png").exists()
    assert "Fig. 4a" in (out / "tables" / "claims.md").read_text()
    before = parts(out)
    assert sum("/scene/" in name for name in before) == 2
    assert twinbench(*arguments) == 0
    assert parts(out) == before
