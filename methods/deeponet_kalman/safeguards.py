"""What keeps the filter sound when its assumptions fail: the logic of Fig. 2, one machine at a time.

- *Trust*: sensitivities of the operator count for less the farther the query lies outside the
  training envelope, and the operator's own error for more.
- *Observability*: the sensitivities of the last minute are stacked, scaled by the sensors' accuracy;
  health is corrected along the directions that they inform about, and along no other.
- *Adaptation*, Eqs. (13) and (14): noise beyond the data sheet widens R, innovations that keep
  pushing a health parameter the same way widen its random walk; both within bounds.
- *Gate*: a channel that is far off is left out for a few updates. What it means that it stays away, the modes weigh.

Each is a small function on arrays, which ``augmented`` calls in its tick; what it needs room for, it is given. Their
memory is of ``safety_type``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine
from twinbench.methods.deeponet_kalman.parts import Parts
from twinbench.methods.deeponet_kalman.records import record

FAR_MOST = 5
"""Updates for which a channel that is far off is left out at most. Then it is no glitch but a change."""
OBSERVED_S = 60.0
"""Memory of the stacked sensitivities."""
MOST_SENSITIVE = 1e4
"""Bound on what a state moves by for one unit of health, in its own unit; real ones stay below a hundred."""
LEAST_VARIANCE = 1e-12
"""Of a reading."""
KNOWN = 0.9
"""Share of its first sd below which a health parameter is known. More of it calls parameters known sooner."""
REFRESH = 20
"""Updates between two looks at their singular values."""
UPDATES, CHANNEL = 0, 1
"""Columns of counts: updates so far, then per channel consecutive ones left out."""
PUSH_S = 5.0
"""Memory of the direction of corrections."""
PUSHED = 6.63
"""99 % point of chi-square with one degree of freedom: what pushes no more than this is chance."""
MISMATCH_S = 25.0
"""Memory of Eq. (13), 1 / (1 - beta) ticks. Slower than the walk's, so that a change of health is not taken for
noise."""


class Memories(NamedTuple):
    """How much of what the safeguards have gathered stays at an update.

    Attributes:
        observed: of the stacked sensitivities.
        push: of the direction of corrections.
        mismatch: beta of Eq. (13).
    """

    observed: float
    push: float
    mismatch: float


def memories_of(machine: Machine) -> Memories:
    """At the sample period of a machine."""
    tick_s = machine.sample_period_s
    return Memories(*(max(1.0 - tick_s / seconds, 0.0) for seconds in (OBSERVED_S, PUSH_S, MISMATCH_S)))


def widest_of(machine: Machine) -> Array:
    """Variance (nh,) of health of which nothing is known, in coordinates: two sd reach the end of a machine's life."""
    ends = machine.coordinates.to_zeta(np.array([h.ends for h in machine.health]).T)
    return np.asarray((0.5 * np.abs(ends).max(axis=0)) ** 2)


class Settings(NamedTuple):
    """How strong each safeguard is, in brackets where it is off."""

    trust_reach: float  # distance outside the envelope at which sensitivities are halved, sd [inf]
    extrapolation: float  # growth of the process noise with distance [0]
    least_information: float  # of a direction of health, in units of the prior's, at which corrections are halved [0]
    q_gain: float  # gamma_q of Eq. (14) [0]
    q_most: float  # largest factor on the walk's variance
    r_gain: float  # the same for R, smaller [0]
    r_most: float
    channel_gate: float  # sd beyond which a channel is left out at first [inf]
    difference: float  # sensitivities by finite differences of this step instead of derivatives [0]


class Envelope(NamedTuple):
    """Where the operator was trained: a box in its standardised query.

    Attributes:
        low: (q,) standardised lower edges.
        high: (q,) standardised upper edges.
    """

    low: Array
    high: Array


