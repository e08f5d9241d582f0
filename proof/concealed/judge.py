"""Open the seal and score a verdict: one row of ``cases.csv``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinbench.proof.concealed.outcome import UNKNOWN, outcome
from twinbench.proof.concealed.seal import Sealed, check

COLUMNS = (
    "case", "seed", "machine", "kind", "cell", "severity", "background_pct", "truth", "class", "D0_sq", "Dk_sq",
    "detectable", "verdict", "named", "set", "probability", "outcome", "ports", "gain", "size_error_pct",
    "size_covered", "parameters_covered", "engine", "seconds", "onset_error_s", "port_truth", "ideal_name",
    "ideal_class", "inexact", "noisy_input", "left_sq", "decoys_named",
)  # fmt: skip
"""In ``truth``, ``class`` and ``port_truth`` effects are joined by ``+``, what is the same for one of them by ``|``.
``named`` holds single names, ``set`` the sets that the verdict cannot separate: names by ``|``, sets by ``+``.
``noisy_input`` is the input that is recorded with noise, if one is.
``inexact`` holds where the equations are said to be inexact, joined by ``|``: a place, if no finding is one.
``left_sq`` is the squared distance, in sds of the noise, that the catalogue leaves of the effect: its own form of the
name or, where the catalogue lacks the name, the nearest stand-in. Of two effects it is the larger.
``seconds`` are of one core's time.
``decoys_named`` is the share of the effects which are certainly not there that would have been named.
``probability`` holds what the verdict states for each of them, in their order: single names, then sets."""
PORTS = 2
"""So many ports a location may hold."""
_NO_EXCESS = 2e-4
"""Below this share of the noise's mean square there is no error that a mended model could remove."""


@dataclass(frozen=True)
class Claim:
    """What one finding says is there: one name, a set, or something unnamed; and where."""

    names: tuple[str, ...]
    ports: tuple[str, ...]
    finding: Mapping[str, Any]

    @property
    def single(self) -> bool:
        return len(self.names) == 1


def score(
    sealed: Sealed, published: str, verdict: Mapping[str, Any], engine: str = "twinbench", seed: int = 0
) -> dict[str, Any]:
    """Score a verdict (``verdict.json``) against the sealed truth.

    Args:
        published: the digest that was published before the engine ran.
        seed: of the suite.

    Raises:
        BrokenSeal: the truth is not the one that was sealed.
    """
    truth = check(sealed, published)
    effects, found = truth["effects"], claims(verdict)
    single, several = [c for c in found if c.single], [c for c in found if len(c.names) > 1]
    error, covered = _size(effects, single)
    row = {
        "case": truth["case"],
        "seed": seed,
        **{key: truth[key] for key in ("machine", "kind", "cell", "severity", "background_pct")},
        "noisy_input": "+".join(truth["noisy_input"]),
        "truth": "+".join(e["name"] for e in effects),
        "class": "+".join("|".join(e["class"]) for e in effects),
        **{key: _known(truth[key]) for key in ("D0_sq", "Dk_sq", "detectable", "ideal_name", "ideal_class")},
        "verdict": verdict.get("verdict", ""),
        "named": "+".join(c.names[0] for c in single),
        "set": "+".join("|".join(c.names) for c in several),
        "probability": "+".join(_stated(c) for c in (*single, *several)),
        "outcome": outcome(truth, [c.names for c in found], [c.ports for c in found] or [inexact_at(verdict)]),
        "left_sq": max((e["stand_in_sq" if truth["cell"] in UNKNOWN else "form_sq"] for e in effects), default=np.nan),
        "port_truth": "+".join("|".join(e["ports"]) for e in effects),
        "ports": "+".join("|".join(c.ports) for c in found),
        "inexact": "|".join(inexact_at(verdict)),
        "onset_error_s": onset_error(truth["onset_s"], found, effects),
        "size_error_pct": error,
        "size_covered": covered,
        "parameters_covered": parameters_covered(truth, verdict),
        "gain": gain(verdict, truth["held_out_floor"]) if found else np.nan,
        "decoys_named": decoys_named(verdict),
        "engine": engine,
        "seconds": float(verdict.get("seconds", np.nan)),
    }
    return {column: row[column] for column in COLUMNS}


