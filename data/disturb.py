"""Fresh sequences under harder conditions: noisier sensors, faster wear, loads beyond the envelope, sensor faults.

The machines are of the same population as the test's, drawn from a seed of their own: no rule was made with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from twinbench.data.batch import Batch
from twinbench.data.benchmark import DesignConfig, design, run
from twinbench.data.corrupt import Corruption
from twinbench.data.scenario import Scenario, stream
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine

DISTURBED_MINUTES, MOST_DISTURBED, FRESH = 12.0, 8, 1
"""Length of a disturbed sequence, in which a filter settles before a fault begins and has minutes to recover after the
longest; how many there are at most; and what is added to the benchmark's seed to draw others."""
FAULT_BEGINS_S = 300.0
NOISE_LEVELS = (0.5, 1.0, 1.5, 2.0, 3.0)
DROPOUT_LEVELS = (0.0, 0.02, 0.05, 0.10, 0.20, 0.30)
PACES = (0.5, 1.0, 2.0, 4.0)
BEYOND = (0.0, 0.1, 0.2, 0.3, 0.4)


@dataclass(frozen=True)
class SensorFault:
    """What some sensors do for a while.

    Attributes:
        kind: ``stuck`` at the last value, ``spikes``, ``drift`` and back at once, ``bias``, ``jitter`` of the
            sampling instant, ``loss``.
        channels: whose.
        seconds: for how long.
        size: of spikes, drift and bias in standard deviations of the sensor's noise; of jitter in samples.
        rise_s: for how long a bias grows until it is whole, and fades at its end.
    """

    name: str
    kind: str
    channels: tuple[str, ...]
    seconds: float = 60.0
    size: float = 0.0
    rise_s: float = 0.0


def faults_of(read: Sequence[str], outputs: Sequence[str], channels: Sequence[str]) -> tuple[SensorFault, ...]:
    """What sensors may do, kind by kind.

    Args:
        read: inputs that a sensor reads; a command cannot be lost.
        outputs: all of them.
        channels: all of them.
    """
    return (
        *(SensorFault(f"stuck {c}", "stuck", (c,)) for c in outputs),
        *(SensorFault(f"spikes {c}", "spikes", (c,), size=30.0) for c in outputs),
        *(SensorFault(f"drift {c}", "drift", (c,), size=6.0) for c in outputs),
        *(SensorFault(f"bias {c}", "bias", (c,), size=6.0) for c in outputs),
        *(SensorFault(f"gradual bias {c}", "bias", (c,), size=6.0, rise_s=20.0) for c in outputs),
        *(SensorFault(f"bias for 20 s {c}", "bias", (c,), seconds=20.0, size=6.0) for c in outputs),
        *(SensorFault(f"bias for 180 s {c}", "bias", (c,), seconds=180.0, size=6.0) for c in outputs),
        *(SensorFault(f"drift for 180 s {c}", "drift", (c,), seconds=180.0, size=6.0) for c in outputs),
        *(SensorFault(f"stuck for 180 s {c}", "stuck", (c,), seconds=180.0) for c in outputs),
        SensorFault("jitter", "jitter", tuple(channels), size=1.0),
        *(SensorFault(f"loss {c}", "loss", (c,)) for c in (*read, *outputs)),
        SensorFault("all lost", "loss", tuple(channels), seconds=10.0),
    )


SPIKED = 0.2
"""Share of samples that spike while a sensor does."""


@dataclass(frozen=True)
class Condition:
    """One way in which sequences are harder.

    Attributes:
        group: ``noise and dropout``, ``pace``, ``envelope`` or ``fault``.
        pace: of all wear, in that of the benchmark.
        beyond: by which share loads reach farther from their middle than in training.
    """

    group: str
    name: str
    corruption: Corruption = field(default_factory=Corruption)
    pace: float = 1.0
    beyond: float = 0.0
    fault: SensorFault | None = None


UNDISTURBED = Condition("fault", "none")
"""What the time after a fault is compared with."""


def conditions_of(faults: Sequence[SensorFault], stretched: bool) -> tuple[Condition, ...]:
    """Every condition under these faults.

    Args:
        faults: what sensors may do.
        stretched: can loads reach beyond the envelope?
    """
    return (
        *(
            Condition("noise and dropout", f"noise {n:g}, dropout {d:g}", Corruption(noise=n, dropout=d))
            for n in NOISE_LEVELS
            for d in DROPOUT_LEVELS
        ),
        *(Condition("pace", f"wear at pace {p:g}", pace=p) for p in PACES),
        *(Condition("envelope", f"loads {b:.0%} beyond", beyond=b) for b in (BEYOND if stretched else ())),
        *(Condition("fault", f.name, fault=f) for f in faults),
    )


