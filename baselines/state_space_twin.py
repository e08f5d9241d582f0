"""The state-space network of ``baselines.state_space`` as a compiled recurrence, for the online cycle."""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.baselines.recurrent import ReadoutTwin
from twinbench.baselines.state_space import NORM_EPS


class StateSpaceTwin(ReadoutTwin):
    """The same network as a compiled recurrence.

    Args:
        arrays: by name, weights of any shape, dimensionless; what does not start with ``prefix`` is left out.
        prefix: of the names.
    """

    def __init__(self, arrays: dict[str, np.ndarray], prefix: str = "net.") -> None:
        super().__init__(arrays, prefix)
        w = self.weights
        self.entry = np.ascontiguousarray(w["entry.weight"]), w["entry.bias"]
        count = sum(name.endswith("log_rate") for name in w)

        def stacked(name: str) -> np.ndarray:
            return np.stack([w[f"layers.{i}.{name}"] for i in range(count)])

        names = ("pace.weight", "pace.bias", "enter.weight", "leave.weight", "past", "gate.weight", "gate.bias")
        self.layers = (np.exp(stacked("log_rate")), *(stacked(name) for name in names))

    def init(self, batch: int) -> tuple[np.ndarray, np.ndarray]:
        """What is read out (B, hidden), and the layers' states one after another (B, layers P)."""
        hidden, states = len(self.entry[1]), self.layers[0].size
        return np.zeros((batch, hidden), np.float32), np.zeros((batch, states), np.float32)

    def step(self, h: np.ndarray, c: np.ndarray, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One slow step.

        Args:
            h: (B, hidden) dimensionless; the recurrence does not read it.
            c: (B, layers * P) dimensionless states.
            features: (B, F) standardised.
        """
        h, c = np.empty_like(h), c.copy()
        _step(np.ascontiguousarray(features, np.float32), self.entry, self.layers, h, c)
        return h, c


@njit(cache=True, error_model="numpy")
def _sigmoid_of(v):  # type: ignore[no-untyped-def]
    return np.float32(0.5) * (np.float32(1.0) + np.tanh(np.float32(0.5) * v))


@njit(cache=True, error_model="numpy")
def _step(features, entry, layers, h, c):  # type: ignore[no-untyped-def]
    """All layers for B machines, one after another: written into h (B, hidden) and c (B, layers P), states before."""
    rate, pace, pace_bias, enter, leave, past, gate, gate_bias = layers
    count, P = rate.shape
    for b in range(features.shape[0]):
        value = entry[0] @ features[b] + entry[1]
        for i in range(count):
            apart = value - value.mean()
            read = apart / np.sqrt((apart * apart).mean() + np.float32(NORM_EPS))
            s = c[b, i * P : (i + 1) * P]
            pushed, driven = pace[i] @ read + pace_bias[i], enter[i] @ read
            for k in range(P):
                softplus = max(pushed[k], np.float32(0.0)) + np.log1p(np.exp(-abs(pushed[k])))
                keep = np.exp(-softplus * rate[i, k])
                s[k] = keep * s[k] + (np.float32(1.0) - keep) * driven[k]
            said = leave[i] @ s + past[i] * read
            said = said * _sigmoid_of(said)
            value = value + said * _sigmoid_of(gate[i] @ said + gate_bias[i])
        h[b] = value
