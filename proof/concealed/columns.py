"""Everything that a case's readings could differ by, as one Gram matrix.

Effects that have a truth are linearised by its own equations, the rest of the catalogue by the twin's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from twinbench.mismatch.model import whole_catalogue
from twinbench.mismatch.naming.answer import PERIODIC
from twinbench.physics.simulator import Array
from twinbench.proof.concealed.changes import change_of
from twinbench.proof.concealed.faults import all_faults
from twinbench.proof.concealed.forms import PROBED, forms
from twinbench.proof.concealed.linear import FEATURES, Linear
from twinbench.proof.concealed.machine import Effect, Machine
from twinbench.proof.concealed.on_twin import OnTwin
from twinbench.proof.concealed.severity import Yardstick
from twinbench.proof.concealed.whiten import whitened
from twinbench.proof.twins import simulator_of

_PROBED_WITHIN = 0.7
"""Share by which the severity of a candidate that has a truth may differ from that."""
_UNIFORM_SD = 1.0 / np.sqrt(3.0)
"""sd of what is drawn evenly from -1 to 1: a parameter, in units of its spread."""
_PHASE_SD = np.sqrt(0.5)
"""sd of the sine and of the cosine of a phase that is drawn evenly."""
_START_SD = 50.0
"""sd of a start state, in steps: as good as unknown, so that it does not matter what it settles with."""
_PROBES, _PROBE_FACTOR = 3, 30.0
"""A candidate's size is changed so often at most, each time by this factor at most."""
_TINY = 1e-12
"""Of a diagonal of 1, so that columns which are nearly the same can be solved for."""


@dataclass(frozen=True)
class Picture:
    """What is left of each candidate's column in the training recordings, all that is no mechanism projected out.

    Attributes:
        names: of the candidates, foreign ones among them; a form of several shapes stands there as often.
        gram: (K, K) inner products of the whitened columns.
        raw: (K,) squared norms of the whitened columns before the projection.
        severities: (K,) dimensionless, of the columns, which are secants at these sizes.
        two_sided: (K,) bool, may its size be negative?
        foreign: (K,) bool, is it in no catalogue?
    """

    names: tuple[str, ...]
    gram: Array
    raw: Array
    severities: Array
    two_sided: NDArray[np.bool_]
    foreign: NDArray[np.bool_]


def picture(run: OnTwin, there: Mapping[str, float], background_pct: float) -> Picture:
    """The picture of a case.

    Args:
        run: the case's machine without effects and background, and its twin.
        there: sizes of what is really there, by name: their columns are taken at these.
        background_pct: the ripple's size.
    """
    yardstick, onset_s = run.yardstick, run.onset_s
    machine = yardstick.machine
    listed = [*machine.effects, *(e for e in machine.foreign if e.name in there), *all_faults(machine)]
    linear = Linear(yardstick, onset_s)
    columns, severities = _candidates(linear, listed, there, onset_s)
    periodic = [i for i, e in enumerate(listed) if e.name in there and e.name.startswith(PERIODIC)]
    added = forms(run, {e.name for e in listed}, [{k: columns[i][k].T for k in run.tracks} for i in periodic])
    columns += [list(form.columns) for form in added]
    severities = np.append(severities, [form.severity for form in added])
    ripple = background_pct / 100.0
    sds = [_UNIFORM_SD] * len(machine.calibrate) + background_sds(machine, ripple)
    gram, raw = np.zeros((len(columns) + len(sds),) * 2), np.zeros(len(columns))
    for i, take in enumerate(yardstick.takes):
        if take.held_out:  # no engine may learn from it
            continue
        own = np.stack([column[i] for column in columns])
        starts = linear.starts(i)
        part = _gram(machine, np.concatenate([own, linear.nuisances(i, ripple > 0.0), starts]))
        raw += np.diag(part)[: len(columns)]
        gram += _projected(part, np.full(len(starts), _START_SD**-2.0))
    two_sided, foreign = _two_sided(machine), {e.name for e in machine.foreign}
    names = (*(e.name for e in listed), *(form.name for form in added))
    return Picture(
        names,
        _projected(gram, np.array(sds) ** -2.0),
        raw,
        severities,
        np.array([name in two_sided for name in names]),
        np.array([name in foreign for name in names]),
    )


