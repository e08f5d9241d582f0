"""Random lumped networks with plausible constants: mechanical, thermal, hydraulic, electrical."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from twinbench.physics.simulator import Variable
from twinbench.proof.lumped.network import Link, Network

HOT_K = 293.0
_ROOM = 0.3
"""Bounds of a parameter: from this share of its value to one over this share of it."""


@dataclass
class Sketch:
    """A network that is being drawn: units, values and words by name.

    Attributes:
        states: by name, the unit and what it is.
        inputs: by name, the unit, what it is, and lowest and highest value.
        values: by parameter, the unit, its value, and what it is.
        positive: no state is ever negative.
        guess: about where a state is, in its unit; 0 if left out.
        gauge: the state whose swing says how large the inputs must be, and that swing in its unit; no state where the
            inputs are as large as they must be.
    """

    says: str
    states: dict[str, tuple[str, str]] = field(default_factory=dict)
    inputs: dict[str, tuple[str, str, float, float]] = field(default_factory=dict)
    values: dict[str, tuple[str, float, str]] = field(default_factory=dict)
    stores: dict[str, str] = field(default_factory=dict)
    links: list[Link] = field(default_factory=list)
    gauge: tuple[str, float] = ("", 0.0)
    guess: dict[str, float] = field(default_factory=dict)
    positive: bool = False

    def value(self, name: str, unit: str, value: float, says: str) -> str:
        """Add a parameter, to three figures."""
        self.values[name] = (unit, rounded(value), says)
        return name

    def store(self, state: str, unit: str, name: str, store_unit: str, value: float, what: str) -> None:
        """Add a store and its state; ``what`` says what it is."""
        self.states[state] = (unit, what)
        self.stores[state] = self.value(name, store_unit, value, f"size of the store of {state}")

    def driven_by(self, times: float) -> None:
        """Make all inputs so many times larger, but for temperatures."""
        for name, (unit, says, low, high) in self.inputs.items():
            if unit != "K":
                self.inputs[name] = (unit, says, rounded(low * times), rounded(high * times))

    def network(self, name: str, spans: dict[str, tuple[float, float]], reads: tuple[str, ...]) -> Network:
        """The network, its states and inputs being where ``spans`` (lowest, highest) says."""
        says = {**{n: (u, s) for n, (u, s) in self.states.items()}, **{n: v[:2] for n, v in self.inputs.items()}}
        variable = {n: self._variable(n, *says[n], *spans[n]) for n in says}
        read = [variable[state] for state in reads]
        sensors = [
            Variable(f"read_{v.name}", v.unit, v.low, v.high, v.nominal, v.scale, f"{v.says}, read") for v in read
        ]
        return Network(
            name=name,
            says=self.says,
            states=tuple(variable[n] for n in self.states),
            inputs=tuple(variable[n] for n in self.inputs),
            outputs=tuple(sensors),
            parameters=tuple(_parameter(n, *v) for n, v in self.values.items()),
            stores=dict(self.stores),
            links=tuple(self.links),
            reads=reads,
            known=(next(iter(self.stores.values())),),
        )

    def _variable(self, name: str, unit: str, says: str, low: float, high: float) -> Variable:
        """Bounds are far beyond where it goes; what is a content or a command of one sign has 0 for the lowest."""
        width = high - low
        least = rounded(low - 3.0 * width)
        if unit == "K" and low > 0.0:
            least = max(least, 0.5 * low)
        elif low >= 0.0 and (name in self.inputs or self.positive):
            least = 0.0
        nominal, scale = rounded(0.5 * (low + high)), rounded(0.25 * width)
        return Variable(name, unit, least, rounded(high + 3.0 * width), nominal, scale, says)


def _parameter(name: str, unit: str, value: float, says: str) -> Variable:
    if name == "T_amb_K":
        return Variable(name, unit, 250.0, 330.0, value, 5.0, says)
    return Variable(name, unit, rounded(_ROOM * value), rounded(value / _ROOM), value, rounded(0.1 * value), says)


def rounded(value: float) -> float:
    """To three figures."""
    return float(f"{value:.3g}")


def even(rng: np.random.Generator, low: float, high: float) -> float:
    """Drawn evenly in its logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def mechanical(rng: np.random.Generator) -> Sketch:
    """One to three masses or rotors in a row, coupled by springs and dampers."""
    turns = rng.random() < 0.5
    v, q, m, d, k, f = (
        ("rad/s", "rad", "kg m^2", "N m s/rad", "N m/rad", "N m") if turns
        else ("m/s", "m", "kg", "N s/m", "N/m", "N")
    )  # fmt: skip
    word, unit = ("rotor", "rad_s") if turns else ("mass", "m_s")
    count = int(rng.choice((1, 2, 2, 3)))
    s = Sketch(f"{count} {word if count == 1 else 'rotors' if turns else 'masses'} with springs and dampers")
    size, tau_s, masses = even(rng, 0.5, 30.0), even(rng, 0.6, 5.0), []
    speeds = [f"v{i + 1}_{unit}" for i in range(count)]
    for i, speed in enumerate(speeds):
        masses.append(size * even(rng, 0.5, 2.0))
        s.store(speed, v, f"m{i + 1}", m, masses[-1], f"speed of {word} {i + 1}")
    held = count == 1 or rng.random() < 0.35
    pairs = [(i, i + 1) for i in range(count - 1)] + ([(count - 1, -1)] if held else [])
    for a, b in pairs:
        pair = f"{a + 1}{b + 1 if b >= 0 else 0}"
        at = masses[a] if b < 0 else masses[a] * masses[b] / (masses[a] + masses[b])
        omega, to = even(rng, 1.0, 4.0) / tau_s, speeds[b] if b >= 0 else ""
        stretch = s.value(f"k{pair}", k, at * omega**2, f"spring {pair}")
        s.states[f"q{pair}_{q}"] = (q, f"elongation of spring {pair}")
        s.links.append(Link("spring", speeds[a], to, stretch, f"q{pair}_{q}"))
        if b >= 0:
            damper = s.value(f"c{pair}", d, 2.0 * even(rng, 0.1, 0.5) * at * omega, f"damper {pair}")
            s.links.append(Link("conductance", speeds[a], to, damper))
    belt = rng.random() < 0.3
    for i in range(count):
        if i == 0 or (belt and i == count - 1) or rng.random() < 0.5:
            drag = s.value(f"d{i + 1}", d, masses[i] / (tau_s * even(rng, 0.7, 1.5)), f"viscous friction at {i + 1}")
            from_belt = belt and i == count - 1
            s.links.append(Link("conductance", "belt" if from_belt else "", speeds[i], drag))
    if belt:
        s.inputs["belt"] = (v, "speed of the belt", -0.6, 0.6)
    if not belt or rng.random() < 0.7:
        s.inputs["drive"] = (f, "force on the first", -1.0, 1.0)
        s.links.append(Link("source", "drive", speeds[0]))
    s.gauge = (speeds[0], even(rng, 20.0, 150.0) if turns else even(rng, 0.3, 4.0))
    return s


