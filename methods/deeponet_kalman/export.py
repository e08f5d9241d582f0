"""DeepONet-Kalman for machines without this package: the operator as an ONNX graph, the filter as arrays.

The graph takes in the readings of a tick and says, from a state and a health, what the next tick brings, with its
Jacobian. What it carries from tick to tick goes in and comes out. The whole window goes through the branch at every
tick, strided as in ``methods.operator``: few nodes, and a first window that is a sample repeated.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from twinbench.data.batch import CHANNEL, HEALTH, SAMPLE_PERIOD_S, STATE, Array
from twinbench.methods.deeponet_kalman.layout import N_CONDITION
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.deeponet_kalman.model import ERROR, FLOW, NOISE, PROBE, SIZE, ZETA
from twinbench.methods.deeponet_kalman.stream import STANDARDISED_LIMIT
from twinbench.methods.operator import (
    HEAD_OF_STATE,
    KERNEL,
    N_CHANNELS,
    N_COLUMNS,
    N_HEADS,
    N_SLOW,
    N_STATES,
    N_ZETA,
    SINUSOIDS,
    SLOW_TAU_S,
)
from twinbench.methods.probe import TAU_PROBE_S, TAU_PROBE_X
from twinbench.physics.compressor import M_REF_KG_S
from twinbench.physics.health import HEALTHY, HIGH, LOW, ZETA_SCALE, d_theta_d_zeta
from twinbench.physics.sensors import OUTPUT_NOISE, speed_factor

OPSET, IR_VERSION = 18, 8
"""Old enough for the runtimes of the last years."""
N_HEALTH = len(HEALTH)
EXPONENTIAL = 1e12
"""Span of an exponential, in healthy values, where it is written as a logistic."""
INPUTS = ("values", "mask", "x", "zeta", "window", "masks", "slow")
OUTPUTS = ("increment", "jacobian", "window_after", "masks_after", "slow_after")


class _Graph:
    """Nodes of an ONNX graph in the making; calling it adds one and returns the name of what it makes.

    Arrays among the inputs become constants, float32 or, where they are indices, int64.
    """

    def __init__(self, weights: dict[str, np.ndarray]) -> None:
        self.weights = weights
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def __call__(self, op: str, *inputs: str | np.ndarray | list[int], out: str = "", **attributes: Any) -> str:
        from onnx import helper

        names = [i if isinstance(i, str) else self._constant(np.asarray(i)) for i in inputs]
        out = out or f"{op}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(op, names, [out], **attributes))
        return out

    def _constant(self, value: np.ndarray) -> str:
        from onnx import numpy_helper

        name = f"constant_{len(self.constants)}"
        kind = np.float32 if value.dtype.kind == "f" else np.int64
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(value, kind), name))
        return name

    def affine(self, x: str, layer: str) -> str:
        """``x W' + b`` of rows x."""
        W, b = (self.weights[f"net.{layer}.{part}"] for part in ("weight", "bias"))
        return self("Gemm", x, W, b, transB=1)

    def silu(self, x: str) -> str:
        """``x sigmoid(x)``."""
        return self("Mul", x, self("Sigmoid", x))

    def root(self, square: str) -> str:
        """Of a mean square, as the operator takes it."""
        return self("Sqrt", self("Add", square, np.array([1e-6])))

    def unit(self, x: str) -> str:
        """Rows to unit second moment."""
        return self("Div", x, self.root(self("ReduceMean", self("Mul", x, x), [1], keepdims=1)))

    def rows(self, x: str, start: int, stop: int, axis: int = 0, out: str = "") -> str:
        """``x[start:stop]`` along an axis."""
        return self("Slice", x, [start], [stop], [axis], out=out)

    def standardised(self, x: str, mean: Array, scale: Array) -> str:
        """Zero mean, unit spread on the training split."""
        # What float32 leaves off a mean near 300 K shows where the spread is a fraction of a kelvin.
        left_off = mean - mean.astype(np.float32)
        return self("Sub", self("Div", self("Sub", x, mean), scale), left_off / scale)

    def bounded(self, x: str) -> str:
        """Within what the operator is shown."""
        return self("Clip", x, np.array(-STANDARDISED_LIMIT), np.array(STANDARDISED_LIMIT))


