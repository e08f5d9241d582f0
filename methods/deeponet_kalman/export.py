"""DeepONet-Kalman for machines without this package: the operator as an ONNX graph, the filter as arrays.

The graph takes in the readings of a tick and says, from a state and a health, what the next tick brings, with its
Jacobian. What it carries from tick to tick goes in and comes out. The whole window goes through the branch at every
tick, strided as in ``methods.operator``: few nodes, and a first window that is a sample repeated.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.machines.coordinates import ZETA_SCALE, Array
from twinbench.machines.machine import Machine
from twinbench.machines.sensors import Growth
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.deeponet_kalman.parts import followers
from twinbench.methods.deeponet_kalman.stream import STANDARDISED_LIMIT
from twinbench.methods.modes import in_the_long_run
from twinbench.methods.operator import EMBEDDED, KERNEL, SLOW_TAU_S, head_of_state, slow_channels

OPSET, IR_VERSION = 18, 8
"""Old enough for the runtimes of the last years."""
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
        values, mask: (C,) the tick's readings, gaps filled, and 1 where accepted, inputs first.
        x, zeta: (n,) and (nh,) posterior of the tick: states, coordinates of health.
        window, masks: (window, C) the values and masks of the ticks before, newest last; at first those of the
            first tick, repeated.
        slow: (k,) how far each slow channel is from each of its running means, standardised; at first 0.

    Outputs:
        increment: (n,) what the states move by until the next tick.
        jacobian: (n, n + nh) of that to x and zeta.
        window_after, masks_after, slow_after: what the next tick takes for window, masks and slow.
    """
    from onnx import checker, helper
    from onnx.onnx_pb import TensorProto

    g, length, parts = _Graph(estimator.arrays), estimator.config["window"], estimator.parts
    channels, n = parts.channels, parts.states
    row = g("Reshape", "values", [1, channels])
    latent = g("Mul", _branch(g, estimator, row, length), _trunk(g, estimator, row))
    _heads(g, estimator, g.affine(latent, "heads.from_latent"))
    carried = [(length, channels), (length, channels), (len(slow_channels(estimator.machine)),)]
    shapes = {
        **dict(zip(INPUTS, [(channels,), (channels,), (n,), (parts.health,), *carried], strict=True)),
        **dict(zip(OUTPUTS, [(n,), (n, n + parts.health), *carried], strict=True)),
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
    front, channels, slow_of = estimator.front_end, estimator.parts.channels, slow_channels(estimator.machine)
    seen = g("Concat", "window", row, axis=0)
    g.rows(seen, 1, length + 1, out="window_after")
    mask = g("Concat", "masks", g("Reshape", "mask", [1, channels]), axis=0)
    g.rows(mask, 1, length + 1, out="masks_after")
    values = g.bounded(g.standardised(seen, front.mean, front.scale))
    now = g.rows(values, 1, length + 1)
    change = g("Sub", now, g.rows(values, 0, length))
    columns = g("Concat", now, change, "masks_after", axis=1)
    first = g.silu(g.affine(g("Reshape", columns, [-1, KERNEL * 3 * channels]), "branch.block_1"))
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
    keep = np.tile(np.exp(-estimator.model.period_s / np.array(SLOW_TAU_S)), len(slow_of) // len(SLOW_TAU_S))
    moved = g("Gather", g("Reshape", g.rows(change, length - 1, length), [channels]), slow_of)
    slow = g("Mul", g("Add", "slow", moved), keep, out="slow_after")
    summary = [attended, g.rows(tokens, -1, length), mean, spread, g("Reshape", slow, [1, len(slow_of)])]
    return g.unit(g.affine(g("Concat", *summary, axis=1), "branch.project"))


def _trunk(g: _Graph, estimator: DeepONetKalman, row: str) -> str:
    """``operator.Trunk`` a tick ahead under the present inputs, (1, latents)."""
    scaling = estimator.scaling
    raw = []
    for above, below in zip(scaling.above, scaling.below, strict=True):
        value = g("Gather", row, [above], axis=1)
        raw.append(g("Div", value, g("Gather", row, [below], axis=1)) if below >= 0 else value)
    query = g.bounded(g.standardised(g("Concat", *raw, axis=1), scaling.mean, scaling.scale))
    embedded = g.silu(g.affine(g.rows(query, 0, min(EMBEDDED, len(raw)), axis=1), "trunk.embedding"))
    time = estimator.weights["time"]
    hidden = g.silu(g.affine(g("Concat", query, embedded, time, axis=1), "trunk.hidden"))
    return g.unit(g.affine(hidden, "trunk.project"))


def _heads(g: _Graph, estimator: DeepONetKalman, base: str) -> None:
    """``operator.Heads`` and, row by row beside it, its derivative to each of the conditions, Eq. (5)."""
    model, (heads, width, _) = estimator.model, g.weights["net.heads.hidden_weight"].shape
    entry, n, parts = g.weights["net.heads.from_condition.weight"].T, estimator.parts.states, estimator.parts
    conditions = len(entry)
    condition = g(
        "Concat",
        g.standardised("x", model.state_mean, model.state_scale),
        g("Div", g("Gather", "zeta", model.acting), np.array([ZETA_SCALE])),
        axis=0,
    )
    first, slope = _silu_and_slope(g, g("Add", base, g("MatMul", g("Reshape", condition, [1, conditions]), entry)))
    rows = g("Concat", g("Mul", slope, entry), first, axis=0)
    per_head = g("Transpose", g("Reshape", rows, [conditions + 1, heads, width]), perm=[1, 0, 2])
    deep = g("MatMul", per_head, g.weights["net.heads.hidden_weight"])
    tangents, last = g.rows(deep, 0, conditions, axis=1), g.rows(deep, conditions, conditions + 1, axis=1)
    second, slope = _silu_and_slope(g, g("Add", last, g.weights["net.heads.hidden_bias"][:, None]))
    of_head = g("Concat", g("Mul", tangents, slope), second, axis=1)
    of_state = g("Gather", of_head, head_of_state(estimator.machine), axis=0)
    out = g("MatMul", of_state, g.weights["net.heads.out_weight"][:, :, None])  # (n, conditions + 1, 1)
    scaled = g("Add", g.rows(out, conditions, conditions + 1, axis=1), g.weights["net.heads.out_bias"][:, None, None])
    g("Mul", g("Reshape", scaled, [n]), model.increment, out="increment")
    units = model.increment[:, None] / np.append(model.state_scale, np.full(conditions - n, ZETA_SCALE))
    jacobian = g("Mul", g("Reshape", g.rows(out, 0, conditions, axis=1), [n, conditions]), units)
    # What acts on readings alone moves no state: its columns come from one of zeros behind the others.
    place = np.full(n + parts.health, conditions)
    place[:n], place[n + model.acting] = np.arange(n), np.arange(n, conditions)
    g("Gather", g("Concat", jacobian, np.zeros((n, 1)), axis=1), place, axis=1, out="jacobian")


def _silu_and_slope(g: _Graph, x: str) -> tuple[str, str]:
    """``silu(x)`` and its derivative, ``s + silu(x) (1 - s)`` with s the sigmoid."""
    gate = g("Sigmoid", x)
    value = g("Mul", x, gate)
    return value, g("Add", gate, g("Mul", value, g("Sub", np.array([1.0]), gate)))


def _one_of_each(machine: Machine) -> tuple[Growth, float, float]:
    """What noise grows with, and time constant and power of the lag, of a machine that has one of each.

    Raises:
        BadInput: it has not.
    """
    lags = followers(machine)
    growths = list({n.grows for n in machine.noise[len(machine.inputs) :] if n.grows})
    if len(lags) != 1 or len(growths) != 1:
        raise BadInput(
            f"the exported filter has one lag and one channel with which noise grows, {machine.name} has {len(lags)}"
            f" and {len(growths)}; its operator's graph can be had by methods.deeponet_kalman.export.operator_graph"
        )
    theta, (lag,) = machine.plant.theta(), lags
    power = float(theta[machine.plant.index(lag.exponent)]) if lag.exponent else 0.0
    return growths[0], float(theta[machine.plant.index(lag.tau_s)]), power


def _mean_noise(estimator: DeepONetKalman) -> Array:
    """Q (N, N) of one tick in the units of z squared, with the mean walk of health over all modes."""
    modes, health = estimator.model.modes, np.arange(estimator.parts.zeta, estimator.parts.noise)
    Q = estimator.model.Q.copy()
    Q[health, health] = in_the_long_run(modes.turn) @ modes.walk
    return Q


def filter_arrays(estimator: DeepONetKalman) -> dict[str, np.ndarray]:
    """What a filter around the graph needs, for z as in ``methods.deeponet_kalman.augmented``.

    Returns:
        z0, P0: (N,), (N, N) before the first tick.
        F: (N, N) transition of one tick without the operator and the probe; Q (N, N) its noise, with the
            mean walk of health over all modes.
        H: (ny, N) of the readings without the bias and the coloured noise.
        z_low, z_high: (N,) bounds.
        probe_tau_s, probe_tau_x: the probe lags by ``tau_s mu**-tau_x`` seconds where what quickens it is mu.
        mean: (C,) stands in for readings before the first one.
        window: samples that the operator looks back.
        white, coloured: (ny,) noise sd of the outputs; times the reading where ``relative``, and times
            ``speed[0] + speed[1] v`` where ``with_speed``, v being the channel with which noise grows.
        low, span, slope, offset: (nh,) health is ``low + span / (1 + exp(-slope zeta - offset))``.

    Raises:
        BadInput: the machine has other parts than these arrays can say.
    """
    grows, tau_s, power = _one_of_each(estimator.machine)
    fresh, model, parts, health = (
        estimator.init(1).memory[0][0],
        estimator.model,
        estimator.parts,
        estimator.model.health,
    )
    n, noise, error = parts.states, parts.noise, parts.error
    F, H = np.eye(parts.size), np.zeros((parts.outputs, parts.size))
    F[:n, error:] = np.eye(n)
    np.fill_diagonal(F[noise:, noise:], np.append(model.noise_keep, np.full(n, model.error_keep)))
    H[range(parts.outputs), model.readings.source] = model.readings.gain
    z_low, z_high = np.full(parts.size, -np.inf), np.full(parts.size, np.inf)
    z_low[:n], z_low[parts.zeta : noise], z_high[parts.zeta : noise] = model.state_low, model.zeta_low, model.zeta_high
    slope = health.theta_and_slope(np.zeros(parts.health))[1]
    # An exponential is a logistic so far from its upper end that nobody tells the two apart.
    low = np.where(health.exponential, 0.0, health.low)
    span = np.where(health.exponential, health.healthy * EXPONENTIAL, health.high - low)
    share, (at_0, at_1) = (health.healthy - low) / span, grows.factor(np.array([0.0, 1.0]))
    return {
        "z0": fresh["z"],
        "P0": fresh["P"],
        "F": F,
        "Q": _mean_noise(estimator),
        "H": H,
        "z_low": z_low,
        "z_high": z_high,
        "probe_tau_s": np.array(tau_s),
        "probe_tau_x": np.array(power),
        "mean": estimator.front_end.mean,
        "window": np.array(estimator.config["window"]),
        "white": model.sheet.white,
        "coloured": model.sheet.coloured,
        "relative": model.sheet.relative,
        "with_speed": model.sheet.grows >= 0,
        "speed": np.array([at_0, at_1 - at_0]),
        "low": low,
        "span": span,
        "slope": slope / (span * share * (1.0 - share)),
        "offset": np.log(share / (1.0 - share)),
    }
