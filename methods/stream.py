"""The operator on a stream: only the newest column of each convolution is computed at a tick.

The same numbers as ``methods.operator`` on whole windows (a test holds them to 1e-5), with the
sensitivities to state and health carried forward through the heads by hand (forward-mode
differentiation). Before the first sample the window is taken to be filled with that sample.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from data.batch import SAMPLE_PERIOD_S
from methods.operator import (
    HEAD_OF_STATE,
    KERNEL,
    N_CHANNELS,
    N_COLUMNS,
    N_HEADS,
    N_QUERY,
    N_SLOW,
    N_STATES,
    N_ZETA,
    SINUSOIDS,
    SLOW_TAU_S,
)

REACH_1 = KERNEL * (KERNEL - 1) + 1  # columns of block 1 that one column of block 2 looks at
ZETA_SCALE = 4.0
FAST = {"reassoc", "contract", "arcp", "nsz"}
"""Liberties with the order of sums; none with infinities, which a broken sensor can bring."""
LIMIT = 10.0
"""Standardised values are held within this many spreads of the training mean."""
_HEAD_OF_STATE = np.array(HEAD_OF_STATE)
_SLOW_KEEP = np.exp(-SAMPLE_PERIOD_S / np.array(SLOW_TAU_S)).astype(np.float32)


class Encoder(NamedTuple):
    """Weights of branch and trunk as float32 arrays, matrices as (out, in)."""

    block_1: np.ndarray
    block_1_bias: np.ndarray
    block_2: np.ndarray
    block_2_bias: np.ndarray
    mix_2: np.ndarray
    mix_2_bias: np.ndarray
    gate_tanh: np.ndarray
    gate_tanh_bias: np.ndarray
    gate_sigmoid: np.ndarray
    gate_sigmoid_bias: np.ndarray
    score: np.ndarray
    position: np.ndarray
    project: np.ndarray
    project_bias: np.ndarray
    embedding: np.ndarray
    embedding_bias: np.ndarray
    trunk_hidden: np.ndarray
    trunk_hidden_bias: np.ndarray
    trunk_project: np.ndarray
    trunk_project_bias: np.ndarray
    from_latent: np.ndarray
    from_latent_bias: np.ndarray


class Heads(NamedTuple):
    """Weights of the heads that meet state and health."""

    from_condition: np.ndarray
    hidden: np.ndarray
    hidden_bias: np.ndarray
    out: np.ndarray
    out_bias: np.ndarray


class Weights(NamedTuple):
    """The operator's weights. Compiled functions take the part that they need: each array costs compile time."""

    encoder: Encoder
    heads: Heads


def pack(state: dict[str, np.ndarray]) -> Weights:
    """Weights from a state dict of ``Operator`` whose names start with ``net.``."""

    def get(name: str) -> np.ndarray:
        return np.ascontiguousarray(state["net." + name], dtype=np.float32)

    def layer(name: str) -> tuple[np.ndarray, np.ndarray]:
        return get(name + ".weight"), get(name + ".bias")

    encoder = Encoder(
        *layer("branch.block_1"),
        *layer("branch.block_2"),
        *layer("branch.mix_2"),
        *layer("branch.gate_tanh"),
        *layer("branch.gate_sigmoid"),
        get("branch.score.weight")[0],
        get("branch.position"),
        *layer("branch.project"),
        *layer("trunk.embedding"),
        *layer("trunk.hidden"),
        *layer("trunk.project"),
        *layer("heads.from_latent"),
    )
    heads = Heads(
        np.ascontiguousarray(get("heads.from_condition.weight").T),
        get("heads.hidden_weight"),
        get("heads.hidden_bias"),
        get("heads.out_weight"),
        get("heads.out_bias"),
    )
    return Weights(encoder, heads)


class Stream(NamedTuple):
    """What the operator carries from tick to tick, B machines."""

    ticks: np.ndarray  # (B,) int64, samples pushed so far
    values: np.ndarray  # (B, window, 7) standardised, newest last
    columns: np.ndarray  # (B, KERNEL, 21) newest last
    first: np.ndarray  # (B, REACH_1, width_1) newest last
    tokens: np.ndarray  # (B, reach_2, width_2) newest last; the attention looks at every 16th
    scores: np.ndarray  # (B, reach_2)
    slow: np.ndarray  # (B, 2) running means of the discharge temperature
    base: np.ndarray  # (B, heads * width) the heads' first layer, latent part


