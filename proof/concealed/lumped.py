"""Concealed machines drawn at random: a network, its truth, what may be wrong with it, how it is run."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from twinbench.data.scenario import stream
from twinbench.proof.concealed.lumped_effects import Ground, effects
from twinbench.proof.concealed.lumped_law import MOST_LINKS, MOST_OWN, MOST_READ, MOST_STATES, law, packed, reading
from twinbench.proof.concealed.lumped_parts import Drive, Start, Waves
from twinbench.proof.concealed.lumped_trial import rhythm_of, trial
from twinbench.proof.concealed.machine import Effect, Machine, Noise
from twinbench.proof.concealed.networks import DOMAINS, Sketch
from twinbench.proof.concealed.severity import Take, Yardstick
from twinbench.proof.lumped.twin import LUMPED, twin

LEAST_SWING = 4.0
"""A sensor's sd in sds of its noise."""
NOISE = (0.003, 0.02)
"""sd of a sensor's noise as a share of its span."""
INPUT_NOISE = 2e-4
"""sd of an input's noise as a share of its span."""
LEAST_EFFECTS = 5
"""Effects of a machine that the catalogue approximates."""
PLAIN, TOO_SMALL = 10.0, 0.1
"""At so many typical sizes an effect must have more than this severity: else a parameter of the twin absorbs it."""
MOST_TRIES = 200
_NAME = "random_"
_DRY_SHARE = 0.02  # of its greatest value is the least that a tank may hold
_ROOM_DRIFT_K, _DRIFT = 0.05, 2e-4  # of the ambient's temperature; elsewhere of the parameter that ripples, a share


def random_machines(seed: int, count: int) -> dict[str, Machine]:
    """The first machines of a seed by name; the domains take turns."""
    machines = (random_machine(seed, number) for number in range(count))
    return {machine.name: machine for machine in machines}


def named(name: str, seed: int) -> Machine:
    """The machine of a seed that has a name like random_007."""
    return random_machine(seed, int(name.removeprefix(_NAME)))


@functools.cache
def random_machine(seed: int, number: int) -> Machine:
    """A machine at random; the same seed and number give the same one.

    What is not stable, spreads its time constants too far, or is not moved enough to be seen is drawn again.

    Raises:
        RuntimeError: nothing that was drawn would do.
    """
    rng = stream(seed, "lumped", number)
    for _ in range(MOST_TRIES):
        machine = _machine(f"{_NAME}{number:03d}", DOMAINS[number % len(DOMAINS)](rng), rng)
        if machine is not None:
            return machine
    raise RuntimeError(f"no random machine {number} of seed {seed} in {MOST_TRIES} tries")


