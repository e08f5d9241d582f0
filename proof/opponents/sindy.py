"""SINDy on what the calibrated simulator's equations leave: strong and weak form, plain and projected.

The residual of the measured derivative is regressed on the catalogue's terms (Kaheman et al. 2019, arXiv:1909.08574)
by sequentially thresholded least squares (Brunton, Proctor and Kutz 2016) from pysindy, the threshold found by leaving
out one recording at a time; of thresholds within one standard error of the best, the sparsest. Of each candidate's
trial shapes the one that follows the residual best is used. Faults of sensors are no terms of any equation: SINDy
cannot name them.

- Strong form: readings are smoothed and differentiated as in pysindy (Savitzky and Golay, 21 samples, third order).
  The equations' side goes through the same filter, which is more than is published, and helps.
- Weak form (Messenger and Bortz 2021): both sides are integrated against bumps (1 - s^2)^4, a tenth of a recording
  wide as is pysindy's default. Written out here: pysindy's own draws the bumps' places from NumPy's global random
  state, so that no run repeats another.
- Projected: what parameters and start states of the calibration can change is taken out of residual and terms; once
  terms are there, the parameters are calibrated anew.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from twinbench.data.recording import Recording
from twinbench.mismatch.mixture import Z90
from twinbench.mismatch.variants import typical
from twinbench.physics.simulator import Array, Mechanism, Simulator
from twinbench.proof.opponents.base import Progress, calibrated, check_folds, finding, quiet, told
from twinbench.proof.opponents.library import Path, paths

SMOOTHING_WINDOW, SMOOTHING_ORDER, EVERY = 21, 3, 3
BUMP, DEGREE = 0.1, 4
THRESHOLDS = (*np.logspace(-2.5, 0.5, 16), np.inf)
RIDGE = 1e-3
LEAST_BETTER = 0.005
"""And by so much, as a share of the error without any term, must a threshold be better for less sparsity."""
NAMED_SHARE = 0.5
"""Terms are named whose standardised coefficient is at least this share of the largest."""
_Operator = Callable[[Array], Array]


class System(NamedTuple):
    """One recording's regression, its balances one below the other.

    Attributes:
        y: (M,) dimensionless, what the calibrated equations miss, each balance over its typical error.
        X: (M, J) dimensionless, what the candidates add at their typical sizes, likewise.
        N: (M, K) dimensionless, the calibration's directions, likewise.
    """

    y: Array
    X: Array
    N: Array


def _diagnose(
    form: Callable[[Path], tuple[_Operator, _Operator]],
    projected: bool,
    simulator: Simulator,
    recordings: Sequence[Recording],
    hold_out: Sequence[Recording] = (),
    catalogue: Sequence[Mechanism] | None = None,
    progress: Progress = quiet,
) -> dict[str, Any]:
    """Arguments as for ``mismatch.diagnose``, after the first two.

    Raises:
        BadInput: as there, or one recording is all there is.
    """
    c = calibrated(simulator, recordings, hold_out, catalogue, progress)
    check_folds(c.found)
    listed, along = paths(c, smooth)
    if not along:
        return told(c.found, "No state is measured by itself: there is no derivative to explain.")
    systems = _scaled([_system(path, *form(path)) for path in along])
    if projected:
        systems = project(systems)
    best = _best_shapes(systems, [v.candidate for v in listed])
    chosen = select([s._replace(X=s.X[:, best]) for s in systems]) if best else {}
    if not chosen:
        return told(c.found, "No term lowers the error of the derivatives of recordings left out.")
    sizes, findings = {}, []
    largest = max(abs(weight) for _, weight, _ in chosen.values())
    for j, (size, weight, sd) in chosen.items():
        variant = listed[best[j]]
        candidate = c.candidates[variant.candidate]
        unit = typical(candidate)
        sizes[variant] = size * unit
        if abs(weight) >= NAMED_SHARE * largest:
            ends = sorted(candidate.null[0] + (size + side * Z90 * sd) * unit for side in (-1.0, 1.0))
            findings.append(finding(candidate.mechanism, candidate.null[0] + size * unit, *ends))
    names = ", ".join(f["mechanism"] for f in findings)
    says = f"Of {len(sizes)} terms that SINDy keeps, the largest: {names}."
    return told(c.found, says, findings, c.after(sizes, projected))


def smooth(x: Array) -> Array:
    """Savitzky and Golay's filter over time, (N, s).

    Args:
        x: (N, s) in the states' units.
    """
    return np.asarray(savgol_filter(x, SMOOTHING_WINDOW, SMOOTHING_ORDER, axis=0))


def strong(path: Path) -> tuple[_Operator, _Operator]:
    """What a measured state and what a derivative is put through: differentiated, and smoothed alike."""
    from pysindy import SmoothedFiniteDifference

    differentiate = SmoothedFiniteDifference(
        smoother_kws={"window_length": SMOOTHING_WINDOW, "polyorder": SMOOTHING_ORDER}
    )
    inside = slice(SMOOTHING_WINDOW, -SMOOTHING_WINDOW, EVERY)

    def derivative(x: Array) -> Array:
        flat = x.reshape(len(x), -1)
        return np.asarray(differentiate(flat, path.time_s)).reshape(x.shape)[inside]

    return derivative, lambda rate: smooth(rate)[inside]


def weak(path: Path) -> tuple[_Operator, _Operator]:
    """Integrals of a measured state's derivative, by parts, and of a derivative, against bumps that overlap."""
    half = int(0.5 * BUMP * len(path.time_s))
    s = np.linspace(-1.0, 1.0, 2 * half + 1)
    bump = (1.0 - s**2) ** DEGREE
    dt_s = float(np.median(np.diff(path.time_s)))
    slope = -2.0 * DEGREE * s * (1.0 - s**2) ** (DEGREE - 1) / (half * dt_s)
    every = max(1, half // 4)

    def against(weight: Array, x: Array) -> Array:
        return np.lib.stride_tricks.sliding_window_view(x, len(s), axis=0)[::every] @ weight * dt_s

    return partial(against, -slope), partial(against, bump)


def _system(path: Path, of_state: _Operator, of_rate: _Operator) -> System:
    error = of_state(path.x) - of_rate(path.rate)
    return System(error, of_rate(path.terms), of_state(path.moved_x) - of_rate(path.moved_rate))


def _scaled(systems: Sequence[System]) -> list[System]:
    """Balances in units of their own typical error, all in one column."""
    scale = 1.4826 * np.median(np.abs(np.concatenate([s.y for s in systems])), axis=0)
    return [
        System((s.y / scale).ravel(), *((a / scale[:, None]).reshape(s.y.size, -1) for a in (s.X, s.N)))
        for s in systems
    ]


def project(systems: Sequence[System]) -> list[System]:
    """The systems with the calibration's directions taken out of y and X."""
    N = np.concatenate([s.N for s in systems])
    norm = np.sqrt(np.mean(N**2, axis=0))
    U, w, _ = np.linalg.svd(N[:, norm > 0.0] / norm[norm > 0.0], full_matrices=False)
    Q = U[:, w > 1e-6 * w[0]]
    y, X = (np.concatenate([s[k] for s in systems]) for k in (0, 1))
    ends = np.cumsum([len(s.y) for s in systems])[:-1]
    y, X = y - Q @ (Q.T @ y), X - Q @ (Q.T @ X)
    parts = zip(np.split(y, ends), np.split(X, ends), systems, strict=True)
    return [s._replace(y=y_r, X=X_r) for y_r, X_r, s in parts]


def _best_shapes(systems: Sequence[System], owner: Sequence[int]) -> list[int]:
    """Of each candidate's columns the one that follows y best; none of what moves nothing or repeats another."""
    y, X = (np.concatenate([s[k] for s in systems]) for k in (0, 1))
    norm = np.sqrt(np.sum(X**2, axis=0))
    moves = norm > 1e-6 * np.median(norm[norm > 0.0]) if norm.any() else norm > 0.0
    unit = X / np.where(moves, norm, 1.0)
    follows = np.where(moves, np.abs(unit.T @ y), -1.0)
    found: list[int] = []
    for candidate in dict.fromkeys(owner):
        best = max((j for j, o in enumerate(owner) if o == candidate), key=lambda j: follows[j])
        if moves[best] and not (np.abs(unit[:, found].T @ unit[:, best]) > 0.999).any():
            found.append(best)
    return found


def select(systems: Sequence[System]) -> dict[int, tuple[float, float, float]]:
    """Columns that sequentially thresholded least squares keeps: coefficient, standardised, its standard deviation.

    The standard deviation is the jackknife's over recordings.
    """
    rms = np.sqrt(np.mean(np.concatenate([s.X for s in systems]) ** 2, axis=0))
    # A triangle is as good as all rows, and a thousand times smaller.
    folds = [(_triangle(s.X / rms, s.y), len(s.y)) for s in systems]
    without = [_joined([f for k, f in enumerate(folds) if k != r]) for r in range(len(folds))]
    errors = np.zeros((len(THRESHOLDS), len(folds)))
    for r, (held, n) in enumerate(folds):
        for k, threshold in enumerate(THRESHOLDS):
            errors[k, r] = _square(held, _stlsq(without[r], threshold)) / n
    errors /= errors[-1]
    score = errors.mean(axis=1)
    best = int(np.argmin(score))
    spread = float(errors[best].std(ddof=1)) / np.sqrt(len(folds))
    threshold = max(t for t, s in zip(THRESHOLDS, score, strict=True) if s <= score[best] + max(spread, LEAST_BETTER))
    weights = _stlsq(_joined(folds), threshold)
    kept = np.flatnonzero(weights)
    jackknife = np.array([np.linalg.lstsq(R[:, kept], R[:, -1], rcond=None)[0] for R in without])
    sd = np.sqrt((len(folds) - 1) / len(folds) * np.sum((jackknife - jackknife.mean(axis=0)) ** 2, axis=0))
    return {
        int(j): (float(weights[j] / rms[j]), float(weights[j]), float(s / rms[j]))
        for j, s in zip(kept, sd, strict=True)
    }


def _triangle(X: Array, y: Array) -> Array:
    return np.asarray(np.linalg.qr(np.column_stack((X, y)), mode="r"))


def _joined(folds: Sequence[tuple[Array, int]]) -> Array:
    """One triangle [X y] of several recordings, for mean squares."""
    R = np.linalg.qr(np.concatenate([R for R, _ in folds]), mode="r")
    return np.asarray(R / np.sqrt(sum(n for _, n in folds)))


def _square(R: Array, weights: Array) -> float:
    return float(np.sum((R[:, -1] - R[:, :-1] @ weights) ** 2))


def _stlsq(R: Array, threshold: float) -> Array:
    from pysindy import STLSQ

    if not np.isfinite(threshold):
        return np.zeros(R.shape[1] - 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that nothing is left is an answer
        return np.asarray(STLSQ(threshold=threshold, alpha=RIDGE).fit(R[:, :-1], R[:, -1]).coef_)[0]


sindy = partial(_diagnose, strong, False)
sindy_projected = partial(_diagnose, strong, True)
weak_sindy = partial(_diagnose, weak, False)
weak_sindy_projected = partial(_diagnose, weak, True)