def empty_stream(weights: Weights, batch: int) -> Stream:
    """Before the first sample."""
    encoder = weights.encoder
    tokens = len(encoder.position)
    reach_2 = KERNEL**2 * (tokens - 1) + 1
    width_1, width_2 = len(encoder.block_1_bias), len(encoder.block_2_bias)
    shapes = (
        (KERNEL**2 * tokens, N_CHANNELS),
        (KERNEL, N_COLUMNS),
        (REACH_1, width_1),
        (reach_2, width_2),
        (reach_2,),
        (N_SLOW,),
        (len(encoder.from_latent_bias),),
    )
    parts = (np.zeros((batch, *shape), np.float32) for shape in shapes)
    return Stream(np.zeros(batch, np.int64), *parts)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _silu(v):  # type: ignore[no-untyped-def]
    return v / (np.float32(1.0) + np.exp(-v))


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _sigmoid(v):  # type: ignore[no-untyped-def]
    return np.float32(1.0) / (np.float32(1.0) + np.exp(-v))


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _normalise(v):  # type: ignore[no-untyped-def]
    return v / np.sqrt(np.mean(v * v) + np.float32(1e-6))


@njit(cache=True, error_model="numpy")
def fill(into, values):  # type: ignore[no-untyped-def]
    """``into[:] = values`` for vectors, spared the broadcasting that numba takes seconds to compile."""
    for i in range(into.size):
        into[i] = values[i]


@njit(cache=True, error_model="numpy")
def _shift(buffer, newest):  # type: ignore[no-untyped-def]
    for i in range(buffer.shape[0] - 1):
        for j in range(buffer.shape[1]):
            buffer[i, j] = buffer[i + 1, j]
    fill(buffer[-1], newest)


@njit(cache=True, fastmath=FAST, error_model="numpy", no_cpython_wrapper=True)  # type: ignore[call-overload]
def _push_one(w, values, columns, first, tokens, scores, sample, mask):  # type: ignore[no-untyped-def]
    """Append one standardised sample and compute the newest column of each block."""
    column = np.empty(N_COLUMNS, np.float32)
    for c in range(N_CHANNELS):
        column[c] = sample[c]
        column[N_CHANNELS + c] = sample[c] - values[-1, c]
        column[2 * N_CHANNELS + c] = mask[c]
    _shift(values, sample)
    _shift(columns, column)
    _shift(first, _silu(np.dot(w.block_1, columns.ravel()) + w.block_1_bias))
    width_1 = first.shape[1]
    reached = np.empty(KERNEL * width_1, np.float32)
    for i in range(KERNEL):
        fill(reached[i * width_1 : (i + 1) * width_1], first[i * KERNEL])
    second = _silu(np.dot(w.block_2, reached) + w.block_2_bias)
    token = second + _silu(np.dot(w.mix_2, second) + w.mix_2_bias)
    gated = np.tanh(np.dot(w.gate_tanh, token) + w.gate_tanh_bias) * _sigmoid(
        np.dot(w.gate_sigmoid, token) + w.gate_sigmoid_bias
    )
    _shift(tokens, token)
    for i in range(scores.size - 1):
        scores[i] = scores[i + 1]
    scores[-1] = np.dot(w.score, gated)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def push(w, ticks, values, columns, first, tokens, scores, slow, base, sample, mask, query):  # type: ignore[no-untyped-def]
    """One tick of one machine, in place: window, convolutions, latent, first layer of the heads.

    Args:
        sample, mask: (7,) standardised values and 1 where accepted.
        query: (5,) standardised inputs that hold until the next tick.
    """
    sample = np.minimum(np.maximum(sample, -LIMIT), LIMIT).astype(np.float32)
    temperature = sample[5]
    window = values.shape[0]
    if ticks[0] == 0:
        for k in range(window):
            fill(values[k], sample)
        for i in range(N_SLOW):
            slow[i] = temperature
        for _ in range(window):
            _push_one(w, values, columns, first, tokens, scores, sample, mask)
    else:
        for i in range(N_SLOW):
            slow[i] = _SLOW_KEEP[i] * slow[i] + (np.float32(1.0) - _SLOW_KEEP[i]) * temperature
        _push_one(w, values, columns, first, tokens, scores, sample, mask)
    ticks[0] += 1

    width_2 = tokens.shape[1]
    weight = np.empty(w.position.size, np.float32)
    for i in range(weight.size):
        weight[i] = scores[i * KERNEL**2] + w.position[i]
    weight = np.exp(weight - np.max(weight))
    weight /= np.sum(weight)
    summary = np.zeros(2 * width_2 + 2 * N_CHANNELS + N_SLOW, np.float32)
    for i in range(weight.size):
        for j in range(width_2):
            summary[j] += weight[i] * tokens[i * KERNEL**2, j]
    fill(summary[width_2 : 2 * width_2], tokens[-1])
    at = 2 * width_2
    for c in range(N_CHANNELS):
        mean = np.float32(0.0)
        for k in range(window):
            mean += values[k, c]
        mean /= np.float32(window)
        square = np.float32(0.0)
        for k in range(window):
            square += (values[k, c] - mean) ** 2
        summary[at + c] = mean
        summary[at + N_CHANNELS + c] = np.sqrt(square / np.float32(window) + np.float32(1e-6))
    for i in range(N_SLOW):
        summary[at + 2 * N_CHANNELS + i] = temperature - slow[i]
    branch = _normalise(np.dot(w.project, summary) + w.project_bias)
    fill(base, np.dot(w.from_latent, branch * trunk(w, query, SAMPLE_PERIOD_S)) + w.from_latent_bias)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def trunk(w, query, time_s):  # type: ignore[no-untyped-def]
    """Trunk features of one standardised query (5,) at ``time_s``."""
    query = np.minimum(np.maximum(query, -LIMIT), LIMIT).astype(np.float32)
    embedded = _silu(np.dot(w.embedding, query[:2].copy()) + w.embedding_bias)
    n = embedded.size
    entry = np.empty(N_QUERY + n + 1 + 2 * len(SINUSOIDS), np.float32)
    fill(entry[:N_QUERY], query)
    fill(entry[N_QUERY : N_QUERY + n], embedded)
    at = N_QUERY + n
    entry[at] = np.float32(time_s / SAMPLE_PERIOD_S)
    for i in range(len(SINUSOIDS)):
        phase = time_s * (np.pi / 0.1) * SINUSOIDS[i]
        entry[at + 1 + i] = np.float32(np.sin(phase))
        entry[at + 1 + len(SINUSOIDS) + i] = np.float32(np.cos(phase))
    hidden = _silu(np.dot(w.trunk_hidden, entry) + w.trunk_hidden_bias)
    return _normalise(np.dot(w.trunk_project, hidden) + w.trunk_project_bias)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def heads(w, base, condition):  # type: ignore[no-untyped-def]
    """Scaled increments (5,) of one machine; no sensitivities."""
    width = w.hidden.shape[1]
    first = _silu(base + np.dot(condition, w.from_condition))
    second = np.empty((N_HEADS, width), np.float32)
    for h in range(N_HEADS):
        fill(second[h], _silu(np.dot(first[h * width : (h + 1) * width], w.hidden[h]) + w.hidden_bias[h]))
    out = np.empty(N_STATES, np.float32)
    for s in range(N_STATES):
        out[s] = np.dot(second[_HEAD_OF_STATE[s]], w.out[s]) + w.out_bias[s]
    return out


