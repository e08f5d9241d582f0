"""What an estimator is: the protocol, its state, and the registry that one decorator fills."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from twinbench.data.batch import Array, Batch
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.machine import Machine

Z95 = 1.959963984540054
"""Half-width of a 95 % interval in standard deviations."""


class Sample(NamedTuple):
    """One tick of B machines.

    Attributes:
        time_s: of the tick.
        measured: (B, nu + ny) in the channels' units, inputs first; NaN means missing.
        lag_s: (B, nu + ny) seconds, how long before ``time_s`` each channel was read; None: not at all.
    """

    time_s: float
    measured: Array
    lag_s: Array | None = None


class State(NamedTuple):
    """What is carried to the next tick, and what is reported.

    Attributes:
        mean: (B, n) in the quantities' units: the machine's estimated states, then its health.
        cov: (B, n, n) in those units squared, symmetric positive semidefinite.
        low: (B, n) in the quantities' units, where the central 95 % begin.
        high: (B, n) in the quantities' units, where they end.
        memory: the method's own arrays, in units of its own, every shape (B, ...).
    """

    mean: Array
    cov: Array
    low: Array
    high: Array
    memory: tuple[np.ndarray, ...] = ()


class Info(NamedTuple):
    """What is diagnostic only: nothing of it feeds the next step.

    Attributes:
        innovation: (B, ny) measured minus predicted, in the outputs' units; NaN where missing.
        S: (B, ny, ny) innovation covariance, in those units squared.
        nis: (B,) dimensionless, innovation' S^-1 innovation over the accepted channels; NaN if none.
        accepted: (B, ny) bool, channels used in the correction.
        flags: (B,) int64, dimensionless: bitwise or of the FLAG_ constants.
        age_s: (B, nu + ny) seconds since each channel was last accepted.
    """

    innovation: Array
    S: Array
    nis: Array
    accepted: np.ndarray
    flags: np.ndarray
    age_s: Array


FLAG_SPIKE = 1
"""A channel was rejected as an isolated spike."""
FLAG_MISSING = 2
"""A channel had no measurement."""
FLAG_GATED = 4
"""A channel was too far from what was predicted, or seems to fail, and is left out of the correction for now."""
FLAG_UNINFORMED = 16
"""Of some health parameter hardly more is known than before the first reading: its sd is still nearly what it was."""


class Estimator(ABC):
    """A state and parameter estimator for B machines in lockstep.

    The subclass lists its ``settings`` with defaults; ``__init__`` only stores. ``fit`` learns
    everything that is learnt into ``self.arrays`` (names to NumPy arrays), which is all that is
    saved: whatever else ``step`` needs is rebuilt from settings and arrays by ``restore``.

    Attributes:
        machine: what it estimates.
        name: what commands and tables call it.
        says: what it is, in one line.
        settings: by name, their defaults.
        config: the settings of this one.
        arrays: by name, what was learnt; of any shape, in units of the method's own.
    """

    name: ClassVar[str]
    says: ClassVar[str] = ""
    settings: ClassVar[Mapping[str, Any]] = {}
    search_space: ClassVar[Mapping[str, Sequence[float]]] = {}
    """What tuning tries: by setting, a range as a tuple (low, high), or choices as a list. What ``fit`` reads is
    better chosen from a few: with the same values nothing is trained anew."""
    online: ClassVar[frozenset[str]] = frozenset()
    """Settings that ``fit`` never reads: with others of them nothing is trained anew."""
    ablations: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    """By name, the settings that leave one part of the method out."""
    ablation_of: ClassVar[str] = ""
    """Of an ablation: the name of the whole method."""
    left_out: ClassVar[Mapping[str, Any]] = {}
    """Of an ablation: the settings that it fixes, whatever a profile says."""
    draws: ClassVar[bool] = True
    """Does ``fit`` draw anything at random? If not, all seeds share what one of them learns."""
    contract_settings: ClassVar[Mapping[str, Any]] = {}
    """Settings that make ``fit`` quick enough for the contract battery."""
    implementations: ClassVar[tuple[str, ...]] = ("compiled",)
    """Forms of ``step`` that latency compares; more than one needs a setting ``implementation``."""
    toy_filter: ClassVar[Callable[..., Callable[[Array], tuple[Array, Array]]] | None] = None
    """Where the method reduces to a Kalman filter: its own blocks on a linear-Gaussian machine, as
    ``methods.kalman.linear_filter``; the contract battery holds them to the textbook."""
    window: int = 1
    """Samples of history that one update looks at."""
    two_sided: ClassVar[bool] = False
    """Does it know better afterwards? Then tables hold what ``smooth`` says, and its updates are not timed."""
    delayed: ClassVar[bool] = False
    """Can ``smooth`` say what was known a stated while later?"""

    def __init__(self, machine: Machine = COMPRESSOR, **settings: Any) -> None:
        unknown = sorted(set(settings) - set(self.settings))
        if unknown:
            known = ", ".join(self.settings) or "none"
            raise ValueError(f"{self.name}: unknown setting {unknown[0]!r}; it has: {known}")
        self.machine = machine
        self.config: dict[str, Any] = {**self.settings, **settings}
        self.arrays: dict[str, np.ndarray] = {}

    @abstractmethod
    def fit(self, train: Batch, validation: Batch, seed: int) -> None:
        """Learn from simulated sequences with truth; the same seed gives the same arrays.

        Args:
            train: sequences to learn from, with ``truth``.
            validation: others, with ``truth``, to choose by: when to stop, how much noise to expect.
            seed: of whatever is drawn.
        """

    def restore(self) -> None:  # noqa: B027  nothing to rebuild is the rule, not the exception
        """Rebuild what ``step`` needs from ``config`` and ``arrays``; called after fit and load."""

    @abstractmethod
    def init(self, batch: int) -> State:
        """The state before the first sample: what is known of the population.

        Args:
            batch: how many machines, B.
        """

    @abstractmethod
    def step(self, state: State, sample: Sample) -> tuple[State, Info]:
        """One tick. Pure: ``state`` is not changed, and only ``sample`` is new.

        Args:
            state: of the tick before, or what ``init`` gave.
            sample: what was read at this one.

        Returns:
            The state of this tick, and what is diagnostic about it.
        """

    def forecast(self, state: State, inputs: Array) -> Array:
        """Open loop from ``state`` with the parameters frozen.

        Args:
            state: where it starts.
            inputs: (B, L, nu), the measured inputs of the L ticks after the state's in the channels' units, gaps
                filled.

        Returns:
            (B, L, ny), the sensors' noise-free readings in the channels' units. This default holds the present ones.
        """
        return np.repeat(self.machine.observe(state.mean)[:, None], inputs.shape[1], axis=1)

    def smooth(self, measured: Array, ticks: np.ndarray, delay_s: float = np.inf) -> State:
        """What a recording says about some of its ticks a while later; of a method ``two_sided`` or ``delayed``.

        Args:
            measured: (B, N, nu + ny) readings in the channels' units, inputs first; NaN means missing.
            ticks: (K,) positions in the recordings, in increasing order.
            delay_s: seconds after a tick up to which readings may tell of it. Only a ``delayed`` method takes less than
                the whole recording.

        Returns:
            State with B x K rows, the K of each recording together.
        """
        raise NotImplementedError

    def save(self, path: Path) -> None:
        """Write settings and learnt arrays to one ``.npz``, without pickle.

        Args:
            path: of that file.
        """
        about = {
            "estimator": self.ablation_of or self.name,
            "machine": self.machine.name,
            "settings": self.config,
        }
        config = np.frombuffer(json.dumps(about, sort_keys=True).encode(), dtype=np.uint8)
        with open(path, "wb") as file:
            np.savez(file, allow_pickle=False, **{"config.json": config}, **self.arrays)

    @classmethod
    def load(cls, path: Path, machine: Machine = COMPRESSOR, **online: Any) -> Self:
        """Read what ``save`` wrote; settings given here, ones of ``online``, take the place of its own.

        Args:
            path: of that file.
            machine: what it was trained for.

        Raises:
            ValueError: it holds another estimator, was trained for another machine, or is of another version, which
                had other settings.
        """
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        about = json.loads(arrays.pop("config.json").tobytes())
        own = cls.ablation_of or cls.name
        if about["estimator"] != own:
            raise ValueError(f"{path} holds the estimator {about['estimator']!r}, not {own!r}")
        if about["machine"] != machine.name:
            raise ValueError(f"{path} was trained for the machine {about['machine']!r}, not for {machine.name!r}")
        if odd := sorted(set(about["settings"]) ^ set(cls.settings)):
            whose = "it has" if odd[0] in about["settings"] else "it lacks"
            raise ValueError(f"{path} is of another version of {own}: {whose} the setting {odd[0]!r}; train it anew")
        estimator = cls(machine, **{**about["settings"], **online})
        estimator.arrays = arrays
        estimator.restore()
        return estimator


def ablated(kind: type[Estimator], ablation: str) -> type[Estimator]:
    """An estimator without one of its parts, under the name ``estimator:ablation``."""
    return type(
        kind.__name__,
        (kind,),
        {
            "name": f"{kind.name}:{ablation}",
            "ablation_of": kind.name,
            "ablations": {},
            "left_out": kind.ablations[ablation],
            "settings": {**kind.settings, **kind.ablations[ablation]},
            "__module__": kind.__module__,
        },
    )


REGISTRY: dict[str, type[Estimator]] = {}
"""Every registered estimator by name."""


def register(estimator: type[Estimator]) -> type[Estimator]:
    """Class decorator: make an estimator known under its ``name``.

    Args:
        estimator: the class, which is given back as it is.

    Raises:
        ValueError: another class has that name.
    """
    known = REGISTRY.get(estimator.name)
    if known is not None and (known.__module__, known.__qualname__) != (estimator.__module__, estimator.__qualname__):
        raise ValueError(f"two estimators are named {estimator.name!r}: {known} and {estimator}")
    REGISTRY[estimator.name] = estimator
    return estimator


def gaussian_state(
    mean: Array, cov: Array, memory: tuple[np.ndarray, ...] = (), machine: Machine = COMPRESSOR
) -> State:
    """A state with Gaussian intervals; health is kept within its physical bounds.

    Args:
        mean: (B, n) in the quantities' units: the machine's estimated states, then its health.
        cov: (B, n, n) or (n, n), in those units squared.
        memory: the method's own arrays, in units of its own, every shape (B, ...).
        machine: whose quantities they are.

    Returns:
        The state, its ``low`` and ``high`` 1.96 standard deviations away, in the quantities' units.
    """
    n = len(machine.quantities)
    if mean.shape[-1] != n:
        raise ValueError(f"mean has {mean.shape[-1]} columns, expected {n}")
    cov = np.broadcast_to(cov, (len(mean), n, n))
    half = Z95 * np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1))
    bounds = np.full((2, n), [[-np.inf], [np.inf]])
    bounds[:, len(machine.estimated) :] = machine.coordinates.low, machine.coordinates.high
    mean = np.clip(mean, *bounds)
    low, high = np.clip(mean - half, *bounds), np.clip(mean + half, *bounds)
    return State(mean, cov, low, high, memory)


def no_info(batch: int, machine: Machine = COMPRESSOR) -> Info:
    """The diagnostics of a method that has none.

    Args:
        batch: how many machines, B.
        machine: of which kind.

    Returns:
        NaN, or nothing accepted and no flags, in the shapes and units of ``Info``.
    """
    ny = len(machine.outputs)
    nothing = np.full((batch, ny), np.nan)
    return Info(
        nothing,
        np.full((batch, ny, ny), np.nan),
        np.full(batch, np.nan),
        np.zeros((batch, ny), dtype=bool),
        np.zeros(batch, dtype=np.int64),
        np.full((batch, len(machine.channels)), np.nan),
    )
