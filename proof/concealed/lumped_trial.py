"""How fast a random network is, and where it goes when it is operated."""

from __future__ import annotations

import numpy as np

from twinbench.physics.simulator import Array
from twinbench.proof.concealed.integrate import Equations, Parameters, Steps, run
from twinbench.proof.concealed.lumped_law import STILL, law, packed, states
from twinbench.proof.concealed.lumped_parts import Drive, Rhythm, rates_of
from twinbench.proof.concealed.networks import Sketch
from twinbench.proof.lumped.network import Network
from twinbench.proof.lumped.twin import steady

MOST_SPREAD = 30.0
"""Slowest time constant over the fastest: a decade and a half."""
_SAMPLES = (1000, 2000)
_TRIAL, _STEPS_EACH = 1500, 6  # samples of the run that finds out where a network goes, and integration steps of each


def rhythm_of(network: Network, sketch: Sketch, rng: np.random.Generator) -> Rhythm | None:
    """By the equations linearised in the middle of the inputs' ranges; None where they are unstable or stiff."""
    rhs, theta = rates_of(network), np.array([v.nominal for v in network.parameters])
    u = np.array([0.5 * (low + high) for *_, low, high in sketch.inputs.values()])
    x = _middle(network, sketch, u)
    steps = np.diag(1e-5 * np.maximum(np.abs(x), 1e-3))
    slope = np.stack([(rhs(x + s, u, theta) - rhs(x - s, u, theta)) / (2.0 * s.sum()) for s in steps], axis=-1)
    if not np.isfinite(slope).all():
        return None
    own = np.linalg.eigvals(slope)
    fastest, slowest = 1.0 / np.abs(own).max(), 1.0 / np.abs(own.real).min()
    if (own.real >= 0.0).any() or slowest > MOST_SPREAD * fastest:
        return None
    period_s = float(f"{fastest * rng.uniform(0.1, 0.25):.2g}")
    return Rhythm(period_s, slowest, int(np.clip(25.0 * slowest / period_s, *_SAMPLES)))


def trial(network: Network, sketch: Sketch, rhythm: Rhythm, rng: np.random.Generator) -> tuple[Array, Array]:
    """States (2 N, nx) and inputs (2 N, nu) of a run in either regime, each in its unit."""
    drive = Drive.of(sketch, rhythm)
    p = np.array(list(packed(network, (), STILL, np.inf).values()))
    xs, us = [], []
    for regime in ("train", "held"):
        u = drive(rng, _TRIAL * rhythm.period_s, regime)
        x0, steps = _middle(network, sketch, u[0]), Steps(0.0, rhythm.period_s, _STEPS_EACH)
        xs.append(run(Equations(law, states, len(x0)), steps, u, x0, Parameters.steady(p))[0])
        us.append(u)
    return np.concatenate(xs), np.concatenate(us)


def _middle(network: Network, sketch: Sketch, u: Array) -> Array:
    """The steady state under inputs u (nu,)."""
    guess = np.array([sketch.guess.get(v.name, 0.0) for v in network.states])
    theta = np.array([v.nominal for v in network.parameters])
    return steady(rates_of(network), u, theta, guess, np.maximum(0.3 * np.abs(guess), 1e-3))
