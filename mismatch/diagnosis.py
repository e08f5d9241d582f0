"""What the walk found, as one record."""

from __future__ import annotations

from dataclasses import dataclass

from twinbench.mismatch.checks import Test
from twinbench.mismatch.explanation import Explanation
from twinbench.mismatch.followed import Followed
from twinbench.mismatch.joining import Joined
from twinbench.mismatch.machine import Machine
from twinbench.mismatch.picture import Picture
from twinbench.mismatch.proof import BorneOut, Gain, Held, Worse
from twinbench.mismatch.rivals import Rivals
from twinbench.mismatch.spikes import Spike
from twinbench.mismatch.stuck import Stuck
from twinbench.mismatch.tracks import Track
from twinbench.mismatch.transfer import Transfer
from twinbench.physics.simulator import Array, Simulator


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Everything that the walk found, for words, tables and figures.

    The fields stand in the order of the stages: what was seen, what was fitted, what the held-out recordings say.

    Attributes:
        floor: (ny,) noise of block means, in the outputs' units.
        before: the calibrated original model and its fit.
        chosen: the explanation that was accepted, or None.
        tried: explanations fitted in full on the way, best first.
        rivals: for each effect of ``chosen``, what these data cannot tell from it.
        threshold: gain that noise alone reaches in one of a hundred recordings, or the least gain.
        share: what was gained on held-out recordings; None without any.
        there: is what ``best`` adds to the outputs in the held-out readings.
        transferred: do many sizes together hold on the held-out recordings; None if they are few.
        worse: held-out outputs that ``best`` spoils beyond chance; it is refused then.
        stuck: sensors that stand still; ``tracks`` and ``held`` are without their readings.
        spikes: readings that were taken out, of all recordings.
        joined: how inputs go between samples.
        fitted: everything that was fitted in full under the final noise.
        losses: units that each set of names among it lies behind ``best``, on fitted recordings and, where it is near,
            on those held out too; no effect at all is the empty set.
        weighed_on_held_out: explanations that the held-out recordings were used to choose among.
        followed: how much of each output the accepted simulator explains, or the calibrated one.
    """

    simulator: Simulator
    machine: Machine

    tracks: list[Track]
    held: list[Track]
    joined: Joined
    floor: Array
    stuck: list[Stuck]
    spikes: tuple[Spike, ...]
    remarks: list[str]

    before: Explanation
    best: Explanation | None
    chosen: Explanation | None
    tried: list[Explanation]
    fitted: list[Explanation]
    shown: Picture
    threshold: float
    tests: list[Test]
    rivals: list[Rivals]
    losses: dict[frozenset[str], float]

    held_before: Held | None
    held_after: Held | None
    share: Gain | None
    there: BorneOut | None
    transferred: Transfer | None
    worse: tuple[Worse, ...]
    refused: str
    weighed_on_held_out: int
    followed: tuple[Followed, ...]

    @property
    def unfollowed(self) -> tuple[Followed, ...]:
        """Outputs that do something which the simulator explains nothing of."""
        return tuple(f for f in self.followed if not f.follows)
