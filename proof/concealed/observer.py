"""The ideal observer: what anybody could tell of a case who knew truth's own equations and the noise.

It sees the recordings that an engine may learn from, and none held out. Parameters, starts, ambient and ripple are
unknown to it as far as the draw left them open; they are projected out. Of two effects each is looked at with the other
known but for its size, so that for both together the observer is a little too good. Distances are in sds of the noise
that is left: to first order from all rivals, and by a fit of all that is unknown (``refit``) from the nearest.

The class of an effect is what nobody can tell from it, and what comes nearest of all if the catalogue's form of its
name does not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, logsumexp

from twinbench.physics.simulator import Array
from twinbench.proof.concealed.columns import Picture
from twinbench.proof.concealed.refit import NOTHING

SEEN_SQ = 30.0
"""Squared distance from "no effect" at which an effect counts as there to be seen."""
TOLD_SQ = 16.4
"""Squared distance from the nearest rival at which it counts as told from it: 1 of 50 choices is then wrong."""
SAME_COS_SQ = 0.998
"""Columns at a smaller angle than this one's are one thing."""
SAME_SQ, SAME_SHARE = 1.0, 0.05
"""So are effects nearer than one sd of the noise, if that is also less than this share of the distance from none."""
MOST_SHARE = 0.5
"""What is left of an effect when something explains most of it, as a share of its squared distance from none."""
PARAMETER_SQ = 9e-8
"""A column of which less than this share of the squared norm is left is a parameter."""
SURE_POSTERIOR = 0.95
"""The ideal observer names what has this probability."""
FITTED = 5
"""Nearest rivals that all is fitted anew for, and so many more if none of them can be told from the effect."""
WITHOUT_SIZE = ("stuck@", "quantisation@")
"""Parts of the names of rivals without a small size that a fit could begin from."""
_DRAWS = 200
"""Simulated recordings per effect: a rate to within 3.5 points."""
_LEAST_SEVERITY = 1e-3
"""Keeps the prior of a column that is nothing finite."""


class Seen(NamedTuple):
    """What the ideal observer makes of one effect.

    Attributes:
        same: catalogue names that nobody can tell from it, its own among them.
        close: other names that nobody can tell from it at this size, and that explain more than half of it.
        from_none, from_rival: squared distances from "no effect" and from the nearest rival.
        rival: the name of that: the nearest single effect or fault that is not the same.
        form: squared distance of its name's own form in the catalogue; 0 where none was fitted.
        stand_in: squared distance of the nearest name that is neither ``same`` nor ``close``, from none at most.
        named, classed: with which probability it is named alone, or its class is.
    """

    same: tuple[str, ...]
    close: tuple[str, ...]
    from_none: float
    from_rival: float
    rival: str
    form: float
    stand_in: float
    named: float
    classed: float

    @property
    def detectable(self) -> bool:
        return self.from_none >= SEEN_SQ and self.from_rival >= TOLD_SQ

    def told(self) -> dict[str, Any]:
        """As the truth holds it."""
        return {
            "class": list(self.same),
            "close": list(self.close),
            "D0_sq": self.from_none,
            "Dk_sq": self.from_rival,
            "rival": self.rival,
            "form_sq": self.form,
            "stand_in_sq": self.stand_in,
            "detectable": self.detectable,
            "ideal_name": self.named,
            "ideal_class": self.classed,
        }


def observe(
    picture: Picture,
    truth: str,
    beside: tuple[str, ...],
    rng: np.random.Generator,
    refit: Callable[[Sequence[str]], Mapping[str, float]] | None = None,
) -> Seen:
    """What can be told of an effect whose column was taken at its true size.

    Args:
        beside: other effects of the case, of unknown size.
        refit: squared distances of the effect from ``NOTHING``, from its name's own form in the catalogue and from
            rivals, all that is unknown fitted anew; without it all distances are first order's.
    """
    own, names = picture.names.index(truth), np.array(picture.names)
    gram = without(picture.gram, [picture.names.index(name) for name in beside])
    norms = np.diag(gram)
    there = (norms > PARAMETER_SQ * picture.raw) & ~np.isin(names, beside)
    there[own] = True
    along = gram[own] / np.sqrt(np.maximum(norms * norms[own], np.finfo(float).tiny))
    cos_sq = np.where(picture.two_sided | (along > 0.0), along**2, 0.0) * there
    cos_sq[own] = 1.0
    norm = float(norms[own])
    apart = np.where(there & ~picture.foreign & (names != truth), norm * (1.0 - cos_sq), np.inf)
    form = 0.0
    if refit is not None and norm > SEEN_SQ and "stuck@" not in truth:
        asked = _nearest(picture.names, apart)
        found = dict(refit([NOTHING, truth, *asked[:FITTED]]))
        norm, form = max(found.pop(NOTHING), np.finfo(float).tiny), found.pop(truth, 0.0)
        form = 0.0 if any(part in truth for part in WITHOUT_SIZE) else form
        if max(found.values(), default=np.inf) < TOLD_SQ:  # then there may be more that cannot be told from it
            found |= refit(asked[FITTED:])
        apart = np.where(np.isfinite(apart), np.minimum(apart, norm), np.inf)
        for name, distance_sq in found.items():
            apart[names == name] = min(distance_sq, norm)
        cos_sq = np.where(np.isfinite(apart), 1.0 - apart / norm, cos_sq)
        gram = _moved(gram, own, norm, cos_sq)
    slight = min(SAME_SQ, SAME_SHARE * norm)
    one = (cos_sq > SAME_COS_SQ) | (apart < slight)
    # The catalogue's form of the name is another than truth's: what comes as near as that, and nearest, is as right.
    one |= apart < min(float(apart.min()) + SAME_SQ, form + slight, MOST_SHARE * norm)
    same = np.isin(names, names[one]) & ~picture.foreign  # one shape of a name is enough
    apart = np.where(same, np.inf, apart)
    close = apart < min(TOLD_SQ, MOST_SHARE * norm)
    nearest = int(np.argmin(apart))
    named, classed = ideal_posterior(picture, gram, own, there & ~picture.foreign, same, rng)
    return Seen(
        _those(picture.names, same),
        _those(picture.names, close),
        norm,
        float(min(apart[nearest], norm)),
        picture.names[nearest] if np.isfinite(apart[nearest]) else "",
        form,
        float(min(np.where(close, np.inf, apart).min(), norm)),
        named,
        classed,
    )


