"""What a step of a sensor means: a fault begins, or one ends. One machine at a time.

While a sensor drifts, no filter can tell it from the machine, and health gives way to it. But a fault ends at once,
and health does not change at once: where the readings of pressure or flow step, and health has moved unusually
far in the last two minutes, what steps is the sensor coming back, and health goes back to where it was.
Otherwise the step is where a fault begins, and the channel is left out until it fits again. A shift of
the discharge temperature may last, since its sensor has a bias to be estimated: it is left out for a second only.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.methods.deeponet_kalman.records import record
from twinbench.physics.health import HEALTHY

N_HEALTH, N_OUTPUTS = len(HEALTHY), 3
TEMPERATURE = 1
"""Of the outputs: the one whose sensor has a bias among the health parameters."""
SLACK_SD, LIMIT_SD, MOST_SD = 1.0, 7.0, 5.0
"""Of the cumulative sum of standardised innovations: what each may be off for nothing, what the sum must reach, and
what one innovation counts at most, so that a single outlier is no step."""
LEFT_OUT_UPDATES = (2400, 20, 2400)
"""For which a channel is left out at most, order OUTPUTS: two minutes, a second."""
FITS_SD, FITS_UPDATES = 2.0, 10
"""A channel fits again whose readings have been so near for half a second."""
KEPT_PLACES, KEEP_UPDATES = 8, 300
"""Places on the way of health that are kept, and the updates between two: two minutes."""
MOVED_SD = 2.0
"""By which health has moved unusually far on that way."""

STEPS = record(
    {
        "sums": ("f8", (2, N_OUTPUTS)),  # cumulative sums, upwards and downwards
        "out": ("i8", (N_OUTPUTS,)),  # updates for which a channel is still left out
        "fits": ("i8", (N_OUTPUTS,)),  # consecutive ones of them in which it fitted
        "way": ("f8", (KEPT_PLACES, N_HEALTH)),  # health in the last two minutes, a ring
    }
)
"""What is carried from update to update."""


@njit(cache=True, error_model="numpy")
def shifted(sums, innovation, sd, c):  # type: ignore[no-untyped-def]
    """Page's test (Biometrika 41, 1954) for a shift of channel ``c``, either way; takes one innovation in."""
    normal = min(max(innovation / sd, -MOST_SD), MOST_SD)
    sums[0, c] = max(0.0, sums[0, c] + normal - SLACK_SD)
    sums[1, c] = max(0.0, sums[1, c] - normal - SLACK_SD)
    if max(sums[0, c], sums[1, c]) < LIMIT_SD:
        return False
    sums[0, c] = sums[1, c] = 0.0
    return True


@njit(cache=True, error_model="numpy")
def note_way(way, updates, health):  # type: ignore[no-untyped-def]
    """Take health (5,) into the ring (8, 5) if it is time; the first fills all of it."""
    if updates % KEEP_UPDATES == 0:
        for k in range(KEPT_PLACES):
            if updates == 0 or k == updates // KEEP_UPDATES % KEPT_PLACES:
                for i in range(N_HEALTH):
                    way[k, i] = health[i]


@njit(cache=True, error_model="numpy")
def _oldest(updates):  # type: ignore[no-untyped-def]
    """Row of the ring that is written next."""
    return ((updates - 1) // KEEP_UPDATES + 1) % KEPT_PLACES


@njit(cache=True, error_model="numpy")
def moved(way, updates, z, P, at):  # type: ignore[no-untyped-def]
    """Is a health parameter farther from where it was two minutes ago than its sd allows?"""
    for i in range(N_HEALTH):
        if abs(z[at + i] - way[_oldest(updates), i]) > MOVED_SD * np.sqrt(P[at + i, at + i]):
            return True
    return False


@njit(cache=True, error_model="numpy")
def free_to_return(way, z, P, at):  # type: ignore[no-untyped-def]
    """Let health be anywhere on its way, in P in place: the distance to each place of the ring, squared."""
    for k in range(KEPT_PLACES):
        for i in range(N_HEALTH):
            for j in range(N_HEALTH):
                P[at + i, at + j] += (way[k, i] - z[at + i]) * (way[k, j] - z[at + j])


@njit(cache=True, error_model="numpy")
def _readmit(steps, c, near):  # type: ignore[no-untyped-def]
    """One update less for a channel that is left out; True if it is let in."""
    steps.fits[c] = steps.fits[c] + 1 if near else 0
    steps.out[c] = 0 if steps.fits[c] == FITS_UPDATES else steps.out[c] - 1
    return steps.out[c] == 0


@njit(cache=True, error_model="numpy")
def follow_steps(safety, updates, innovation, S, H, shifts, z, P, at):  # type: ignore[no-untyped-def]
    """Leave out, in ``safety``, channels that stepped, and let others in again; in z and P, let health return.

    What is let in may read anything: the variance of what it shifts grows by its innovation squared.
    The function takes plain arrays because it is compiled.

    Args:
        safety: of SAFETY. While the operator's query is unknown, any reading may come as a surprise.
        updates: so far.
        innovation: (3,) NaN where missing, of channels that are left out, too.
        S: (3, 3); H: (3, n).
        shifts: (3,) entries of z that a shift of each channel is put down to.
        at: where health begins in z.

    Returns:
        Whether anything is to be observed anew.
    """
    steps, anew = safety.steps, False
    for c in range(N_OUTPUTS):
        if np.isnan(innovation[c]):
            continue
        sd, k = np.sqrt(S[c, c]), shifts[c]
        if steps.out[c] > 0:
            anew = True
            if _readmit(steps, c, abs(innovation[c]) < FITS_SD * sd):
                P[k, k] += (innovation[c] / H[c, k]) ** 2
        elif safety.unknown > 0:
            steps.sums[0, c] = steps.sums[1, c] = 0.0
        elif shifted(steps.sums, innovation[c], sd, c):
            anew = True
            if c == TEMPERATURE or not moved(steps.way, updates, z, P, at):
                steps.out[c], steps.fits[c] = LEFT_OUT_UPDATES[c], 0
            else:
                P[k, k] += (innovation[c] / H[c, k]) ** 2
                free_to_return(steps.way, z, P, at)
                for i in range(N_HEALTH):
                    z[at + i] = steps.way[_oldest(updates), i]
    return anew