def safety_type(parts: Parts) -> np.dtype[np.void]:
    """What the safeguards carry from update to update of one machine."""
    nh, ny = parts.health, parts.outputs
    return record(
        {
            "sensitivity": ("f8", (parts.zeta, nh)),  # of states and lags to health held constant
            "information": ("f8", (nh, nh)),  # of the last minute about health
            "observable": ("f8", (nh, nh)),  # projector onto what that informs about
            "mismatch": ("f8", (ny, ny)),  # C of Eq. (13)
            "push": ("f8", (nh,)),  # mean of the normalised corrections
            "unknown": ("i8", ()),  # updates for which the operator's query, or its window of it, is not known
            "counts": ("i8", (CHANNEL + ny,)),  # see the constants
        }
    )


def empty_safety(parts: Parts, batch: int) -> np.ndarray:
    """Of B machines (B,), before the first update."""
    safety = np.zeros(batch, safety_type(parts))
    safety["observable"] = np.eye(parts.health)
    return safety


@njit(cache=True, error_model="numpy")
def distance(envelope, query):  # type: ignore[no-untyped-def]
    """How far a standardised query (q,) lies outside the training envelope, in training sd; 0 inside."""
    square = 0.0
    for i in range(query.size):
        beyond = max(envelope.low[i] - query[i], query[i] - envelope.high[i], 0.0)
        square += beyond * beyond
    return np.sqrt(square)


@njit(cache=True, error_model="numpy")
def trust(settings, away):  # type: ignore[no-untyped-def]
    """Trust coefficient in (0, 1] that multiplies G of Eq. (5), at a distance from the envelope."""
    return 1.0 / (1.0 + (away / settings.trust_reach) ** 2)


@njit(cache=True, error_model="numpy")
def carry_sensitivity(sensitivity, F, at, after):  # type: ignore[no-untyped-def]
    """X <- F_x X + G in place: what health, had it always been a little different, would have changed by now.

    Args:
        sensitivity: (m, nh).
        F: (n, n) transition Jacobian; the m states and lags come first, health from ``at`` on.
        after: (m, nh) scratch.
    """
    moving, health = sensitivity.shape
    for i in range(moving):
        for j in range(health):
            s = F[i, at + j]
            for k in range(moving):
                s += F[i, k] * sensitivity[k, j]
            # Far from any machine, where broken sensors lead, the operator may be unstable.
            after[i, j] = min(max(s, -MOST_SENSITIVE), MOST_SENSITIVE)
    for i in range(moving):
        for j in range(health):
            sensitivity[i, j] = after[i, j]


@njit(cache=True, error_model="numpy")
def gather(keep, information, sensitivity, H, at, accuracy, used, row):  # type: ignore[no-untyped-def]
    """Let the information (nh, nh) of the last minute take in one update, in place.

    The function takes plain arrays because it is compiled.

    Args:
        keep: how much of it stays.
        H: (ny, n) measurement Jacobian.
        accuracy: (ny,) variance of a reading that counts as independent.
        used: (ny,) innovations of the channels that were used, NaN where none.
        row: (nh,) scratch.
    """
    moving, health = sensitivity.shape
    for i in range(health):
        for j in range(health):
            information[i, j] *= keep
    for c in range(used.size):
        if np.isnan(used[c]):
            continue
        for j in range(health):
            row[j] = H[c, at + j]
            for k in range(moving):
                row[j] += H[c, k] * sensitivity[k, j]
        for i in range(health):
            for j in range(health):
                information[i, j] += row[i] * row[j] / max(accuracy[c], LEAST_VARIANCE)


@njit(cache=True, error_model="numpy")
def informed(information, least, observable, room):  # type: ignore[no-untyped-def]
    """Projector onto the directions of health that are known well enough, into ``observable`` (nh, nh).

    Not a sharp one: which directions those are changes with the load, and a correction that came
    and went with it would shake health. At ``least`` it is a half: an eigenvalue a counts for
    a^2 / (a^2 + least^2), the real part of a / (a + i least), so that it takes a linear solve and no eigenvectors.
    Pivots are not needed: every leading block has a definite imaginary part.

    Args:
        room: (nh, 2 nh) complex scratch.
    """
    n = information.shape[0]
    for i in range(n):
        for j in range(n):
            room[i, j] = room[i, n + j] = information[i, j]
        room[i, i] += 1j * least
    for k in range(n):
        for i in range(n):
            if i != k:
                factor = room[i, k] / room[k, k]
                for j in range(k, 2 * n):
                    room[i, j] -= factor * room[k, j]
    for i in range(n):
        for j in range(n):
            observable[i, j] = (room[i, n + j] / room[i, i]).real


