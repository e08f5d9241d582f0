"""The operator on a stream: only the newest column of each convolution is computed at a tick.

The same numbers as ``methods.operator`` on whole windows (a test holds them to 1e-5), with the
sensitivities to state and health carried forward through the heads by hand (forward-mode
differentiation). Before the first sample the window is taken to be filled with that sample.

Weights, memory and scratch are records of ``layout``, one argument each to a compiled function, and nothing is
allocated.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.methods.deeponet_kalman.layout import REACH_1
from twinbench.methods.operator import KERNEL

FAST = {"reassoc", "contract", "arcp", "nsz"}
"""Liberties with the order of sums; none with infinities, which a broken sensor can bring."""
STANDARDISED_LIMIT = np.float32(10.0)
"""Standardised values are held within this many spreads of the training mean."""


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _exp(v):  # type: ignore[no-untyped-def]
    """float32 exponential to an ulp or two, which compiles to vector code, as the library's does not."""
    v = min(max(v, np.float32(-87.0)), np.float32(88.0))
    n = np.floor(v * np.float32(1.44269504) + np.float32(0.5))
    r = v - n * np.float32(0.693359375) + n * np.float32(2.12194440e-4)
    p = np.float32(1.9875691500e-4)
    p = p * r + np.float32(1.3981999507e-3)
    p = p * r + np.float32(8.3334519073e-3)
    p = p * r + np.float32(4.1665795894e-2)
    p = p * r + np.float32(1.6666665459e-1)
    p = p * r + np.float32(5.0000001201e-1)
    p = p * r * r + r + np.float32(1.0)
    return p * np.int32((np.int32(n) + np.int32(127)) << np.int32(23)).view(np.float32)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _sigmoid(v):  # type: ignore[no-untyped-def]
    return np.float32(1.0) / (np.float32(1.0) + _exp(-v))


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _silu(v):  # type: ignore[no-untyped-def]
    """In place."""
    for i in range(v.size):
        v[i] *= _sigmoid(v[i])


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _normalise(v):  # type: ignore[no-untyped-def]
    """In place, to unit second moment."""
    square = np.float32(0.0)
    for i in range(v.size):
        square += v[i] * v[i]
    factor = np.float32(1.0) / np.sqrt(square / np.float32(v.size) + np.float32(1e-6))
    for i in range(v.size):
        v[i] *= factor


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _affine(W, bias, x, out):  # type: ignore[no-untyped-def]
    """``out = W x + bias``."""
    for i in range(W.shape[0]):
        total = bias[i]
        for j in range(W.shape[1]):
            total += W[i, j] * x[j]
        out[i] = total


@njit(cache=True, error_model="numpy")
def fill(into, values):  # type: ignore[no-untyped-def]
    """``into[:] = values`` for vectors, spared the broadcasting that numba takes seconds to compile."""
    for i in range(into.size):
        into[i] = values[i]


@njit(cache=True, error_model="numpy")
def _shift(buffer):  # type: ignore[no-untyped-def]
    """Rows move up by one; the last is free for what is new."""
    for i in range(buffer.shape[0] - 1):
        for j in range(buffer.shape[1]):
            buffer[i, j] = buffer[i + 1, j]


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _push_one(w, s, t, sample, mask):  # type: ignore[no-untyped-def]
    """Append one standardised sample and compute the newest column of each block."""
    values, columns, first, tokens = s.values, s.columns, s.first, s.tokens
    before, last, channels = s.newest[0], columns.shape[0] - 1, values.shape[1]
    now = before + 1 if before + 1 < values.shape[0] else 0
    _shift(columns)
    for c in range(channels):
        columns[last, c] = sample[c]
        columns[last, channels + c] = sample[c] - values[before, c]
        columns[last, 2 * channels + c] = mask[c]
        values[now, c] = sample[c]
    s.newest[0] = now
    _shift(first)
    _affine(w.block_1, w.block_1_bias, columns.reshape(columns.size), first[REACH_1 - 1])
    _silu(first[REACH_1 - 1])
    width_1 = first.shape[1]
    for i in range(KERNEL):
        for j in range(width_1):
            t.reached[i * width_1 + j] = first[i * KERNEL, j]
    _affine(w.block_2, w.block_2_bias, t.reached, t.second)
    _silu(t.second)
    _affine(w.mix_2, w.mix_2_bias, t.second, t.mixed)
    _silu(t.mixed)
    s.newest[1] = s.newest[1] + 1 if s.newest[1] + 1 < tokens.shape[0] else 0
    token = tokens[s.newest[1]]
    for j in range(token.size):
        token[j] = t.second[j] + t.mixed[j]
    _affine(w.gate_tanh, w.gate_tanh_bias, token, t.gated[0])
    _affine(w.gate_sigmoid, w.gate_sigmoid_bias, token, t.gated[1])
    score = np.float32(0.0)
    for j in range(w.score.size):
        tanh = np.float32(2.0) * _sigmoid(np.float32(2.0) * t.gated[0, j]) - np.float32(1.0)
        score += w.score[j] * tanh * _sigmoid(t.gated[1, j])
    s.scores[s.newest[1]] = score