def background_sds(machine: Machine, ripple: float) -> list[float]:
    """sds of what ``Linear.nuisances`` has behind the parameters: the ambient's two phases, the ripple's features.

    Args:
        ripple: its size as a share.
    """
    # The ripple's rms is half its size, and that of all features together the ripple's.
    feature_sd = 0.5 * ripple / np.sqrt(FEATURES)
    return [_PHASE_SD] * (2 if machine.ambient else 0) + [feature_sd] * (2 * FEATURES if ripple else 0)


def _candidates(
    linear: Linear, listed: Sequence[Effect], there: Mapping[str, float], onset_s: float
) -> tuple[list[list[Array]], Array]:
    """Changes of all takes' readings by each candidate, (ny, N) each, and their severities (K,).

    What is really there comes at its true size by a run of its own, all others at a severity near the probed one.
    """
    yardstick, found, severities = linear.yardstick, {}, np.zeros(len(listed))
    changes = [change_of(yardstick, e, onset_s) for e in listed]
    sizes = np.array([change.start for change in changes])
    for i, e in enumerate(listed):
        if e.name in there:
            made = changes[i].of(there[e.name])
            found[i] = [(y - base).T for y, base in zip(made, yardstick.base, strict=True)]
            severities[i] = _severity(yardstick, e, found[i])
    open_ones = [i for i in range(len(listed)) if i not in found]
    for _ in range(_PROBES):
        for i, column in zip(open_ones, linear.changes([(listed[i], sizes[i]) for i in open_ones]), strict=True):
            found[i], severities[i] = column, _severity(yardstick, listed[i], column)
        wanted = sizes * np.clip(PROBED / np.maximum(severities, _TINY), 1.0 / _PROBE_FACTOR, _PROBE_FACTOR)
        wanted = np.minimum(wanted, [change.most for change in changes])
        off = (np.abs(severities / PROBED - 1.0) > _PROBED_WITHIN) & (wanted != sizes)
        open_ones = [i for i in open_ones if off[i] and not listed[i].is_stuck]
        sizes = wanted
    return [found[i] for i in range(len(listed))], severities


def _severity(yardstick: Yardstick, effect: Effect, column: Sequence[Array]) -> float:
    """Of a change of all takes' readings, (ny, N) each."""
    made = [base + change.T for base, change in zip(yardstick.base, column, strict=True)]
    held_out, in_training = yardstick.measure(made)
    return in_training if effect.is_stuck else min(held_out, in_training)


def _gram(machine: Machine, columns: Array) -> Array:
    """Inner products (K, K) of columns (K, ny, N), in sds of the noise's innovations."""
    total = np.zeros((len(columns),) * 2)
    for c, name in enumerate(machine.outputs):
        white = whitened(machine.noise[name], machine.lsb[name], machine.period_s, columns[:, c])
        total += white @ white.T
    return total


def _projected(gram: Array, precision: Array) -> Array:
    """A Gram matrix without its last columns, whose sizes have a normal prior: Schur's complement.

    Args:
        gram: (K + n, K + n).
        precision: (n,) of the prior, in the columns' units.
    """
    kept = len(gram) - len(precision)
    inner = gram[kept:, kept:] + np.diag(precision)
    scale = 1.0 / np.sqrt(np.diag(inner))
    inner = inner * np.outer(scale, scale) + _TINY * np.eye(len(scale))
    across = scale[:, None] * gram[kept:, :kept]
    left = gram[:kept, :kept] - across.T @ cho_solve(cho_factor(inner), across)
    return np.asarray(0.5 * (left + left.T))


def _two_sided(machine: Machine) -> frozenset[str]:
    """Names of the catalogue of a machine's twin whose size may have either sign."""
    catalogue = whole_catalogue(simulator_of(machine.simulator, machine.network))
    sized = [(m.name, m.parameters[0], m.off) for m in catalogue if m.parameters]
    return frozenset(name for name, size, off in sized if size.low < off < size.high)
