"""What is exported says what the estimator says: the graph as the network, the page's host loop as the filter."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import onnxruntime
import pandas as pd
import pytest
import torch
from helpers.compressor_recordings import small_batch, trained_twin

from twinbench.bench.cells import make_cell
from twinbench.bench.cli.main import main
from twinbench.bench.profile import load_profile
from twinbench.common.store import Store
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.coordinates import ZETA_SCALE
from twinbench.methods.deeponet_kalman.cycle import INNOVATION_CLIP_SD, scratch, standardise
from twinbench.methods.deeponet_kalman.export import INPUTS, filter_arrays, operator_graph
from twinbench.methods.deeponet_kalman.layout import stream_type
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.deeponet_kalman.parts import parts_of
from twinbench.methods.deeponet_kalman.stream import STANDARDISED_LIMIT, heads_with_jacobian, push
from twinbench.methods.deeponet_kalman.windows import query_of
from twinbench.methods.estimator import Sample
from twinbench.methods.modes import in_the_long_run
from twinbench.methods.operator import SLOW_TAU_S, WINDOW, Operator
from twinbench.methods.training import load_weights

CHANNELS, SAMPLE_PERIOD_S = COMPRESSOR.channels, COMPRESSOR.sample_period_s
ZETA, NOISE = parts_of(COMPRESSOR).zeta, parts_of(COMPRESSOR).noise
ZETA_LOW, ZETA_HIGH = COMPRESSOR.zeta_bounds
to_theta = COMPRESSOR.coordinates.to_theta
PAGE = (Path(__file__).parents[2] / "docs/controller.md").read_text(encoding="utf-8")
LOOP, ON_A_RECORDING, ONLINE = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
UNGUARDED = {
    "hampel": False, "channel_gate": np.inf, "least_information": 0.0,
    "q_gain": 0.0, "r_gain": 0.0, "trust_reach": np.inf, "extrapolation": 0.0,
}  # fmt: skip
TICKS = 400


@pytest.fixture(scope="module")
def twin() -> DeepONetKalman:
    return trained_twin()


@pytest.fixture(scope="module")
def rows() -> np.ndarray:
    """Readings (TICKS, 7) with steps of the load, a spike, single samples missing and a gap of a second and a half."""
    rows = small_batch(3, sequences=1, samples=TICKS - 1).measured[0].copy()
    missing = np.random.default_rng(0).random(rows.shape) < 0.03
    missing[0] = False
    missing[300:330, CHANNELS.index("T_dis_K")] = True
    rows[missing] = np.nan
    rows[150, CHANNELS.index("m_flow_kg_s")] *= 1.3
    return rows


@pytest.fixture
def exported(twin, rows, tmp_path, monkeypatch) -> Path:
    """The page's commands in an empty folder with a recording, as if ``run`` had trained the twin; the folder."""
    monkeypatch.chdir(tmp_path)
    profile = load_profile("quick")
    cell = make_cell("deeponet_kalman", profile.seeds[0], profile)
    Store(Path("results/quick/store")).put("fit", cell.fit, twin.save)
    assert main(["export", "--out", "controller"]) == 0
    time_s = SAMPLE_PERIOD_S * np.arange(len(rows))
    pd.DataFrame(rows, columns=CHANNELS).assign(time_s=time_s)[["time_s", *CHANNELS]].to_csv(
        "controller/recording.csv", index=False
    )
    return tmp_path