def electrical(rng: np.random.Generator) -> Sketch:
    """A ladder of resistors or inductors in series with capacitors to ground, fed by a source."""
    count = int(rng.integers(1, 4))
    R, tau_s = even(rng, 2.0, 60.0), even(rng, 0.4, 4.0)
    s = Sketch("a ladder of capacitors, resistors and inductors")
    nodes, before, coils = [f"v{i + 1}_V" for i in range(count)], "source_V", 0
    for i, node in enumerate(nodes):
        s.store(node, "V", f"C{i + 1}_F", "F", tau_s * even(rng, 0.5, 3.0) / R, f"voltage of capacitor {i + 1}")
        if rng.random() < 0.4 or (count == 1 and i == 0):
            coils += 1
            current, R_coil = f"i{i + 1}_A", 0.5 * R * even(rng, 0.7, 1.4)
            s.store(current, "A", f"L{i + 1}_H", "H", tau_s * even(rng, 0.5, 2.0) * R_coil, f"current of coil {i + 1}")
            s.links.append(
                Link("inductor", before, node, s.value(f"R{i + 1}_ohm", "ohm", R_coil, "the coil's own"), current)
            )
        else:
            series = s.value(f"R{i + 1}_ohm", "ohm", R * even(rng, 0.5, 2.0), f"resistor {i + 1}")
            s.links.append(Link("resistance", before, node, series))
        if i == count - 1 or rng.random() < 0.25:
            load = s.value(f"R{i + 1}0_ohm", "ohm", R * even(rng, 1.5, 6.0), f"from node {i + 1} to ground")
            s.links.append(Link("resistance", node, "", load))
        before = node
    # States by kind, voltages before currents.
    s.states = dict(sorted(s.states.items(), key=lambda item: item[1][0], reverse=True))
    s.inputs["source_V"] = ("V", "voltage of the source", -1.0, 1.0)
    if rng.random() < 0.4:
        s.inputs["load_A"] = ("A", "current fed into the last node", -0.3 / R, 0.3 / R)
        s.links.append(Link("source", "load_A", nodes[-1]))
    s.gauge = (nodes[-1], even(rng, 5.0, 40.0))
    return s