@njit(cache=True, fastmath=FAST, error_model="numpy")
def push(w, s, t, sample, mask, query):  # type: ignore[no-untyped-def]
    """One tick of one machine, in place: window, convolutions, latent, first layer of the heads.

    Args:
        w: record of the weights.
        s: record of the machine's stream.
        t: record of scratch.
        sample: (C,) standardised values, which are bounded in place.
        mask: (C,) dimensionless, 1 where accepted.
        query: (q,) standardised, which holds until the next tick.
    """
    channels = s.values.shape[1]
    for c in range(channels):
        sample[c] = min(max(sample[c], -STANDARDISED_LIMIT), STANDARDISED_LIMIT)
    times = 1
    if s.ticks[0] == 0:
        times = s.values.shape[0]
        fill(s.values[s.newest[0]], sample)
        for i in range(s.slow.size):
            s.slow[i] = sample[w.slow_channel[i]]
    for i in range(s.slow.size):
        s.slow[i] = w.slow_keep[i] * s.slow[i] + (1.0 - w.slow_keep[i]) * sample[w.slow_channel[i]]
    for _ in range(times):
        _push_one(w, s, t, sample, mask)
    s.ticks[0] += 1
    _attend(w, s, t)
    at = 2 * s.tokens.shape[1]
    _moments(s.values, t.summary[at : at + 2 * channels])
    for i in range(s.slow.size):
        t.summary[at + 2 * channels + i] = sample[w.slow_channel[i]] - s.slow[i]
    _affine(w.project, w.project_bias, t.summary, t.latent)
    _normalise(t.latent)
    trunk(w, t, query)
    for i in range(t.latent.size):
        t.latent[i] *= t.trunk[i]
    _affine(w.from_latent, w.from_latent_bias, t.latent, s.base)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _attend(w, s, t):  # type: ignore[no-untyped-def]
    """The attended and the newest token, into the summary."""
    tokens, weight, width = s.tokens, t.weight, s.tokens.shape[1]
    most = np.float32(-np.inf)
    for i in range(weight.size):
        weight[i] = s.scores[_row(s, i, weight.size)] + w.position[i]
        most = max(most, weight[i])
    total = np.float32(0.0)
    for i in range(weight.size):
        weight[i] = _exp(weight[i] - most)
        total += weight[i]
    for j in range(width):
        t.summary[j] = np.float32(0.0)
        t.summary[width + j] = tokens[s.newest[1], j]
    for i in range(weight.size):
        share, token = weight[i] / total, tokens[_row(s, i, weight.size)]
        for j in range(width):
            t.summary[j] += share * token[j]


@njit(cache=True, error_model="numpy")
def _row(s, i, n):  # type: ignore[no-untyped-def]
    """Where the i-th of n attended tokens, the newest last, lies in the ring."""
    row = s.newest[1] - KERNEL**2 * (n - 1 - i)
    return row if row >= 0 else row + s.tokens.shape[0]


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _moments(values, out):  # type: ignore[no-untyped-def]
    """Mean and spread (2 C,) of the window's channels."""
    n, channels = np.float32(values.shape[0]), values.shape[1]
    for c in range(2 * channels):
        out[c] = np.float32(0.0)
    for k in range(values.shape[0]):
        for c in range(channels):
            out[c] += values[k, c] / n
    for k in range(values.shape[0]):
        for c in range(channels):
            out[channels + c] += (values[k, c] - out[c]) ** 2 / n
    for c in range(channels):
        out[channels + c] = np.sqrt(out[channels + c] + np.float32(1e-6))


