"""What all hypotheses stand on: the sensors' noise and the discrepancy, learnt together before anything is named.

Noise learnt beside a misfit takes the misfit for noise. So it is learnt with the discrepancy free to hold whatever the
machine does and the simulator does not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from twinbench.mismatch.fit import parallel
from twinbench.mismatch.naming.discrepancy import Discrepancy
from twinbench.mismatch.naming.input_noise import InputNoise, Moves
from twinbench.mismatch.naming.marginal import DISCREPANCY_PCT, LEAST_PCT, Reduced, eliminated, factored, learn
from twinbench.mismatch.naming.view import View, prior_mean
from twinbench.mismatch.seed import ENGINE_SEED
from twinbench.mismatch.sensors import SensorNoise
from twinbench.physics.simulator import Array, Port

ROUNDS_OF_NOISE = 3
"""Turns of learning the noise beside the discrepancy and the discrepancy beside the noise; a fourth changes nothing."""
SILENT_PCT = 0.02
"""A port at which the discrepancy is smaller has none: a thirtieth of its prior."""
UNSEEN = 0.05
"""Information (prior variance over posterior variance, less one) below which a function is left out."""
FIRST_PCT = 0.3


class Products(NamedTuple):
    """Of whitened columns, per recording: K of their own, then F of the discrepancy.

    Attributes:
        own: (R, K + 1, K + 1) of the K with each other, whitened; residuals last.
        cross: (R, K + 1, F) of them with the discrepancy's, whitened.
        FF: (R, F, F) of those with each other, whitened.
    """

    own: Array
    cross: Array
    FF: Array

    def scaled(self, at: np.ndarray, factor: float | Array) -> Products:
        """With some of their own columns made smaller or larger.

        Args:
            at: (n,) positions of these columns.
            factor: by how much, all or each (n,), dimensionless.
        """
        by = np.ones(self.own.shape[1])
        by[at] = factor
        return Products(self.own * by[:, None] * by, self.cross * by[:, None], self.FF)

    def less(self, out: np.ndarray, at: Sequence[int], moved: Array) -> Products:
        """Without some of their own columns, once the residuals are less some of them.

        Args:
            out: (n,) positions of those without which.
            at: positions of those which the residuals are less.
            moved: (m,) by how much of each, in what the columns are per: dimensionless.
        """
        return self.some(np.delete(np.arange(self.own.shape[1] - 1), out), at, moved)

    def some(self, kept: np.ndarray, at: Sequence[int] | np.ndarray, moved: Array) -> Products:
        """Some of their own columns in some order, once the residuals are less some of them.

        Args:
            kept: (k,) positions of these.
            at: (m,) positions of those which the residuals are less.
            moved: (m,) by how much of each, in what the columns are per: dimensionless.
        """
        turn = np.eye(self.own.shape[1])
        turn[at, -1] = -moved
        turn = turn[:, [*kept, -1]]
        return Products(turn.T @ self.own @ turn, turn.T @ self.cross, self.FF)

    def over(self) -> tuple[Array, Array, float]:
        """Over all recordings: G (K + F, K + F), b (K + F,), and of residuals with themselves."""
        own, cross, FF = (part.sum(axis=0) for part in self)
        G = np.block([[own[:-1, :-1], cross[:-1]], [cross[:-1].T, FF]])
        return G, np.concatenate((own[:-1, -1], cross[-1])), float(own[-1, -1])


@dataclass(frozen=True)
class Ground:
    """What all hypotheses share: the noise, and the discrepancy's columns whitened.

    Attributes:
        whole: (B, ny, F) columns of the discrepancy per recording, in the outputs' units per per cent.
        white: (B * ny, F) per recording, the same, whitened.
        FF: (R, F, F) products of the whitened ones, per recording.
        group: (F,) positions in ``ports`` of each.
        ports: where a discrepancy was found.
        discrepancy: the functions.
        s: (P,) its size at each with nothing named, per cent of what is common there.
        kept: per port, its position among the discrepancy's and the combinations (R, k) of its R functions that the
            columns are of, dimensionless.
        inputs: per recording, the noise of its measured inputs; empty if none has any.
        moved: per recording, what of that the readings feel, (B, ny, N) in the outputs' units; empty likewise.
    """

    noise: SensorNoise
    whole: tuple[Array, ...]
    white: tuple[Array, ...]
    FF: Array
    group: np.ndarray
    ports: tuple[Port, ...]
    s: Array
    discrepancy: Discrepancy
    kept: tuple[tuple[int, Array], ...]
    inputs: tuple[InputNoise, ...] = ()
    moved: tuple[Array, ...] = ()

    @classmethod
    def learnt(cls, view: View, discrepancy: Discrepancy, floor: Array) -> Ground:
        """Noise and discrepancy around a fit in which nothing is named.

        Args:
            floor: (ny,) noise of block means by their second differences, in the outputs' units.
        """
        own, every = view.unknowns(), list(range(len(discrepancy.ports)))
        whole, all_of_it = view.of_discrepancy(discrepancy, every), np.eye(len(discrepancy.points))
        felt = _felt(view)
        first = SensorNoise.first_guess(floor)
        made = cls._whitened(first, felt(first), whole, view, [(p, all_of_it) for p in every], discrepancy)
        made = made._without_the_unseen(view, own)
        rng = np.random.default_rng(ENGINE_SEED)
        for _ in range(ROUNDS_OF_NOISE):
            left, s = made._left(view, own, prior_mean(view), rng)
            noise = made.noise.learnt(left, floor)
            made = replace(cls._whitened(noise, felt(noise), made.whole, view, made.kept, discrepancy), s=s)
        return made

    def relearnt(self, view: View, columns: Sequence[Array], mean: Array, floor: Array) -> Ground:
        """The same discrepancy, and the noise learnt anew beside more that is unknown.

        What the simulator lacked when the noise was learnt first may have been taken for noise.

        Args:
            columns: (B, ny, K) of all that is unknown, per recording, in the outputs' units per prior sd.
            mean: (K,) of its prior, dimensionless: in prior sds.
            floor: (ny,) noise of block means by their second differences, in the outputs' units.
        """
        made, felt, rng = self, _felt(view), np.random.default_rng(ENGINE_SEED)
        for _ in range(ROUNDS_OF_NOISE):
            left, s = made._left(view, columns, mean, rng)
            noise = made.noise.learnt(left, floor)
            made = self._whitened(noise, felt(noise), made.whole, view, made.kept, self.discrepancy)
            made = replace(made, s=s)
        return made

    @classmethod
    def _whitened(
        cls,
        noise: SensorNoise,
        moved: Sequence[Array],
        whole: Sequence[Array],
        view: View,
        kept: Sequence[tuple[int, Array]],
        discrepancy: Discrepancy,
    ) -> Ground:
        def by_sensors(r: int, columns: Array) -> Array:
            return noise.beside(columns, view.residuals[r])[:, :-1].copy()

        inputs = [InputNoise.of(by_sensors(r, m)) for r, m in enumerate(moved)]
        found = parallel([lambda r=r: by_sensors(r, whole[r]) for r in range(len(whole))])
        if inputs:
            found = [one.whitened(white) for one, white in zip(inputs, found, strict=True)]
        FF = np.array([w.T @ w for w in found])
        group = np.repeat(np.arange(len(kept)), [turn.shape[1] for _, turn in kept])
        ports, first = tuple(discrepancy.ports[p] for p, _ in kept), np.full(len(kept), FIRST_PCT)
        return cls(
            noise, tuple(whole), tuple(found), FF, group, ports, first, discrepancy, tuple(kept),
            tuple(inputs), tuple(moved),
        )  # fmt: skip

    @property
    def variance(self) -> Array:
        """(ny,) of block means by the noise of sensors and measured inputs, in the outputs' units squared."""
        by_inputs = [np.square(m).sum(axis=2).mean(axis=0) for m in self.moved]
        return self.noise.variance + (np.mean(by_inputs, axis=0) if by_inputs else 0.0)

    @property
    def exact(self) -> Ground:
        """The same noise and no discrepancy."""
        return replace(
            self,
            whole=tuple(w[:, :, :0] for w in self.whole),
            white=tuple(w[:, :0] for w in self.white),
            FF=self.FF[:, :0, :0],
            group=self.group[:0],
            ports=(),
            s=self.s[:0],
            kept=(),
        )

    def _without_the_unseen(self, view: View, own: Sequence[Array]) -> Ground:
        """Without ports at which there is no discrepancy, and without functions of which the readings show nothing."""
        inner, s = self._beside(*self.products(view, own).over()[:2], prior_mean(view))
        there = [p for p in range(len(s)) if s[p] > SILENT_PCT] or [int(np.argmax(s))]
        whole: list[list[Array]] = [[] for _ in self.whole]
        kept = []
        for p in there:
            mine = self.group == p
            seen, turn = np.linalg.eigh(inner.G[np.ix_(mine, mine)])
            turn = turn[:, seen * (3.0 * max(s[p], DISCREPANCY_PCT)) ** 2 > UNSEEN]
            kept.append((p, turn))
            for own_columns, columns in zip(whole, self.whole, strict=True):
                own_columns.append(columns[:, :, mine] @ turn)
        joined = [np.concatenate(columns, axis=2) for columns in whole]
        made = self._whitened(self.noise, self.moved, joined, view, kept, self.discrepancy)
        return replace(made, s=s[there])

    def _left(
        self, view: View, own: Sequence[Array], mean: Array, rng: np.random.Generator
    ) -> tuple[list[Array], Array]:
        """Residuals less a draw of all that is unknown, (B, ny) per recording; and the discrepancy's sizes."""
        G, b, _ = self.products(view, own).over()
        _, s = self._beside(G, b, mean)
        prior = (
            np.concatenate((mean, np.zeros(len(self.group)))),
            np.concatenate((np.ones(len(mean)), self.precision(s))),
        )
        return self.noise_drawn(G, b, prior, view.residuals, own, rng), s

    def _beside(self, G: Array, b: Array, mean: Array) -> tuple[Reduced, Array]:
        """The discrepancy's functions with the unknowns integrated out, and its size (P,) at each port, per cent."""
        inner = eliminated(G, b, np.arange(len(mean)), mean, np.ones(len(mean)))
        return inner, learn(inner.G, inner.b, self.group, self.s).s

    def noise_drawn(
        self,
        G: Array,
        b: Array,
        prior: tuple[Array, Array],
        residuals: Sequence[Array],
        columns: Sequence[Array],
        rng: np.random.Generator,
    ) -> list[Array]:
        """The sensors' noise: residuals less a posterior draw of all that is unknown, (B, ny) per recording.

        Args:
            G: (K + F, K + F) products of whitened columns, the discrepancy's last.
            b: (K + F,) products of these with the whitened residuals.
            prior: mean and precision, dimensionless (K + F,), of what the columns are per.
            residuals: (B, ny) per recording, in the outputs' units.
            columns: (B, ny, K) per recording, in the outputs' units.
        """
        mean, precision = prior
        scale, L = factored(G + np.diag(precision))
        drawn = solve_triangular(L, rng.normal(size=len(b)), lower=True, trans=1)
        weights = scale * (cho_solve((L, True), scale * (b + precision * mean)) + drawn)
        left = [
            residual - np.nan_to_num(np.concatenate((j, f), axis=2)) @ weights
            for residual, j, f in zip(residuals, columns, self.whole, strict=True)
        ]
        for r, (inputs, moved) in enumerate(zip(self.inputs, self.moved, strict=True)):
            white = self.noise.beside(np.empty((*left[r].shape, 0)), left[r])[:, 0]
            left[r] = left[r] - moved @ inputs.drawn(white, rng)
        return left

    def precision(self, s: Array) -> Array:
        """(F,) prior precision of the functions' weights where the discrepancy has some sizes.

        Args:
            s: (P,) these sizes, per cent.
        """
        return np.asarray(1.0 / np.maximum(s[self.group], LEAST_PCT) ** 2)

    def whitened(self, r: int, columns: Array, residuals: Array) -> Array:
        """Columns and last the residuals of recording r, whitened, (B ny, K + 1).

        Args:
            columns: (B, ny, K) in the outputs' units.
            residuals: (B, ny) in the outputs' units.
        """
        white = self.noise.beside(columns, residuals)
        return self.inputs[r].whitened(white) if self.inputs else white

    def products(self, view: View, columns: Sequence[Array]) -> Products:
        """Products of columns, then the discrepancy's, with each other and with the residuals.

        Args:
            columns: (B, ny, K) per recording, in the outputs' units.
        """
        return self.products_of(view, lambda r: columns[r])

    def products_of(self, view: View, columns: Callable[[int], Array]) -> Products:
        """As ``products``, where the columns of each recording are made when it is their turn: many take much room."""

        def of(r: int) -> tuple[Array, Array]:
            white = self.whitened(r, columns(r), view.residuals[r])
            return white.T @ white, white.T @ self.white[r]

        found = parallel([lambda r=r: of(r) for r in range(len(view.residuals))])
        own, cross = (np.array(part) for part in zip(*found, strict=True))
        return Products(own, cross, self.FF)


def _felt(view: View) -> Callable[[SensorNoise], list[Array]]:
    """By the sensors' noise, what the readings feel of the noise of measured inputs, (B, ny, N) per recording."""
    sds = view.problem.machine.input_sds
    moves = parallel([lambda c=c: Moves(c, sds) for c in view.courses]) if sds.any() else []

    def felt(noise: SensorNoise) -> list[Array]:
        return parallel([lambda m=m, r=r: m.felt(noise, r) for m, r in zip(moves, view.residuals, strict=False)])

    return felt
