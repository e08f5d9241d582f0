"""What the walk found, as one record."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from twinbench.mismatch.design.suggested import Suggested
from twinbench.mismatch.fit import Problem
from twinbench.mismatch.followed import Followed
from twinbench.mismatch.history.history import History
from twinbench.mismatch.joining import Joined
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.naming.answer import Answer
from twinbench.mismatch.naming.decision import Claim
from twinbench.mismatch.naming.selfcheck import SelfCheck
from twinbench.mismatch.naming.settle import Settled
from twinbench.mismatch.noisy_inputs import NoisyInput, SpikyInput
from twinbench.mismatch.proof import Held, Worse
from twinbench.mismatch.residual_tests import Test
from twinbench.mismatch.spikes import Spike
from twinbench.mismatch.stuck import Stuck
from twinbench.mismatch.tracks import Track
from twinbench.physics.simulator import Array, Series, Simulator


class Fit(NamedTuple):
    """A problem and where its unknowns stand.

    Attributes:
        z: (K,) where the problem's unknowns stand, each in its own unit.
    """

    problem: Problem
    z: Array

    @property
    def residuals(self) -> list[Array]:
        """Block means measured minus simulated, (B, ny) per recording, in the outputs' units."""
        return self.problem.residuals(self.z)


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Everything that the walk found, for words, tables and figures.

    The fields stand in the order of the stages: what was seen, what was fitted, what was weighed, what the held-out
    recordings say.

    Attributes:
        floor: (ny,) noise of block means, in the outputs' units.
        joined: how inputs go between samples.
        noisy: inputs whose records are noisy or have spikes; ``tracks`` and ``held`` are without these.
        stuck: sensors that stand still; ``tracks`` and ``held`` are without their readings.
        rounded: faults of sensors that move in steps; both fits have them.
        spikes: readings that were taken out, of all recordings.
        before: the calibrated simulator.
        answer: all hypotheses weighed, and the chosen one.
        self_check: what the answer is worth on these recordings.
        claims: what is said of it.
        mended: the simulator with the chosen effects; None where none is named and the held-out recordings do not
            show that they mend it.
        worse: held-out outputs that the chosen effects spoil beyond chance; then nothing is mended.
        refused: why the chosen effects have no name: they spoil an output, or leave one unfollowed. Empty if not so.
        experiment: what would tell apart what a claim cannot, where the recordings' inputs went; None where nothing is
            contested, or nothing would.
        followed: how much of each output the mended simulator explains, or the calibrated one.
        strange: why errors on held-out recordings are other than those where it learnt, output by output.
        histories: sizes over time of the chosen effects, each by its place.
    """

    simulator: Simulator
    machine: Machine

    tracks: list[Track]
    held: list[Track]
    joined: Joined
    noisy: tuple[SpikyInput | NoisyInput, ...]
    floor: Array
    stuck: list[Stuck]
    rounded: list[Series]
    spikes: tuple[Spike, ...]
    remarks: list[str]

    before: Fit
    tests: list[Test]

    answer: Answer
    self_check: SelfCheck
    claims: tuple[Claim, ...]
    mended: Fit | None

    held_before: Held | None
    held_after: Held | None
    worse: tuple[Worse, ...]
    refused: str
    experiment: Suggested | None
    followed: tuple[Followed, ...]
    strange: tuple[str, ...]
    histories: tuple[History, ...]

    @property
    def named(self) -> bool:
        """Is anything given a name?"""
        return any(claim.names for claim in self.claims)

    @property
    def stand_ins(self) -> tuple[str, ...]:
        """What the mended simulator has in the place of what has no name: the effects that explain it best."""
        if self.mended is None:
            return ()
        return tuple(claim.found.name for claim in self.claims if claim.found is not None and not claim.names)

    @property
    def accepted(self) -> Settled:
        """The hypothesis that is told: the chosen one, or that nothing is missing."""
        return self.answer.chosen if self.mended is not None else self.answer.naming.null

    @property
    def unfollowed(self) -> tuple[Followed, ...]:
        """Outputs that do something which the simulator explains nothing of."""
        return tuple(f for f in self.followed if not f.follows)

    @property
    def noise_sd(self) -> Array:
        """(ny,) standard deviation of the sensors' noise in block means, in the outputs' units."""
        return self.answer.naming.ground.noise.variance**0.5
