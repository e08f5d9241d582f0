"""DeepONet-Kalman in each of its forms, its operator alone in each of its own, and with windows of other lengths."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any

import numpy as np
import torch
from numba import njit

from twinbench.bench.latency.estimators import samples
from twinbench.bench.latency.timing import Name, Timed
from twinbench.machines.coordinates import Array
from twinbench.methods.deeponet_kalman.cycle import scratch, take_in
from twinbench.methods.deeponet_kalman.method import DeepONetKalman
from twinbench.methods.deeponet_kalman.online import Online
from twinbench.methods.deeponet_kalman.plain import PlainTwin
from twinbench.methods.deeponet_kalman.stream import heads_with_jacobian
from twinbench.methods.operator import KERNEL

WINDOWS = (16, 32, 64, 128, 256)
IN_PLACE, PLAIN, OPERATOR = "in place", "plain torch", "operator"


def with_window(twin: DeepONetKalman, window: int) -> DeepONetKalman:
    """The same weights on another window, which time does not tell from weights trained on it."""
    other = DeepONetKalman(twin.machine, **{**twin.config, "window": window})
    other.arrays = {**twin.arrays, "net.branch.position": np.zeros(window // KERNEL**2, np.float32)}
    other.restore()
    return other


def whole_updates(twin: DeepONetKalman, readings: Array) -> Iterator[Timed]:
    """One machine in place, for each window, and the plain form in single precision.

    Args:
        readings: (N, nu + ny) in the channels' units; NaN means missing.
    """
    rows = list(readings)
    for window in WINDOWS:
        yield Timed(Name(twin.name, IN_PLACE, window), Online(with_window(twin, window)).update, rows)
    plain = PlainTwin(twin, torch.float32)
    yield Timed(Name(twin.name, PLAIN, twin.config["window"]), plain.update, samples(readings, twin.machine))


def operators(twin: DeepONetKalman, filled: Array) -> Iterator[Timed]:
    """The operator alone, its window taking in a sample and its increments with their Jacobian coming out.

    As ONNX only where onnx and onnxruntime are installed.

    Args:
        filled: (N, nu + ny) in the channels' units, none missing.
    """
    window = twin.config["window"]
    forms = {"compiled": _compiled, "ONNX": _onnx, "torch": _torch}
    if not (find_spec("onnx") and find_spec("onnxruntime")):
        del forms["ONNX"]
    for form, make in forms.items():
        yield Timed(Name(OPERATOR, form, window), make(twin), list(filled))


@njit(cache=True, error_model="numpy")
def _advance(weights, twin, memory, t, readings):  # type: ignore[no-untyped-def]
    m, room = memory[0], t[0]
    take_in(weights[0], twin[0], m, readings, room)
    heads_with_jacobian(weights[0], room.filter.operator, m.stream.base, room.filter.operator.condition)


def _compiled(twin: DeepONetKalman) -> Callable[[Array], object]:
    memory, room = twin.init(1).memory[0].copy(), scratch(twin.weights, twin.parts)
    room["mask"] = 1.0
    return lambda readings: _advance(twin.weights, twin.twin, memory, room, readings)


def _onnx(twin: DeepONetKalman) -> Callable[[Array], object]:
    import onnxruntime

    from twinbench.methods.deeponet_kalman.export import operator_graph

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(operator_graph(twin), options)
    single, window = np.float32, twin.config["window"]
    feed: dict[str, Any] = {i.name: np.zeros(i.shape, single) for i in session.get_inputs()}
    feed["x"], feed["window"] = single(twin.model.state_mean), np.tile(single(twin.front_end.mean), (window, 1))
    feed["mask"][:], feed["masks"][:] = 1.0, 1.0

    def update(readings: Array) -> None:
        feed["values"] = readings.astype(single)
        _, _, feed["window"], feed["masks"], feed["slow"] = session.run(None, feed)

    return update


def _torch(twin: DeepONetKalman) -> Callable[[Array], object]:
    plain, everything = PlainTwin(twin, torch.float32), np.ones(len(twin.machine.channels))

    def update(readings: Array) -> None:
        plain.ticks += 1
        plain.take_in(readings, everything)
        plain.increments()

    return update
