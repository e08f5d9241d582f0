"""What every filter is told: the sensors' data sheet at the present readings, and how fast health wanders."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine


class Sheet(NamedTuple):
    """The outputs' noise, as compiled code takes it. ny outputs.

    Attributes:
        read: (ny,) positions of the outputs among the channels.
        relative: (ny,) bool: noise is a share of the reading.
        grows: (ny,) dimensionless, position of the channel with which noise grows; -1 where with none.
        reference: (ny,) of that channel, in its unit.
        at: (ny,) dimensionless factor there.
        rise: (ny,) dimensionless, its rise up to twice the reference.
        white: (ny,) sd as a share or in the outputs' units.
        coloured: (ny,) likewise.
    """

    read: np.ndarray
    relative: np.ndarray
    grows: np.ndarray
    reference: Array
    at: Array
    rise: Array
    white: Array
    coloured: Array


def sheet_of(machine: Machine) -> Sheet:
    """The data sheet of a machine's outputs."""
    noise = machine.noise[len(machine.inputs) :]
    growths = [n.grows for n in noise]
    return Sheet(
        np.arange(len(machine.inputs), len(machine.channels)),
        np.array([n.relative for n in noise]),
        np.array([machine.channels.index(g.channel) if g else -1 for g in growths]),
        np.array([g.reference if g else 1.0 for g in growths]),
        np.array([g.at if g else 1.0 for g in growths]),
        np.array([g.rise if g else 1.0 for g in growths]),
        np.array([n.white for n in noise]),
        np.array([n.coloured for n in noise]),
    )


@njit(cache=True)
def output_sd_of(sheet, filled, white, coloured):  # type: ignore[no-untyped-def]
    """``output_sd`` of one machine: readings (nu + ny,), written into ``white`` and ``coloured`` (ny,)."""
    for c in range(white.size):
        size = abs(filled[sheet.read[c]]) if sheet.relative[c] else 1.0
        if sheet.grows[c] >= 0:
            past = filled[sheet.grows[c]] - sheet.reference[c]
            size *= sheet.at[c] + sheet.rise[c] * past / sheet.reference[c]
        white[c], coloured[c] = size * sheet.white[c], size * sheet.coloured[c]


@njit(cache=True)
def _output_sd(sheet, filled, white, coloured):  # type: ignore[no-untyped-def]
    for b in range(filled.shape[0]):
        output_sd_of(sheet, filled[b], white[b], coloured[b])


def output_sd(sheet: Sheet, filled: Array) -> tuple[Array, Array]:
    """White and coloured sd (B, ny) of the outputs: what is relative refers to the readings.

    Args:
        sheet: of the machine.
        filled: (B, nu + ny) readings in the channels' units, gaps filled.
    """
    white, coloured = (np.empty((len(filled), len(sheet.white))) for _ in range(2))
    _output_sd(sheet, filled, white, coloured)
    return white, coloured


def input_sd(machine: Machine, filled: Array) -> Array:
    """sd (B, nu) of the inputs, in their units.

    Args:
        machine: whose.
        filled: (B, nu + ny) readings in the channels' units, gaps filled.
    """
    noise = machine.noise[: len(machine.inputs)]
    sizes = [np.abs(filled[:, i]) if n.relative else np.ones(len(filled)) for i, n in enumerate(noise)]
    return np.stack(sizes, axis=-1) * [n.white for n in noise]


def coloured_tau_s(machine: Machine) -> Array:
    """Time constants (ny,) of the outputs' coloured noise."""
    return np.array([n.tau_s for n in machine.noise[len(machine.inputs) :]])


def coloured_keep(machine: Machine) -> Array:
    """AR(1) factors (ny,) of the outputs' coloured noise from tick to tick."""
    return np.exp(-machine.sample_period_s / coloured_tau_s(machine))


def drift_keep(machine: Machine) -> float:
    """AR(1) factor from tick to tick of the drift that sensors share."""
    return float(np.exp(-machine.sample_period_s / machine.drift.tau_s))


def health_walk_var(machine: Machine, factor: float) -> Array:
    """Variance (nh,) that one tick adds to the coordinates of health, which is a random walk in them.

    Args:
        machine: whose.
        factor: dimensionless, times the walk of its record.
    """
    _, slope = machine.coordinates.theta_and_slope(np.zeros(len(machine.health)))
    return (factor * machine.health_walk / slope) ** 2 * machine.sample_period_s