def claims(verdict: Mapping[str, Any]) -> list[Claim]:
    """What a verdict's findings say; a change of a parameter is no claim of something left out."""
    found = []
    for finding in verdict.get("findings", ()):
        kind, port = str(finding.get("kind") or ""), str(finding.get("port") or "")
        if "parameter" in kind or port.startswith("parameter") or kind == "consistent":
            continue
        name = finding.get("mechanism")
        names = tuple(dict.fromkeys([*([name] if name else []), *(finding.get("indistinguishable_from") or ())]))
        ranked = sorted(finding.get("ports") or (), key=lambda p: -float(p.get("probability") or 0.0))
        ports = list(dict.fromkeys([*([port] if port else []), *(p["port"] for p in ranked)]))
        found.append(Claim(names, tuple(ports[:PORTS]), finding))
    return found


def inexact_at(verdict: Mapping[str, Any]) -> tuple[str, ...]:
    """Where a verdict says that the equations are inexact: a place, where no finding is one."""
    return tuple(str(one["port"]) for one in verdict.get("inexact", ()))


def decoys_named(verdict: Mapping[str, Any]) -> float:
    """Share of a verdict's decoys that would have been named; NaN if it tried none."""
    check = verdict.get("self_check") or {}
    return float(check["decoys_named"]) / float(check["decoys"]) if check.get("decoys") else float("nan")


def parameters_covered(truth: Mapping[str, Any], verdict: Mapping[str, Any]) -> float:
    """Share of the twin's calibrated parameters whose 90 % interval holds the true value; NaN if none is told."""
    told = verdict.get("parameters") or {}
    true = truth["parameters"]
    known = [(true[name], told[name]) for name in truth["calibrated"] if name in told]
    return float(np.mean([float(v["low"]) <= t <= float(v["high"]) for t, v in known])) if known else float("nan")


def gain(verdict: Mapping[str, Any], floor: Mapping[str, float]) -> float:
    """Share of the removable held-out error that the mended model removed, all channels in units of their noise.

    (before^2 - after^2) / (before^2 - floor^2), each summed over channels after division by floor^2;
    ``floor`` is the rms of reading less truth. NaN where there was nothing to remove, or no fit is told.
    """
    fit = {f["channel"]: f for f in verdict.get("fit", ()) if f.get("held_out")}
    channels = [c for c in floor if c in fit]
    before, after = (
        np.array([float(fit[c][key]) / floor[c] for c in channels]) ** 2 for key in ("rmse_before", "rmse_after")
    )
    removable = float(np.sum(before - 1.0))
    if not channels or not removable > _NO_EXCESS * len(channels):
        return float("nan")
    return float(np.sum(before - after)) / removable


def size_error(effect: Mapping[str, Any], claim: Claim) -> tuple[float, float]:
    """Error of the effect's size in per cent of the effect, and 1 or 0: does the interval cover it? NaN if unknown."""
    fitted = claim.finding.get("parameters") or {}
    for name, (true, absent) in effect["sizes"].items():
        if name in fitted:
            value, low, high = (float(fitted[name][key]) for key in ("value", "low", "high"))
            return 100.0 * abs(value - true) / abs(true - absent), float(low <= true <= high)
    return float("nan"), float("nan")


def onset_error(onset_s: float | None, found: Sequence[Claim], effects: Iterable[Mapping[str, Any]]) -> float:
    """Seconds between the onset and what a finding gives, on the recordings' clock; the right finding's if any."""
    if onset_s is None:
        return float("nan")
    right = {name for e in effects for name in e["class"]}
    dated = [c for c in found if c.finding.get("since_s") is not None]
    ours = [c for c in dated if right & set(c.names)] or dated
    return min((abs(float(c.finding["since_s"]) - onset_s) for c in ours), default=float("nan"))


def _size(effects: Sequence[Mapping[str, Any]], single: Sequence[Claim]) -> tuple[float, float]:
    """``size_error`` of the only effect where it is named; NaN elsewhere."""
    matched = [(e, c) for e in effects for c in single if c.names[0] == e["name"]]
    return size_error(*matched[0]) if len(effects) == 1 and matched else (float("nan"), float("nan"))


def _stated(claim: Claim) -> str:
    stated = claim.finding.get("probability")
    return "" if stated is None else f"{float(stated):.4g}"


def _known(value: Any) -> Any:
    return float("nan") if value is None else value