def operator_graph(estimator: DeepONetKalman) -> bytes:
    """The trained operator as a serialised ONNX model of one machine, float32, physical units.

    Inputs:
        values, mask: (7,) the tick's readings, gaps filled, and 1 where accepted, order CHANNELS.
        x, zeta: (5,) and (5,) posterior of the tick: states, coordinates of health.
        window, masks: (window, 7) the values and masks of the ticks before, newest last; at first those of the
            first tick, repeated.
        slow: (2,) how far the discharge temperature is from its slow means, standardised; at first 0.

    Outputs:
        increment: (5,) what the states move by until the next tick.
        jacobian: (5, 10) of that to x and zeta.
        window_after, masks_after, slow_after: what the next tick takes for window, masks and slow.
    """
    from onnx import checker, helper
    from onnx.onnx_pb import TensorProto

    g, length = _Graph(estimator.arrays), estimator.config["window"]
    row = g("Reshape", "values", [1, N_CHANNELS])
    latent = g("Mul", _branch(g, estimator, row, length), _trunk(g, estimator, row))
    _heads(g, estimator, g.affine(latent, "heads.from_latent"))
    carried = [(length, N_CHANNELS), (length, N_CHANNELS), (N_SLOW,)]
    shapes = {
        **dict(zip(INPUTS, [(N_CHANNELS,), (N_CHANNELS,), (N_STATES,), (N_HEALTH,), *carried], strict=True)),
        **dict(zip(OUTPUTS, [(N_STATES,), (N_STATES, N_STATES + N_HEALTH), *carried], strict=True)),
    }
    seen = {name: helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in shapes.items()}
    graph = helper.make_graph(
        g.nodes, "deeponet_kalman", [seen[name] for name in INPUTS], [seen[name] for name in OUTPUTS], g.constants
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
    checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


def _branch(g: _Graph, estimator: DeepONetKalman, row: str, length: int) -> str:
    """``operator.Branch`` on the window moved on by a tick, (1, latents); what is carried on is put out."""
    front = estimator.front_end
    seen = g("Concat", "window", row, axis=0)
    g.rows(seen, 1, length + 1, out="window_after")
    mask = g("Concat", "masks", g("Reshape", "mask", [1, N_CHANNELS]), axis=0)
    g.rows(mask, 1, length + 1, out="masks_after")
    values = g.bounded(g.standardised(seen, front.mean, front.scale))
    now = g.rows(values, 1, length + 1)
    change = g("Sub", now, g.rows(values, 0, length))
    columns = g("Concat", now, change, "masks_after", axis=1)
    first = g.silu(g.affine(g("Reshape", columns, [-1, KERNEL * N_COLUMNS]), "branch.block_1"))
    reached = g("Reshape", first, [length // KERNEL**2, -1])
    second = g.silu(g.affine(reached, "branch.block_2"))
    tokens = g("Add", second, g.silu(g.affine(second, "branch.mix_2")))
    gates = g("Tanh", g.affine(tokens, "branch.gate_tanh")), g("Sigmoid", g.affine(tokens, "branch.gate_sigmoid"))
    score = g("MatMul", g("Mul", *gates), g.weights["net.branch.score.weight"].T)
    weight = g("Softmax", g("Add", score, g.weights["net.branch.position"][:, None]), axis=0)
    attended = g("Gemm", weight, tokens, transA=1)
    mean = g("ReduceMean", now, [0], keepdims=1)
    from_mean = g("Sub", now, mean)
    spread = g.root(g("ReduceMean", g("Mul", from_mean, from_mean), [0], keepdims=1))
    # The distance from a running mean, carried instead of the mean, loses nothing to float32 however slow the mean is.
    keep = np.exp(-SAMPLE_PERIOD_S / np.array(SLOW_TAU_S))
    T_dis = CHANNEL.T_dis_K
    temperature_change = g.rows(g.rows(change, length - 1, length), T_dis, T_dis + 1, axis=1)
    slow = g("Mul", g("Add", "slow", g("Reshape", temperature_change, [1])), keep, out="slow_after")
    summary = [attended, g.rows(tokens, -1, length), mean, spread, g("Reshape", slow, [1, N_SLOW])]
    return g.unit(g.affine(g("Concat", *summary, axis=1), "branch.project"))


def _trunk(g: _Graph, estimator: DeepONetKalman, row: str) -> str:
    """``operator.Trunk`` a tick ahead under the present inputs, (1, latents)."""
    p_suc, p_dis, N = (g("Gather", row, [c], axis=1) for c in (CHANNEL.p_suc_bar, CHANNEL.p_dis_bar, CHANNEL.N_rpm))
    raw = g("Concat", N, g("Div", p_dis, p_suc), g("Gather", row, [1, 0, 3], axis=1), axis=1)
    query = g.bounded(g.standardised(raw, *estimator.scaling))
    embedded = g.silu(g.affine(g.rows(query, 0, 2, axis=1), "trunk.embedding"))
    phase = SAMPLE_PERIOD_S * (np.pi / 0.1) * np.array(SINUSOIDS)
    time = np.concatenate([[1.0], np.sin(phase), np.cos(phase)])[None]
    hidden = g.silu(g.affine(g("Concat", query, embedded, time, axis=1), "trunk.hidden"))
    return g.unit(g.affine(hidden, "trunk.project"))


def _heads(g: _Graph, estimator: DeepONetKalman, base: str) -> None:
    """``operator.Heads`` and, row by row beside it, its derivative to each of the 9 conditions, Eq. (5)."""
    model, width = estimator.model, g.weights["net.heads.hidden_weight"].shape[-1]
    entry = g.weights["net.heads.from_condition.weight"].T
    condition = g(
        "Concat",
        g.standardised("x", model.state_mean, model.state_scale),
        g("Div", g.rows("zeta", 0, N_ZETA), np.array([ZETA_SCALE])),
        axis=0,
    )
    first, slope = _silu_and_slope(g, g("Add", base, g("MatMul", g("Reshape", condition, [1, N_CONDITION]), entry)))
    rows = g("Concat", g("Mul", slope, entry), first, axis=0)
    per_head = g("Transpose", g("Reshape", rows, [N_CONDITION + 1, N_HEADS, width]), perm=[1, 0, 2])
    deep = g("MatMul", per_head, g.weights["net.heads.hidden_weight"])
    tangents, last = g.rows(deep, 0, N_CONDITION, axis=1), g.rows(deep, N_CONDITION, N_CONDITION + 1, axis=1)
    second, slope = _silu_and_slope(g, g("Add", last, g.weights["net.heads.hidden_bias"][:, None]))
    of_head = g("Concat", g("Mul", tangents, slope), second, axis=1)
    of_state = g("Gather", of_head, list(HEAD_OF_STATE), axis=0)
    out = g("MatMul", of_state, g.weights["net.heads.out_weight"][:, :, None])  # (5, 10, 1)
    scaled = g("Add", g.rows(out, N_CONDITION, N_CONDITION + 1, axis=1), g.weights["net.heads.out_bias"][:, None, None])
    g("Mul", g("Reshape", scaled, [N_STATES]), model.increment, out="increment")
    units = model.increment[:, None] / np.append(model.state_scale, np.full(N_ZETA, ZETA_SCALE))
    jacobian = g("Mul", g("Reshape", g.rows(out, 0, N_CONDITION, axis=1), [N_STATES, N_CONDITION]), units)
    g("Concat", jacobian, np.zeros((N_STATES, N_HEALTH - N_ZETA)), axis=1, out="jacobian")  # the bias moves no state


def _silu_and_slope(g: _Graph, x: str) -> tuple[str, str]:
    """``silu(x)`` and its derivative, ``s + silu(x) (1 - s)`` with s the sigmoid."""
    gate = g("Sigmoid", x)
    value = g("Mul", x, gate)
    return value, g("Add", gate, g("Mul", value, g("Sub", np.array([1.0]), gate)))


def filter_arrays(estimator: DeepONetKalman) -> dict[str, np.ndarray]:
    """What a filter around the graph needs, for z as in ``methods.deeponet_kalman.augmented``.

    Returns:
        z0, P0: (19,), (19, 19) before the first tick.
        F: (19, 19) transition of one tick without the operator and the probe; Q (19, 19) its noise.
        H: (3, 19) of the readings without the bias and the coloured noise.
        z_low, z_high: (19,) bounds.
        probe_tau_s, probe_tau_x: the probe lags by ``tau_s mu**-tau_x`` seconds at flow memory mu.
        mean: (7,) stands in for readings before the first one.
        window: samples that the operator looks back.
        white, coloured: (3,) noise sd of the outputs; times the reading where ``relative``, and times
            ``speed[0] + speed[1] N_rpm`` where ``with_speed``.
        low, span, slope, offset: (5,) health is ``low + span / (1 + exp(-slope zeta - offset))``.
    """
    fresh, model = estimator.init(1).memory[0][0], estimator.model
    F, H = np.eye(SIZE), np.zeros((len(OUTPUT_NOISE), SIZE))
    F[:N_STATES, ERROR:] = np.eye(N_STATES)
    np.fill_diagonal(F[NOISE:, NOISE:], np.append(model.noise_keep, np.full(N_STATES, model.error_keep)))
    H[0, STATE.p_exh_bar], H[1, PROBE], H[2, FLOW] = 1.0, 1.0, M_REF_KG_S
    z_low, z_high = np.full(SIZE, -np.inf), np.full(SIZE, np.inf)
    z_low[FLOW], z_low[ZETA:NOISE], z_high[ZETA:NOISE] = 0.05, model.zeta_low, model.zeta_high
    low, span, slope = LOW.copy(), HIGH - LOW, d_theta_d_zeta(np.zeros(N_HEALTH))
    for j in (HEALTH.index("leakage"), HEALTH.index("heat_transfer")):
        # These are exponential: a logistic so far from its upper end that nobody tells the two apart.
        low[j], span[j] = 0.0, HEALTHY[j] * EXPONENTIAL
    share, (at_0, at_1) = (HEALTHY - low) / span, speed_factor(np.array([0.0, 1.0]))
    return {
        "z0": fresh["z"],
        "P0": fresh["P"],
        "F": F,
        "Q": model.Q,
        "H": H,
        "z_low": z_low,
        "z_high": z_high,
        "probe_tau_s": np.array(TAU_PROBE_S),
        "probe_tau_x": np.array(TAU_PROBE_X),
        "mean": estimator.front_end.mean,
        "window": np.array(estimator.config["window"]),
        **{
            name: np.array([getattr(s, name) for s in OUTPUT_NOISE])
            for name in ("white", "coloured", "relative", "with_speed")
        },
        "speed": np.array([at_0, at_1 - at_0]),
        "low": low,
        "span": span,
        "slope": slope / (span * share * (1.0 - share)),
        "offset": np.log(share / (1.0 - share)),
    }