@njit(cache=True, error_model="numpy")
def note_mismatch(keep, C, innovation, explained):  # type: ignore[no-untyped-def]
    """Eq. (13) in place, beta being ``keep``: C (ny, ny), innovation (ny,), NaN where missing, explained = H P H'."""
    for i in range(innovation.size):
        for j in range(innovation.size):
            product = innovation[i] * innovation[j]
            if not np.isnan(product):
                C[i, j] = keep * C[i, j] + (1.0 - keep) * (product - explained[i, j])


@njit(cache=True, error_model="numpy")
def noise_factor(settings, keep, C, R, updates, channel):  # type: ignore[no-untyped-def]
    """By how much one channel's variance R is widened: never narrowed, at most ``r_most``.

    A running mean over n updates of a chi-square scatters by sqrt(2 / n): within three of these, all is well.
    """
    seen = min(float(updates), 0.5 * (1.0 + keep) / (1.0 - keep))
    if seen < 1.0:
        return 1.0
    weight = 1.0 - keep**updates
    excess = C[channel, channel] / (weight * R) - 1.0 - 3.0 * np.sqrt(2.0 / seen)
    return min(1.0 + settings.r_gain * max(excess, 0.0), settings.r_most)


@njit(cache=True, error_model="numpy")
def note_push(keep, push, correction, variance):  # type: ignore[no-untyped-def]
    """Running mean, in place, of health corrections (nh,) over their expected sd."""
    for i in range(push.size):
        normal = correction[i] / np.sqrt(variance[i]) if variance[i] > 0.0 else 0.0
        push[i] = keep * push[i] + (1.0 - keep) * min(max(normal, -6.0), 6.0)


@njit(cache=True, error_model="numpy")
def walk_factor(settings, keep, push):  # type: ignore[no-untyped-def]
    """Eq. (14) for one parameter: exp(gamma d), d being how far beyond chance it is pushed one way."""
    beyond = push * push * (1.0 + keep) / (1.0 - keep) - PUSHED
    return min(np.exp(settings.q_gain * max(beyond, 0.0)), settings.q_most)


@njit(cache=True, error_model="numpy")
def left_out(settings, counts, innovation, S):  # type: ignore[no-untyped-def]
    """Take channels that are far off out of ``innovation`` (ny,), in place: NaN; a shift that lasts comes back."""
    for c in range(innovation.size):
        if np.isnan(innovation[c]):
            continue
        far = abs(innovation[c]) > settings.channel_gate * np.sqrt(S[c, c])
        if far and counts[CHANNEL + c] < FAR_MOST:
            counts[CHANNEL + c] += 1
            innovation[c] = np.nan
        elif not far:
            counts[CHANNEL + c] = 0


@njit(cache=True, error_model="numpy")
def bound_health(P, at, most, column):  # type: ignore[no-untyped-def]
    """Keep the variance of each health parameter within ``most`` (nh,) by a reading of it that brings no news.

    The update of Eq. (11) with zero innovation and the noise at which the variance comes out at ``most``;
    clipping it instead would break its correlations. ``column`` (n,) is scratch.
    """
    n = P.shape[0]
    for i in range(most.size):
        j = at + i
        variance = P[j, j]
        if variance > most[i]:
            for a in range(n):
                column[a] = P[a, j]
            share = (variance - most[i]) / variance**2
            for a in range(n):
                for b in range(n):
                    P[a, b] -= share * column[a] * column[b]