@njit(cache=True, fastmath=FAST, error_model="numpy")
def heads_with_jacobian(w, base, condition):  # type: ignore[no-untyped-def]
    """Scaled increments (5,) and their Jacobian (5, 9) to state and zeta, Eq. (5)."""
    width = w.hidden.shape[1]
    n = N_STATES + N_ZETA
    one = np.float32(1.0)
    entry = base + np.dot(condition, w.from_condition)
    gate = _sigmoid(entry)
    first = entry * gate
    slope = gate * (one + entry * (one - gate))
    rows = np.empty((n + 1, width), np.float32)
    second = np.empty((N_HEADS, n + 1, width), np.float32)
    for h in range(N_HEADS):
        at = h * width
        for j in range(width):
            for i in range(n):
                rows[i, j] = w.from_condition[i, at + j] * slope[at + j]
            rows[n, j] = first[at + j]
        np.dot(rows, w.hidden[h], second[h])
        for j in range(width):
            e = second[h, n, j] + w.hidden_bias[h, j]
            g = _sigmoid(e)
            d = g * (one + e * (one - g))
            second[h, n, j] = e * g
            for i in range(n):
                second[h, i, j] *= d
    out = np.empty(N_STATES, np.float32)
    jacobian = np.empty((N_STATES, n), np.float32)
    for s in range(N_STATES):
        column = np.dot(second[_HEAD_OF_STATE[s]], w.out[s])
        fill(jacobian[s], column[:n])
        out[s] = column[n] + w.out_bias[s]
    return out, jacobian


@njit(cache=True, error_model="numpy")
def heads_with_differences(w, base, condition, step):  # type: ignore[no-untyped-def]
    """As ``heads_with_jacobian`` by forward differences of ``step``, for comparison: the price of not deriving."""
    out = heads(w, base, condition)
    jacobian = np.empty((N_STATES, N_STATES + N_ZETA), np.float32)
    for j in range(N_STATES + N_ZETA):
        moved = condition.copy()
        moved[j] += np.float32(step)
        ahead = heads(w, base, moved)
        for i in range(N_STATES):
            jacobian[i, j] = (ahead[i] - out[i]) / np.float32(step)
    return out, jacobian