def thermal(rng: np.random.Generator) -> Sketch:
    """Two to five heat capacities in a row, with heaters and a loss to the surroundings."""
    count = int(rng.integers(2, 6))
    G, tau_s = even(rng, 2.0, 150.0), even(rng, 20.0, 150.0)
    s = Sketch(f"{count} heat capacities in a row, heated and cooled")
    bodies = [f"T{i + 1}_K" for i in range(count)]
    for i, body in enumerate(bodies):
        s.store(
            body, "K", f"C{i + 1}_J_K", "J/K", tau_s * 2.0 * G * even(rng, 0.5, 2.0), f"temperature of body {i + 1}"
        )
        if i + 1 < count:
            between = s.value(f"G{i + 1}{i + 2}_W_K", "W/K", G * even(rng, 0.6, 2.5), f"between {i + 1} and {i + 2}")
            s.links.append(Link("conductance", body, bodies[i + 1], between))
    ambient = s.value("T_amb_K", "K", HOT_K, "temperature of the surroundings")
    for i in sorted({count - 1, *([int(rng.integers(count))] if rng.random() < 0.5 else [])}):
        loss = s.value(f"G{i + 1}0_W_K", "W/K", G * even(rng, 0.3, 1.0), f"from body {i + 1} to the surroundings")
        s.links.append(Link("conductance", ambient, bodies[i], loss))
    s.inputs["heater_W"] = ("W", "power of the heater", 0.1, 1.0)
    s.links.append(Link("source", "heater_W", bodies[0]))
    if rng.random() < 0.5:
        j = int(rng.integers(1, count))
        s.inputs["cold_side_K"] = ("K", f"what body {j + 1} exchanges heat with", HOT_K - 10.0, HOT_K + 15.0)
        side = s.value(f"G{j + 1}s_W_K", "W/K", G * even(rng, 0.3, 1.5), f"from the cold side to body {j + 1}")
        s.links.append(Link("conductance", "cold_side_K", bodies[j], side))
    s.gauge, s.guess = (bodies[0], rng.uniform(30.0, 70.0)), dict.fromkeys(bodies, HOT_K + 20.0)
    return s


def hydraulic(rng: np.random.Generator) -> Sketch:
    """Two to four tanks or accumulators in a row; pumps, orifices between them and to the outside."""
    open_tanks = rng.random() < 0.6
    count = int(rng.integers(2, 5))
    unit, flow, word = ("cm", "cm^3/s", "level of tank") if open_tanks else ("bar", "l/s", "pressure of accumulator")
    q, head = (
        (even(rng, 30.0, 300.0), even(rng, 8.0, 20.0)) if open_tanks else (even(rng, 0.1, 3.0), even(rng, 0.4, 2.0))
    )
    tau_s = even(rng, 10.0, 80.0) if open_tanks else even(rng, 1.0, 15.0)
    s = Sketch(f"{count} {'tanks' if open_tanks else 'accumulators'} in a row, filled by pumps", positive=True)
    names = [f"h{i + 1}_cm" if open_tanks else f"p{i + 1}_bar" for i in range(count)]
    drops = [head * even(rng, 0.6, 1.6) for _ in names]  # across each orifice, the last one to the outside
    s.guess = {name: sum(drops[i:]) for i, name in enumerate(names)}
    for i, name in enumerate(names):
        ways = sum(q / (2.0 * drops[j]) for j in (i - 1, i) if j >= 0)
        size = tau_s * even(rng, 0.6, 2.0) * ways
        s.store(name, unit, f"A{i + 1}", "cm^2" if open_tanks else "l/bar", size, f"{word} {i + 1}")
        last = i == count - 1
        laminar = not open_tanks and not last and rng.random() < 0.3
        k = s.value(
            f"k{i + 1}",
            f"{flow}/{unit}{'' if laminar else '^0.5'}",
            q / drops[i] ** (1.0 if laminar else 0.5),
            f"way out of {name}",
        )
        to = "" if last else names[i + 1]
        knee = 0.0 if laminar else rounded(1e-3 * head)
        s.links.append(Link("conductance" if laminar else "orifice", name, to, k, knee=knee))
    s.inputs["pump_V"] = ("V", "voltage of the pump", 2.6, 6.6)
    gain = s.value("pump_gain", f"{flow}/V", q / 5.0, "flow of the pump per volt")
    s.links.append(Link("source", "pump_V", names[0], gain))
    if rng.random() < 0.5:
        at = names[int(rng.integers(1, count))]
        s.inputs["feed"] = (flow, f"flow fed into {at}", 0.0, rounded(0.5 * q))
        s.links.append(Link("source", "feed", at))
    return s


DOMAINS: tuple[Callable[[np.random.Generator], Sketch], ...] = (mechanical, thermal, hydraulic, electrical)
