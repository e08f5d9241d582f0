"""What each cause of a step of the readings means for a filter. One machine at a time.

While a sensor drifts, no filter can tell it from the machine, and health gives way to it. When the readings step, the
causes of ``methods.weighing`` are told apart by what follows. Health that leaps is free to be elsewhere in one
parameter. A sensor that comes back takes health to where it was two minutes ago, if that is far away. A sensor that
fails is left out until it fits again. What a cause supposes is written into the copy of the filter that it has.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.machines.machine import Machine
from twinbench.methods.deeponet_kalman.parts import Parts
from twinbench.methods.deeponet_kalman.records import record
from twinbench.methods.shifts import N_SUMS, forget, shifted
from twinbench.methods.weighing import LEAP, leap

LEFT_OUT_S = 120.0
"""For which an output that fails is left out at most. Then its readings are believed."""
FITS_SD, FITS_S = 2.0, 0.5
"""An output fits again whose readings have been so near for so long."""
KEPT_PLACES, APART_S = 8, 15.0
"""Places on the way of health that are kept, and the time between two: two minutes in all."""
MOVED_SD = 2.0
"""By which health has moved unusually far on that way. More sends health back less often when a sensor comes back."""


class Waits(NamedTuple):
    """How many updates what is left out waits, at a machine's sample period.

    Attributes:
        left_out: for which an output that fails is left out at most.
        fits: for which its readings must be near.
        apart: between two places on the way of health.
    """

    left_out: int
    fits: int
    apart: int


def waits_of(machine: Machine) -> Waits:
    """At the sample period of a machine."""
    return Waits(*(max(round(seconds / machine.sample_period_s), 1) for seconds in (LEFT_OUT_S, FITS_S, APART_S)))


def steps_type(parts: Parts) -> np.dtype[np.void]:
    """What is carried from update to update."""
    return record(
        {
            "sums": ("f8", (N_SUMS, 2, parts.outputs)),  # of Page's test
            "out": ("i8", (parts.outputs,)),  # updates for which an output is still left out
            "fits": ("i8", (parts.outputs,)),  # consecutive ones of them in which it fitted
            "way": ("f8", (KEPT_PLACES, parts.health)),  # health in the last two minutes, a ring
        }
    )


@njit(cache=True, error_model="numpy")
def stepped(steps, unknown, innovation, S):  # type: ignore[no-untyped-def]
    """The first output that stepped, or -1. All sums begin anew then: what comes next is weighed already.

    Args:
        steps: of ``steps_type``; outputs that are left out are not tested.
        unknown: positive while the operator's query is unknown, when any reading may come as a surprise.
        innovation: (ny,) in the outputs' units, NaN where missing.
        S: (ny, ny) its covariance, in those units squared.
    """
    which = -1
    for c in range(innovation.size):
        if np.isnan(innovation[c]) or steps.out[c] > 0:
            continue
        if unknown > 0:
            forget(steps.sums, c)
        elif shifted(steps.sums, innovation[c], np.sqrt(S[c, c]), c) and which < 0:
            which = c
    if which >= 0:
        for c in range(innovation.size):
            forget(steps.sums, c)
    return which


@njit(cache=True, error_model="numpy")
def suppose(causes, waits, cause, steps, updates, z, P, at, leap_size):  # type: ignore[no-untyped-def]
    """What a cause of ``methods.weighing`` means: in ``steps``, z and P, in place.

    The function takes plain arrays because it is compiled.

    Args:
        causes: of the machine.
        waits: of the machine.
        updates: so far.
        at: where health begins in z.
        leap_size: sd of a leap, in coordinates of health.
    """
    if LEAP <= cause < causes.back:
        leap(P, at + cause - LEAP, leap_size)
    elif cause == causes.back:
        free_to_return(steps.way, z, P, at)
        for i in range(steps.way.shape[1]):
            z[at + i] = steps.way[_oldest(waits, updates), i]
    elif cause >= causes.fails:
        c = causes.failing[cause - causes.fails]
        steps.out[c], steps.fits[c] = waits.left_out, 0


@njit(cache=True, error_model="numpy")
def let_in(waits, steps, innovation, S, H, shifts, P):  # type: ignore[no-untyped-def]
    """Count what is left out one update on. True if an output is let in, and P changed.

    What is let in may read anything: the variance of what it shifts grows by its innovation squared.

    Args:
        waits: of the machine.
        innovation: (ny,) in the outputs' units, NaN where missing.
        S: (ny, ny) its covariance, in those units squared.
        H: (ny, n) slope of the readings.
        shifts: (ny,) entries of the state that a shift of each output is put down to.
        P: (n, n) covariance of the state.
    """
    any_in = False
    for c in range(innovation.size):
        if steps.out[c] == 0 or np.isnan(innovation[c]):
            continue
        near = abs(innovation[c]) < FITS_SD * np.sqrt(S[c, c])
        steps.fits[c] = steps.fits[c] + 1 if near else 0
        steps.out[c] = 0 if steps.fits[c] == waits.fits else steps.out[c] - 1
        if steps.out[c] == 0:
            any_in = True
            P[shifts[c], shifts[c]] += (innovation[c] / H[c, shifts[c]]) ** 2
    return any_in


@njit(cache=True, error_model="numpy")
def note_way(waits, way, updates, health):  # type: ignore[no-untyped-def]
    """Take health (nh,) into the ring (8, nh) if it is time; the first fills all of it."""
    if updates % waits.apart == 0:
        for k in range(KEPT_PLACES):
            if updates == 0 or k == updates // waits.apart % KEPT_PLACES:
                for i in range(health.size):
                    way[k, i] = health[i]


@njit(cache=True, error_model="numpy")
def _oldest(waits, updates):  # type: ignore[no-untyped-def]
    """Row of the ring that is written next."""
    return ((updates - 1) // waits.apart + 1) % KEPT_PLACES


@njit(cache=True, error_model="numpy")
def moved(waits, way, updates, z, P, at):  # type: ignore[no-untyped-def]
    """Is a health parameter farther from where it was two minutes ago than its sd allows?"""
    for i in range(way.shape[1]):
        if abs(z[at + i] - way[_oldest(waits, updates), i]) > MOVED_SD * np.sqrt(P[at + i, at + i]):
            return True
    return False


@njit(cache=True, error_model="numpy")
def free_to_return(way, z, P, at):  # type: ignore[no-untyped-def]
    """Let health be anywhere on its way, in P in place: the distance to each place of the ring, squared."""
    for k in range(KEPT_PLACES):
        for i in range(way.shape[1]):
            for j in range(way.shape[1]):
                P[at + i, at + j] += (way[k, i] - z[at + i]) * (way[k, j] - z[at + j])