@njit(cache=True, fastmath=FAST, error_model="numpy")
def trunk(w, t, query):  # type: ignore[no-untyped-def]
    """Trunk features a tick ahead of one standardised query (q,), into ``t.trunk``."""
    entry, n = t.entry, t.query.size
    for i in range(n):
        entry[i] = t.query[i] = min(max(query[i], -STANDARDISED_LIMIT), STANDARDISED_LIMIT)
    _affine(w.embedding, w.embedding_bias, t.query[: w.embedding.shape[1]], t.embedded)
    _silu(t.embedded)
    at = n + t.embedded.size
    fill(entry[n:at], t.embedded)
    fill(entry[at:], w.time)
    _affine(w.trunk_hidden, w.trunk_hidden_bias, entry, t.trunk_hidden)
    _silu(t.trunk_hidden)
    _affine(w.trunk_project, w.trunk_project_bias, t.trunk_hidden, t.trunk)
    _normalise(t.trunk)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _enter(w, base, condition, head):  # type: ignore[no-untyped-def]
    """The heads' first layer before its nonlinearity."""
    for j in range(head.size):
        head[j] = base[j]
    for i in range(w.from_condition.shape[0]):
        for j in range(head.size):
            head[j] += condition[i] * w.from_condition[i, j]


@njit(cache=True, fastmath=FAST, error_model="numpy")
def heads(w, t, base, condition, out):  # type: ignore[no-untyped-def]
    """Scaled increments of one machine into ``out`` (n,); no sensitivities."""
    width = w.hidden.shape[1]
    _enter(w, base, condition, t.head)
    _silu(t.head)
    for h in range(w.hidden.shape[0]):
        deep = t.deep[h, 0]
        fill(deep, w.hidden_bias[h])
        for i in range(width):
            for j in range(width):
                deep[j] += t.head[h * width + i] * w.hidden[h, i, j]
        _silu(deep)
    for s in range(w.out.shape[0]):
        deep, total = t.deep[w.head_of_state[s], 0], w.out_bias[s]
        for j in range(width):
            total += deep[j] * w.out[s, j]
        out[s] = total


@njit(cache=True, fastmath=FAST, error_model="numpy")
def heads_with_jacobian(w, t, base, condition):  # type: ignore[no-untyped-def]
    """Scaled increments into ``t.out`` and their Jacobian to state and zeta into ``t.jacobian``, Eq. (5)."""
    width, n, one = w.hidden.shape[1], w.from_condition.shape[0], np.float32(1.0)
    _enter(w, base, condition, t.head)
    for j in range(t.head.size):
        gate = _sigmoid(t.head[j])
        t.slope[j] = gate * (one + t.head[j] * (one - gate))
        t.head[j] *= gate
    for h in range(w.hidden.shape[0]):
        at, deep = h * width, t.deep[h]
        for i in range(n):
            for j in range(width):
                t.rows[i, j] = w.from_condition[i, at + j] * t.slope[at + j]
        for j in range(width):
            t.rows[n, j] = t.head[at + j]
        np.dot(t.rows, w.hidden[h], deep)
        for j in range(width):
            e = deep[n, j] + w.hidden_bias[h, j]
            gate = _sigmoid(e)
            t.second_slope[j] = gate * (one + e * (one - gate))
            deep[n, j] = e * gate
        for i in range(n):
            for j in range(width):
                deep[i, j] *= t.second_slope[j]
    for s in range(w.out.shape[0]):
        deep = t.deep[w.head_of_state[s]]
        for i in range(n + 1):
            total = np.float32(0.0)
            for j in range(width):
                total += deep[i, j] * w.out[s, j]
            if i < n:
                t.jacobian[s, i] = total
            else:
                t.out[s] = total + w.out_bias[s]


@njit(cache=True, error_model="numpy")
def heads_with_differences(w, t, base, condition, step):  # type: ignore[no-untyped-def]
    """As ``heads_with_jacobian`` by forward differences of ``step``, for comparison: the price of not deriving."""
    heads(w, t, base, condition, t.out)
    fill(t.moved, condition)
    for j in range(w.from_condition.shape[0]):
        t.moved[j] += np.float32(step)
        heads(w, t, base, t.moved, t.ahead)
        t.moved[j] = condition[j]
        for i in range(w.out.shape[0]):
            t.jacobian[i, j] = (t.ahead[i] - t.out[i]) / np.float32(step)