def faults(machine: Machine) -> tuple[SensorFault, ...]:
    """What a machine's sensors may do."""
    read = [c.channel for c in machine.noise[: len(machine.inputs)] if c.white > 0.0]
    return faults_of(read, machine.outputs, machine.channels)


def conditions(machine: Machine) -> tuple[Condition, ...]:
    """Every condition that a machine can be put under."""
    return conditions_of(faults(machine), machine.stretched is not None)


FAULTS, CONDITIONS = faults(COMPRESSOR), conditions(COMPRESSOR)
"""The compressor's, of which the paper's figures and claims are."""


def simulate_condition(config: DesignConfig, condition: Condition, machine: Machine = COMPRESSOR) -> Batch:
    """Fresh sequences of DISTURBED_MINUTES after the warm-up, under a condition; with their truth."""
    minutes = min(config.minutes, config.warmup_minutes + DISTURBED_MINUTES)
    count = min(config.n_test, MOST_DISTURBED)
    fresh = replace(config, seed=config.seed + FRESH, n_test=count, n_single=0, minutes=minutes)
    scenarios = design(fresh, machine)["test"]
    harder = tuple(_harder(s, condition) for s in scenarios)
    batch = run(harder, config.warmup_minutes, condition.corruption)
    if condition.fault is None:
        return batch
    rngs = [stream(config.seed, s.name, condition.name) for s in scenarios]
    measured = [with_fault(m, condition.fault, rng, machine) for m, rng in zip(batch.measured, rngs, strict=True)]
    return replace(batch, measured=np.stack(measured))


def _harder(scenario: Scenario, condition: Condition) -> Scenario:
    changes = tuple(
        replace(c, finish_s=c.begin_s + (c.finish_s - c.begin_s) / condition.pace) for c in scenario.changes
    )
    stretched = scenario.machine.stretched
    if condition.beyond and stretched is not None:
        scenario = replace(scenario, drive=stretched(scenario.drive, condition.beyond))
    return replace(scenario, changes=changes)


def with_fault(measured: Array, fault: SensorFault, rng: np.random.Generator, machine: Machine = COMPRESSOR) -> Array:
    """Readings (N, nu + ny) with the fault from FAULT_BEGINS_S on, or from the middle where they are shorter.

    Args:
        measured: (N, nu + ny) readings in the channels' units, inputs first.
        fault: what the sensors do.
        rng: what is random about it.
        machine: whose sensors they are.
    """
    period_s = machine.sample_period_s
    out = measured.copy()
    begin = min(round(FAULT_BEGINS_S / period_s), len(out) // 2)
    rows = slice(begin, begin + round(fault.seconds / period_s))
    for channel in fault.channels:
        c = machine.channels.index(channel)
        values = out[rows, c]
        sd = fault.size * _noise_sd(machine, c, measured[:, c])
        if fault.kind == "stuck":
            before = measured[:begin, c]
            seen = before[np.isfinite(before)]
            values[:] = seen[-1] if len(seen) else np.nan
        elif fault.kind == "spikes":
            spiked = rng.random(len(values)) < SPIKED
            values[spiked] += sd * rng.choice([-1.0, 1.0], int(spiked.sum()))
        elif fault.kind == "drift":
            values += sd * np.linspace(0.0, 1.0, len(values))
        elif fault.kind == "bias":
            values += sd * _envelope(len(values), fault.rise_s, period_s)
        elif fault.kind == "jitter":
            late = np.clip(rng.normal(size=len(values)) * fault.size, -3.0, 3.0)
            values[:] = np.interp(np.arange(len(values)) + late, np.arange(len(values)), values)
        else:
            values[:] = np.nan
    return out


def _envelope(samples: int, rise_s: float, period_s: float) -> Array:
    """(N,) share of a bias that is there: it grows for so long from its first sample on, and fades as long."""
    if rise_s == 0.0:
        return np.ones(samples)
    ramp = np.arange(1, samples + 1) * period_s / rise_s
    return np.minimum(np.minimum(ramp, ramp[::-1]), 1.0)


def _noise_sd(machine: Machine, channel: int, readings: Array) -> float:
    """Of white and coloured noise together, at the mean reading."""
    noise = machine.noise[channel]
    size = float(np.nanmean(np.abs(readings))) if noise.relative else 1.0
    return size * float(np.hypot(noise.white, noise.coloured))