def _nearest(names: Sequence[str], apart: Array) -> list[str]:
    """The names that come nearest, each once, as far as a fit can go to them."""
    found: list[str] = []
    for i in np.argsort(apart):
        if len(found) == 2 * FITTED or not np.isfinite(apart[i]):
            break
        if names[i] not in found and not any(part in names[i] for part in WITHOUT_SIZE):
            found.append(names[i])
    return found


def _moved(gram: Array, own: int, norm: float, cos_sq: Array) -> Array:
    """A Gram matrix in which one column has another squared norm, and other cosines with the rest."""
    moved = gram.copy()
    moved[own] = np.sign(gram[own]) * np.sqrt(np.clip(cos_sq, 0.0, 1.0) * norm * np.maximum(np.diag(gram), 0.0))
    moved[:, own] = moved[own]
    moved[own, own] = norm
    return moved


def ideal_posterior(
    picture: Picture,
    gram: Array,
    own: int,
    candidates: NDArray[np.bool_],
    same: NDArray[np.bool_],
    rng: np.random.Generator,
) -> tuple[float, float]:
    """Probabilities that the ideal observer is sure of the effect's name, and of its class.

    Recordings are drawn, each at once as the inner products b of its noise and effect with the columns. The prior of
    each of m names is 1 / m of that of "no effect", shared by its shapes; its size has the s of severity 1.

    Args:
        gram: (K, K) inner products of the whitened columns, all else projected out.
        own: the true one's place.
        candidates: (K,) bool, what may be named.
        same: (K,) bool, what is in the true one's class.
    """
    if picture.foreign[own]:
        return 0.0, 0.0
    at = np.flatnonzero(candidates)
    among = gram[np.ix_(at, at)]
    values, vectors = np.linalg.eigh(among)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    mine = int(np.flatnonzero(at == own)[0])
    b = among[:, [mine]] + root @ rng.standard_normal((len(at), _DRAWS))
    s = 1.0 / np.maximum(picture.severities[at], _LEAST_SEVERITY)[:, None]
    _, of, shapes = np.unique([picture.names[i] for i in at], return_inverse=True, return_counts=True)
    evidence = log_bayes(b, np.diag(among)[:, None], s, ~picture.two_sided[at][:, None])
    evidence -= np.log(len(shapes) * shapes[of])[:, None]
    total = logsumexp(np.concatenate([np.zeros((1, _DRAWS)), evidence]), axis=0)
    posterior = np.exp(evidence - total)
    named, classed = posterior[mine], posterior[same[at]].sum(axis=0)
    return float(np.mean(named >= SURE_POSTERIOR)), float(np.mean(classed >= SURE_POSTERIOR))


def _those(names: tuple[str, ...], chosen: NDArray[np.bool_]) -> tuple[str, ...]:
    return tuple(sorted({name for name, is_one in zip(names, chosen, strict=True) if is_one}))


def log_bayes(b: Array, g: Array, s: Array, one_sided: NDArray[np.bool_]) -> Array:
    """Logarithm of the Bayes factor of a column against its absence.

    It is sqrt(v) / s exp(v b^2 / 2) with v = 1 / (g + 1 / s^2). Where the size cannot be negative it is
    2 Phi(b sqrt(v)) times that.

    Args:
        b: any shape, inner products of the whitened recording with the whitened columns.
        g: any shape that goes with it, squared norms of the whitened columns.
        s: any shape that goes with them, sds of the sizes, normal or half-normal, in units of the columns.
        one_sided: bool, any shape that goes with them: can the size not be negative?
    """
    v = 1.0 / (g + s**-2.0)
    half = np.log(2.0) + log_ndtr(b * np.sqrt(v))
    return np.asarray(0.5 * np.log(v / s**2) + 0.5 * v * b**2 + np.where(one_sided, half, 0.0))


def without(gram: Array, at: Sequence[int]) -> Array:
    """A Gram matrix with some columns projected out of all; theirs become zero.

    Args:
        gram: (K, K) inner products of the whitened columns.
        at: positions of those that are projected out.
    """
    for i in at:
        norm = max(gram[i, i], np.finfo(float).tiny)
        gram = gram - np.outer(gram[:, i], gram[i]) / norm
    return gram