class Reference:
    """The torch operator in double precision on whole windows of the readings so far, as a function of x and zeta."""

    def __init__(self, twin: DeepONetKalman, filled: np.ndarray, masks: np.ndarray) -> None:
        self.model, self.operator = twin.model, Operator().double()
        load_weights(self.operator, twin.arrays)
        index = np.maximum(np.arange(len(filled) - WINDOW - 1, len(filled)), 0)
        values = np.clip(twin.front_end.standardise(filled), -STANDARDISED_LIMIT, STANDARDISED_LIMIT)
        temperature, slow = values[:, 5], np.full(2, values[0, 5])
        for now in temperature:
            slow += (1.0 - np.exp(-SAMPLE_PERIOD_S / np.array(SLOW_TAU_S))) * (now - slow)
        query = np.clip(
            (query_of(COMPRESSOR, filled[-1]) - twin.scaling.mean) / twin.scaling.scale,
            -STANDARDISED_LIMIT,
            STANDARDISED_LIMIT,
        )
        self.time = torch.tensor([SAMPLE_PERIOD_S], dtype=torch.float64)
        read = (values[index], masks[index[1:]].astype(float), temperature[-1] - slow, query)
        self.latent = self.operator.latent(*(torch.from_numpy(part)[None] for part in read), self.time).detach()

    def increment(self, x: torch.Tensor, zeta: torch.Tensor) -> torch.Tensor:
        mean, scale, unit = (
            torch.from_numpy(part) for part in (self.model.state_mean, self.model.state_scale, self.model.increment)
        )
        condition = torch.cat([(x - mean) / scale, zeta[:4] / ZETA_SCALE])
        return self.operator(self.latent, condition[None], self.time)[0] * unit


@pytest.fixture(scope="module")
def streamed(twin, rows):
    """Of each tick: readings so far and masks (k, 7), x, zeta, what the graph says, units of both outputs."""
    session = onnxruntime.InferenceSession(operator_graph(twin))
    model, rng = twin.model, np.random.default_rng(1)
    rows = rows.copy()
    rows[200, 5] += 40.0 * twin.front_end.scale[5]  # beyond what the operator is shown
    masks, filled = np.isfinite(rows), pd.DataFrame(rows).ffill().to_numpy(np.float32).astype(float)
    carried = [np.tile(filled[0], (WINDOW, 1)), np.tile(masks[0], (WINDOW, 1)), np.zeros(2)]
    units = model.increment[:, None] / np.r_[model.state_scale, np.full(5, ZETA_SCALE)]
    ticks = []
    for k in range(len(rows)):
        x, zeta = model.state_mean + model.state_scale * rng.normal(size=5), 2.0 * rng.normal(size=5)
        x, zeta = (part.astype(np.float32).astype(float) for part in (x, zeta))
        feed = dict(zip(INPUTS, map(np.float32, (filled[k], masks[k], x, zeta, *carried)), strict=True))
        increment, jacobian, *carried = session.run(None, feed)
        ticks.append((filled[: k + 1], masks[: k + 1], x, zeta, increment / model.increment, jacobian / units))
    return ticks, units


@pytest.mark.parametrize("k", [0, 1, 62, 63, 64, 199, 200, 201, 215, 265, 310, TICKS - 1])
def test_the_graph_is_the_torch_operator_and_its_jacobian_autograds(twin, streamed, k):
    ticks, units = streamed
    filled, masks, x, zeta, increment, jacobian = ticks[k]
    reference, at = Reference(twin, filled, masks), (torch.from_numpy(x), torch.from_numpy(zeta))
    expected = reference.increment(*at).detach().numpy() / twin.model.increment
    np.testing.assert_allclose(increment, expected, rtol=0.0, atol=1e-5)
    to_both = torch.autograd.functional.jacobian(reference.increment, at)
    np.testing.assert_allclose(jacobian, np.hstack([j.numpy() for j in to_both]) / units, rtol=0.0, atol=1e-5)
    assert np.abs(jacobian[:, :9]).min(axis=1).max() > 1e-4
    assert (jacobian[:, 9] == 0.0).all()


def test_the_graph_is_the_compiled_stream(twin, streamed):
    ticks, _ = streamed
    weights, room = twin.weights, scratch(twin.weights, twin.parts)
    stream, t = np.zeros(1, stream_type(weights))[0], room[0]["filter"]["operator"]
    condition = np.empty(9, np.float32)
    for filled, masks, x, zeta, increment, jacobian in ticks:
        standardise(twin.twin[0], filled[-1], room[0])
        push(weights[0], stream, t, room[0]["sample"], masks[-1].astype(np.float32), room[0]["query"])
        condition[:5] = (x - twin.model.state_mean) / twin.model.state_scale
        condition[5:] = zeta[:4] / ZETA_SCALE
        heads_with_jacobian(weights[0], t, stream["base"], condition)
        np.testing.assert_allclose(increment, t["out"], rtol=0.0, atol=1e-5)
        np.testing.assert_allclose(jacobian[:, :9], t["jacobian"], rtol=0.0, atol=1e-5)