def _machine(name: str, sketch: Sketch, rng: np.random.Generator) -> Machine | None:
    """A machine of a sketch; None if it could not be used."""
    wide = dict.fromkeys(sketch.states, (-1.0, 1.0)) | {n: v[2:] for n, v in sketch.inputs.items()}
    draft = sketch.network(name, wide, (next(iter(sketch.states)),))
    fits = len(draft.parameters) <= MOST_OWN and len(draft.links) <= MOST_LINKS
    if not (fits and 2 <= len(draft.states) <= MOST_STATES) or (rhythm := rhythm_of(draft, sketch, rng)) is None:
        return None
    gauge, swing = sketch.gauge
    if gauge:
        went = trial(draft, sketch, rhythm, rng)[0][:, list(sketch.states).index(gauge)]
        sketch.driven_by(swing / float(np.ptp(went)))
    x, u = trial(draft, sketch, rhythm, rng)
    if not np.isfinite(x).all() or (sketch.positive and (x.min(axis=0) < _DRY_SHARE * x.max(axis=0)).any()):
        return None
    count = int(rng.integers(max(1, len(sketch.states) // 2), min(MOST_READ, len(sketch.states)) + 1))
    read = np.sort(rng.permutation(len(sketch.states))[:count])
    sigma = rng.uniform(*NOISE, count) * np.ptp(x[:, read], axis=0)
    if (np.std(x[:, read], axis=0) < LEAST_SWING * sigma).any():
        return None
    columns = np.concatenate([x, u], axis=-1).T
    spans = {n: (float(c.min()), float(c.max())) for n, c in zip(wide, columns, strict=True)}
    network = sketch.network(name, spans, tuple(list(sketch.states)[i] for i in read))
    ground, drive = Ground(network, twin(network), x, u, rhythm), Drive.of(sketch, rhythm)
    machine = _assembled(ground, drive, dict(zip(network.reads, sigma.tolist(), strict=True)), rng)
    return _seen(machine, rng)


def _seen(machine: Machine, rng: np.random.Generator) -> Machine | None:
    """With those effects alone that no parameter absorbs; None if too few are left."""
    seconds = machine.seconds["train"][0]
    takes = [Take(f"{part}_1", 0.0, machine.operate(rng, seconds, part)) for part in ("train", "held")]
    yardstick = Yardstick(machine, takes, machine.p())

    def shows(effect: Effect) -> bool:
        there = machine.p(**{effect.slot: min(PLAIN * effect.typical, effect.most)})
        return min(yardstick.measure(yardstick.with_parameters(there))) > TOO_SMALL

    effects, foreign = (tuple(e for e in group if shows(e)) for group in (machine.effects, machine.foreign))
    enough = len(effects) >= LEAST_EFFECTS and foreign
    return replace(machine, effects=effects, foreign=foreign) if enough else None


def _assembled(ground: Ground, drive: Drive, sigma: dict[str, float], rng: np.random.Generator) -> Machine:
    """The machine of a network; ``sigma`` are its sensors' noise by the state that they read."""
    network, simulator, rhythm = ground.network, ground.twin, ground.rhythm
    made, foreign, played = effects(ground, rng)
    waves = Waves.drawn(network, ground.x, ground.u, rng)
    tau_s = rhythm.period_s * rng.uniform(1.0, 6.0)
    noise = {f"read_{n}": Noise(0.8 * s, 0.6 * s, tau_s) for n, s in sigma.items()}
    widths = [INPUT_NOISE * (high - low) for low, high in drive.limits]
    noise |= {v.name: Noise(w, 0.0, tau_s) for v, w in zip(network.inputs, widths, strict=True)}
    has_room = any(v.name == "T_amb_K" for v in network.parameters)
    numbers = [m.numbers for m in (*made, *foreign)]
    seconds = rhythm.samples * rhythm.period_s
    return Machine(
        name=network.name,
        simulator=LUMPED,
        network=network.to_json(),
        values={},
        calibrate=simulator.calibrate,
        inputs=tuple(v.name for v in network.inputs),
        outputs=tuple(v.name for v in network.outputs),
        parameters=packed(network, numbers, waves.numbers, 12.0 * rhythm.slowest_s),
        spread={n: 0.15 for n in simulator.calibrate if n != "T_amb_K"},
        offsets={"T_amb_K": 3.0} if has_room else {},
        ambient=_ROOM_DRIFT_K if has_room else _DRIFT,
        law=law,
        reading=reading,
        start=Start(network, tuple(tuple(n) for n in numbers if n[7] >= 0.0)),
        slow={i: float(sd) for i, sd in enumerate(0.2 * ground.sd)},
        operate=drive,
        settle_s=10.0 * rhythm.slowest_s,
        period_s=rhythm.period_s,
        fine=16,
        coarse=4,
        seconds={"train": (seconds,) * 3, "held": (seconds,) * 2},
        noise=noise,
        lsb={n: 0.25 * v.sigma for n, v in noise.items()},
        effects=tuple(m.effect for m in made),
        foreign=tuple(m.effect for m in foreign),
        rippled=waves.parameter,
        ripple_arguments=waves,
        kind="random",
        played=played,
    )
