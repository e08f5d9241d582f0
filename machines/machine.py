"""What the benchmark needs to know of a machine, in one record.

Data, estimators, scores and reports read everything from here, so that a machine of one's own is one file. What is
optional has a default that follows from the variables' own scales.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twinbench.machines.coordinates import Array, Coordinates, coordinates
from twinbench.machines.parts import Health, Lag, Reading
from twinbench.machines.sensors import APART, Drift, Noise
from twinbench.physics.simulator import Simulator, Variable
from twinbench.physics.steady import steady_state

LIFE_WALKS = 300.0
"""Health wanders by one over this of its life in the square root of a second, unless a machine says otherwise: a tenth
of a life in a quarter of an hour. Filters tune a factor on it."""
STATE_WALK = 1e-3
"""Of a state's scale: its process noise in the square root of a second, unless a machine says otherwise. Filters tune a
factor on it."""
STATE_SPREAD = 0.2
"""Of a state's scale: the sd of counterfactual states about a recording's, unless a machine says otherwise. Less
teaches networks weaker sensitivities, more takes them where no machine runs."""
BEYOND_LIFE = 0.2
"""Of a life: how far beyond its ends counterfactual health goes, unless a machine says otherwise."""
GRID = 10_000
"""Points of the midpoint rule for the prior."""

Drive = Callable[[Array], Array]
"""``drive(time_s) -> (N, nu)``: true inputs in their units over times (N,) in seconds from a recording's first tick."""
Loads = Callable[[float, Array, np.random.Generator], Drive]
"""``loads(seconds, lean, rng) -> drive``: what a recording of such length is run through. ``lean`` (leans,) in [0, 1]
are its coordinates in a Latin hypercube, for what is to differ evenly between recordings."""


def with_unit(label: str, unit: str) -> str:
    """``temperature bias, K``; a dash stands for no unit."""
    return f"{label}, {'–' if unit in ('', '1') else unit}"


