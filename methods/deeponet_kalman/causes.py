"""What each cause of a step of the readings means for a filter. One machine at a time.

While a sensor drifts, no filter can tell it from the machine, and health gives way to it. When the readings step, the
causes of ``methods.weighing`` are told apart by what follows. Health that leaps is free to be elsewhere in one
parameter. A sensor that comes back takes health to where it was two minutes ago, if that is far away. A sensor that
fails is left out until it fits again. What a cause supposes is written into the copy of the filter that it has.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twinbench.methods.deeponet_kalman.records import record
from twinbench.methods.shifts import N_SUMS, forget, shifted
from twinbench.methods.weighing import BACK, FAILING, FAILS, LEAP, leap
from twinbench.physics.health import HEALTHY

N_HEALTH, N_OUTPUTS = len(HEALTHY), 3
LEFT_OUT_UPDATES = 2400
"""For which an output that fails is left out at most: two minutes. Then its readings are believed."""
FITS_SD, FITS_UPDATES = 2.0, 10
"""An output fits again whose readings have been so near for half a second."""
KEPT_PLACES, KEEP_UPDATES = 8, 300
"""Places on the way of health that are kept, and the updates between two: two minutes."""
MOVED_SD = 2.0
"""By which health has moved unusually far on that way. More sends health back less often when a sensor comes back."""

STEPS = record(
    {
        "sums": ("f8", (N_SUMS, 2, N_OUTPUTS)),  # of Page's test
        "out": ("i8", (N_OUTPUTS,)),  # updates for which an output is still left out
        "fits": ("i8", (N_OUTPUTS,)),  # consecutive ones of them in which it fitted
        "way": ("f8", (KEPT_PLACES, N_HEALTH)),  # health in the last two minutes, a ring
    }
)
"""What is carried from update to update."""


@njit(cache=True, error_model="numpy")
def stepped(steps, unknown, innovation, S):  # type: ignore[no-untyped-def]
    """The first output that stepped, or -1. All sums begin anew then: what comes next is weighed already.

    Args:
        steps: of STEPS; outputs that are left out are not tested.
        unknown: positive while the operator's query is unknown, when any reading may come as a surprise.
        innovation: (3,) in the outputs' units, NaN where missing.
        S: (3, 3) its covariance, in those units squared.
    """
    which = -1
    for c in range(N_OUTPUTS):
        if np.isnan(innovation[c]) or steps.out[c] > 0:
            continue
        if unknown > 0:
            forget(steps.sums, c)
        elif shifted(steps.sums, innovation[c], np.sqrt(S[c, c]), c) and which < 0:
            which = c
    if which >= 0:
        for c in range(N_OUTPUTS):
            forget(steps.sums, c)
    return which


@njit(cache=True, error_model="numpy")
def suppose(cause, steps, updates, z, P, at, leap_size):  # type: ignore[no-untyped-def]
    """What a cause of ``methods.weighing`` means: in ``steps``, z and P, in place.

    The function takes plain arrays because it is compiled.

    Args:
        updates: so far.
        at: where health begins in z.
        leap_size: sd of a leap, in coordinates of health.
    """
    if LEAP <= cause < BACK:
        leap(P, at + cause - LEAP, leap_size)
    elif cause == BACK:
        free_to_return(steps.way, z, P, at)
        for i in range(N_HEALTH):
            z[at + i] = steps.way[_oldest(updates), i]
    elif cause >= FAILS:
        c = FAILING[cause - FAILS]
        steps.out[c], steps.fits[c] = LEFT_OUT_UPDATES, 0


@njit(cache=True, error_model="numpy")
def let_in(steps, innovation, S, H, shifts, P):  # type: ignore[no-untyped-def]
    """Count what is left out one update on. True if an output is let in, and P changed.

    What is let in may read anything: the variance of what it shifts grows by its innovation squared.

    Args:
        innovation: (3,) in the outputs' units, NaN where missing.
        S: (3, 3) its covariance, in those units squared.
        H: (3, n) slope of the readings.
        shifts: (3,) entries of the state that a shift of each output is put down to.
        P: (n, n) covariance of the state.
    """
    any_in = False
    for c in range(N_OUTPUTS):
        if steps.out[c] == 0 or np.isnan(innovation[c]):
            continue
        near = abs(innovation[c]) < FITS_SD * np.sqrt(S[c, c])
        steps.fits[c] = steps.fits[c] + 1 if near else 0
        steps.out[c] = 0 if steps.fits[c] == FITS_UPDATES else steps.out[c] - 1
        if steps.out[c] == 0:
            any_in = True
            P[shifts[c], shifts[c]] += (innovation[c] / H[c, shifts[c]]) ** 2
    return any_in


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