def unguarded(twin: DeepONetKalman) -> DeepONetKalman:
    plain = DeepONetKalman(COMPRESSOR, **DeepONetKalman.contract_settings, **UNGUARDED)
    plain.arrays = twin.arrays
    plain.restore()
    modes = plain.twin["filter"]["modes"][0]  # one filter, with the mean walk
    modes["walk"], modes["out"] = in_the_long_run(modes["turn"]) @ modes["walk"], 0.0
    return plain


def test_the_host_loop_of_the_page_is_the_filter_without_its_safeguards(twin, rows, exported, monkeypatch, capsys):
    assert sum(bool(line.strip()) for line in LOOP.splitlines()) <= 30
    assert set(re.findall(r"^(?:import|from) (\w+)", LOOP, re.MULTILINE)) == {"numpy", "onnxruntime"}
    monkeypatch.chdir(exported / "controller")
    host: dict = {}
    exec(LOOP, host)
    plain = unguarded(twin)
    state = plain.init(1)
    for k, (z, P) in enumerate(host["estimates"](rows)):
        state, info = plain.step(state, Sample(k * SAMPLE_PERIOD_S, rows[None, k]))
        if k == 150:
            assert abs(info.innovation[0, 2]) > INNOVATION_CLIP_SD * np.sqrt(info.S[0, 2, 2])
        memory = state.memory[0][0]
        sd = np.sqrt(memory["P"].diagonal())
        assert (np.abs(z - memory["z"]) / sd).max() < 1e-3
        np.testing.assert_allclose(P / np.outer(sd, sd), memory["P"] / np.outer(sd, sd), atol=1e-3)
        np.testing.assert_allclose(host["health"](z[ZETA:NOISE]), to_theta(z[ZETA:NOISE]), rtol=1e-8)
    assert k == TICKS - 1
    capsys.readouterr()
    exec(ON_A_RECORDING, host)
    printed = re.findall(r"[-+.e\d]+", capsys.readouterr().out)
    assert len(printed) == 15 * TICKS
    last = np.array(printed[-15:], dtype=float)
    np.testing.assert_allclose(last[:10], np.r_[z[:5], to_theta(z[ZETA:NOISE])], rtol=1e-5, atol=1e-5)


def test_where_nothing_can_be_written_nothing_is_left(exported, capsys):
    before = sorted(exported.rglob("*"))
    assert main(["export", "--out", "controller/filter.npz/deeper"]) == 2
    assert "cannot write controller/filter.npz/deeper/operator.onnx: Not a directory" in capsys.readouterr().err
    assert sorted(exported.rglob("*")) == before


@pytest.mark.parametrize("zeta", [ZETA_LOW, np.zeros(5), ZETA_HIGH])
def test_one_logistic_maps_all_of_health(twin, zeta):
    f = filter_arrays(twin)
    theta = f["low"] + f["span"] / (1.0 + np.exp(-f["slope"] * zeta - f["offset"]))
    np.testing.assert_allclose(theta, to_theta(zeta), rtol=1e-9, atol=1e-9)


def test_the_page_shows_the_shapes_that_the_graph_has(twin):
    session = onnxruntime.InferenceSession(operator_graph(twin))
    shapes = {entry.name: entry.shape for entry in (*session.get_inputs(), *session.get_outputs())}
    for name in (*INPUTS, "increment", "jacobian"):
        assert f"\n| `{name}` | {' × '.join(map(str, shapes[name]))} |" in PAGE
    assert [shapes[f"{name}_after"] for name in INPUTS[-3:]] == [shapes[name] for name in INPUTS[-3:]]


def test_the_online_form_runs_as_the_page_says(twin, rows, exported, monkeypatch, capsys):
    Path("recording.csv").write_bytes(Path("controller/recording.csv").read_bytes())
    exec(ONLINE, {})
    state = twin.init(1)
    for k, row in enumerate(rows):
        state, info = twin.step(state, Sample(k * SAMPLE_PERIOD_S, row[None]))
    printed = re.findall(r"[-+.e\d]+|nan", capsys.readouterr().out)
    last = np.array(printed[-31:], dtype=float)
    np.testing.assert_allclose(last, np.r_[state.mean[0], state.low[0], state.high[0], info.nis[0]], rtol=1e-4)