@dataclass(frozen=True, eq=False)
class Machine:
    """A machine of the benchmark.

    Attributes:
        name: as commands, files and tables call it.
        plant: the truth.
        reduced: the model that a twin's owner has: the plant's states, inputs, outputs and parameters, less physics.
        estimated: states that are estimated and scored; they stand first in both simulators.
        health: nh parameters that are estimated and scored, too.
        readings: of every output, in their order.
        noise: of every channel, inputs first.
        loads: what the machine is run through.
        says: what it is, in words.
        labels: what channels, states and health are called in tables and figures, by name; what their variables say if
            left out.
        leans: coordinates of the Latin hypercube that ``loads`` takes.
        lags: states behind the estimated ones, in the simulators' order.
        drift: what several sensors err by together.
        recalibrated: constants of the reduced model that may be fitted to training recordings.
        state_walk: by state, process noise in the square root of a second, in its unit.
        state_spread: by estimated state, sd of counterfactual states, in its unit.
        least: by state, the lowest value that a filter lets it have, in its unit.
        query: what says the operating point: channels, or quotients of two written ``a/b``; the inputs if left out.
        slow: channels whose running means tell more than their last minutes; all outputs if left out.
        silent: outputs whose sensors may fall silent for a while; all if left out.
        alike: groups of estimated states that move together: networks give each group one head.
        regimes: by name, what splits recordings into thirds, as in ``query``; all inputs if left out.
        commands: inputs whose moves are changes of load; all inputs if left out.
        start: ``start(u0)``: the plant's state at a recording's beginning; where it settles if left out.
        recombine: ``recombine(inputs, outputs, rng)`` of (B, N, nu) and (B, N, ny): inputs (B, N, nu) made of those of
            several recordings; each input from any of them if left out.
        stretched: ``stretched(drive, beyond) -> drive``: the same loads, farther from their middle by such a share.
        sample_period_s: of the recordings.
    """

    name: str
    plant: Simulator
    reduced: Simulator
    estimated: tuple[str, ...]
    health: tuple[Health, ...]
    readings: tuple[Reading, ...]
    noise: tuple[Noise, ...]
    loads: Loads
    says: str = ""
    labels: Mapping[str, str] = field(default_factory=dict)
    leans: int = 0
    lags: tuple[Lag, ...] = ()
    drift: Drift = APART
    recalibrated: tuple[str, ...] = ()
    state_walk: Mapping[str, float] = field(default_factory=dict)
    state_spread: Mapping[str, float] = field(default_factory=dict)
    least: Mapping[str, float] = field(default_factory=dict)
    query: tuple[str, ...] = ()
    slow: tuple[str, ...] = ()
    silent: tuple[str, ...] = ()
    alike: tuple[tuple[str, ...], ...] = ()
    regimes: Mapping[str, str] = field(default_factory=dict)
    commands: tuple[str, ...] = ()
    start: Callable[[Array], Array] | None = None
    recombine: Callable[[Array, Array, np.random.Generator], Array] | None = None
    stretched: Callable[[Any, float], Drive] | None = None
    sample_period_s: float = 0.05

    @functools.cached_property
    def inputs(self) -> tuple[str, ...]:
        """Names of the nu inputs."""
        return tuple(v.name for v in self.plant.inputs)

    @functools.cached_property
    def outputs(self) -> tuple[str, ...]:
        """Names of the ny outputs."""
        return tuple(v.name for v in self.plant.outputs)

    @functools.cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels of a recording, inputs first."""
        return self.inputs + self.outputs

    @functools.cached_property
    def health_names(self) -> tuple[str, ...]:
        """Names of the nh health parameters."""
        return tuple(h.name for h in self.health)

    @functools.cached_property
    def quantities(self) -> tuple[str, ...]:
        """Names of everything that is estimated: states, then health."""
        return self.estimated + self.health_names

    @functools.cached_property
    def variables(self) -> dict[str, Variable]:
        """The plant's states, inputs, outputs and parameters by name."""
        plant = self.plant
        return {v.name: v for v in (*plant.parameters, *plant.outputs, *plant.inputs, *plant.states)}

    def label(self, name: str) -> str:
        """What a channel, state or parameter is called in tables and figures."""
        return self.labels.get(name) or self.variables[name].says or name

    def axis_label(self, name: str) -> str:
        """``temperature bias, K``; a dash stands for no unit."""
        return with_unit(self.label(name), self.variables[name].unit)

    @functools.cached_property
    def scales(self) -> Array:
        """One typical change of everything that is estimated, (n + nh,) in the quantities' units."""
        return np.array([self.variables[name].scale for name in self.quantities])

    @functools.cached_property
    def coordinates(self) -> Coordinates:
        """Of health, for filters."""
        variables = [self.plant.parameters[self.plant.index(name)] for name in self.health_names]
        healthy, low, high, scale = (
            np.array([getattr(v, part) for v in variables], dtype=np.float64)
            for part in ("nominal", "low", "high", "scale")
        )
        return coordinates(healthy, low, high, scale, np.array([h.exponential for h in self.health]))

    @functools.cached_property
    def span(self) -> Array:
        """How far each health parameter moves over a life, (nh,) in their units."""
        return np.array([h.span for h in self.health])

    @functools.cached_property
    def zeta_bounds(self) -> tuple[Array, Array]:
        """Bounds (nh,) of the coordinates, far outside a life, dimensionless.

        The upper ones keep an interval's width: beyond a physical bound both of its ends would be that bound.
        """
        limit = np.abs(self.coordinates.to_zeta(np.array([self._farthest(h) for h in self.health])))
        return -limit, np.minimum(limit, self.coordinates.to_zeta(self.coordinates.high))

    def _farthest(self, h: Health) -> float:
        fresh, worn = h.ends
        return worn + (worn - fresh) if np.isnan(h.farthest) else h.farthest

    @functools.cached_property
    def counterfactual(self) -> tuple[Array, Array]:
        """Lowest and highest health (nh,) that networks are shown, within the bounds, in the parameters' units."""
        ranges = []
        for h in self.health:
            ends = sorted(h.ends)
            more = BEYOND_LIFE * (ends[1] - ends[0])
            ranges.append((ends[0] - more, ends[1] + more) if np.isnan(h.counterfactual[0]) else h.counterfactual)
        low, high = np.array(ranges).T
        return np.maximum(low, self.coordinates.low), np.minimum(high, self.coordinates.high)

    @functools.cached_property
    def health_walk(self) -> Array:
        """What health wanders by in the square root of a second, (nh,) in the parameters' units."""
        return np.array([h.walk or h.span / LIFE_WALKS for h in self.health])

    @functools.cached_property
    def states_walk(self) -> Array:
        """Process noise of all the plant's states in the square root of a second, (nx,) in their units."""
        return np.array([self.state_walk.get(v.name, STATE_WALK * v.scale) for v in self.plant.states])

    @functools.cached_property
    def states_spread(self) -> Array:
        """sd of counterfactual states, (n,) of the estimated ones in their units."""
        known = {v.name: v for v in self.plant.states}
        return np.array([self.state_spread.get(n, STATE_SPREAD * known[n].scale) for n in self.estimated])

    @functools.cached_property
    def state_bounds(self) -> tuple[Array, Array]:
        """Lowest and highest values (nx,) that a filter lets the plant's states have, in their units."""
        low = np.array([self.least.get(v.name, v.low) for v in self.plant.states])
        return low, np.array([v.high for v in self.plant.states])

    @functools.cached_property
    def drift_shares(self) -> Array:
        """Of every channel, (nu + ny,): the share of its value that one sd of the common drift is."""
        return np.array([self.drift.share if c in self.drift.channels else 0.0 for c in self.channels])

    def start_of(self, wear: Array) -> Array:
        """Health (..., nh) in the parameters' units of a machine that is worn by so much.

        Args:
            wear: (..., nh) dimensionless: 0 is fresh and 1 worn.
        """
        fresh, worn = np.array([h.start for h in self.health]).T
        return fresh + wear * (worn - fresh)

    @functools.cached_property
    def prior(self) -> tuple[Array, Array]:
        """Of health at the start: mean (nh,) and covariance (nh, nh) in coordinates, dimensionless.

        It is what every filter knows before it reads.
        """
        wear = (np.arange(GRID) + 0.5) / GRID
        zeta = self.coordinates.to_zeta(self.start_of(np.tile(wear[:, None], (1, len(self.health)))))
        return zeta.mean(axis=0), np.diag(zeta.var(axis=0))

    def at_first(self, u0: Array) -> Array:
        """The plant's state (nx,) at a recording's beginning, in the states' units.

        Args:
            u0: (nu,) inputs in their units.

        Raises:
            ValueError: it is to begin settled, and does not settle there.
        """
        return steady_state(self.plant, u0) if self.start is None else self.start(u0)

    @functools.cached_property
    def operating(self) -> tuple[str, ...]:
        """What says the operating point: channels, or quotients of two."""
        return self.query or self.inputs

    def along(self, expression: str, channels: Array) -> Array:
        """Values (...,) of a channel, or of a quotient of two, in their units.

        Args:
            expression: the name of a channel, or ``a/b``.
            channels: (..., nu + ny) values of all channels in their units.
        """
        above, _, below = expression.partition("/")
        values = channels[..., self.channels.index(above)]
        return values / channels[..., self.channels.index(below)] if below else values

    def sources(self) -> np.ndarray:
        """Of every output, where the state that it reads stands among the estimated ones and the lags, (ny,)."""
        names = self.estimated + tuple(lag.state for lag in self.lags)
        return np.array([names.index(r.state) for r in self.readings])

    def observe(self, mean: Array) -> Array:
        """Readings (..., ny) in the outputs' units of estimates (..., n + nh), lags settled.

        Args:
            mean: (..., n + nh) in the quantities' units.
        """
        follows = {lag.state: lag.follows for lag in self.lags}
        read = [r.gain * mean[..., self.quantities.index(follows.get(r.state, r.state))] for r in self.readings]
        for i, r in enumerate(self.readings):
            if r.bias:
                read[i] = read[i] + mean[..., self.quantities.index(r.bias)]
        return np.stack(read, axis=-1)
