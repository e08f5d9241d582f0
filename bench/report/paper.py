"""What the paper claims of its comparison and its parts, and whether it holds on recordings of the paper's own kind."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import pandas as pd

from twinbench.bench.report.table_formats import number, span
from twinbench.bench.report.words import names_of
from twinbench.bench.roster import ABLATION, PROPOSED, QUANTITIES, label
from twinbench.bench.statistics.bootstrap import differences, sequence_scores
from twinbench.bench.statistics.scores import STATE_ERRORS
from twinbench.bench.statistics.summary import PARAMETERS, Summary
from twinbench.data.disturb import CONDITIONS

STRONGEST = "gru_kf"
"""The baseline that the paper finds strongest."""
OTHERS = ("nominal_ekf", "gru_kf", "lstm_rls", "deeponet", "pinn_ukf")
"""The five baselines of the paper."""
COMPARED = (PROPOSED, *OTHERS)
"""Whom the paper compares. Its claims are tested among these: each pair more would ask more of all of them."""
ERRORS = {**dict(zip(STATE_ERRORS, ("pressure", "temperature", "flow"), strict=True)), PARAMETERS: "parameter"}
REPORTED = dict(zip(ERRORS, (0.72, 0.88, 1.05, 2.6), strict=True))
"""What the paper reports of the proposed method, in %."""
REPORTED_COVERAGE_PCT = 94.1
"""The share of measured states within their 95 % intervals."""
MEASURED = {f"coverage_{s}_pct": QUANTITIES[s][0] for s in ("p_exh_bar", "T_gas_K", "flow_memory")}
"""Coverage of the states behind the three outputs, before calibration, and what the states are called."""
PARTS = (
    ("no_covariance_adaptation", "covariance adaptation", PARAMETERS, 1.7),
    ("no_feasibility", "the feasibility penalty", "p_nrmse_pct", 0.24),
    ("no_trust", "the trust coefficient", "p_nrmse_pct", 0.0),
    ("finite_differences", "written derivatives (finite differences instead)", PARAMETERS, math.nan),
    ("update_10_hz", "updates at 20 Hz (10 Hz instead)", "p_nrmse_pct", 0.06),
)
"""Ablation, what it leaves out, the error that the paper gives, and by how many percentage points that grows there."""

NONE = "This run has no recordings of the paper's kind, so it does not tell whether the paper's claims hold."
CHANGE = ["difference", "low", "high"]


def paper_says(single: Summary | None) -> list[str]:
    """What the paper says of its comparison, a paragraph per claim.

    Args:
        single: of COMPARED on the recordings with a healthy start and one change; None where the run has none.
    """
    return [NONE] if single is None else [*_against_the_strongest(single), *_strongest(single), *_numbers(single)]


def parts_say(scores: pd.DataFrame, failures: Mapping[str, str], robustness: pd.DataFrame) -> list[str]:
    """What the paper says of its method's parts, a paragraph per claim; nothing where the run does not tell.

    Args:
        scores: columns ``estimator, seed, sequence, metric, value`` of the recordings with a healthy start and one
            change, ablations among them.
        failures: per estimator with failed cells, which and why.
        robustness: ``robustness.csv``; may be empty.
    """
    return [*_parts(scores, failures), *_trust(robustness)]


def _against_the_strongest(single: Summary) -> Iterator[str]:
    known = [m for m in ERRORS if _known(single, PROPOSED, m) and _known(single, STRONGEST, m)]
    if not known:
        return
    says = f"The paper: {label(PROPOSED)} errs less than {label(STRONGEST)} in all four errors."
    ours = [ERRORS[m] for m in known if single.better(PROPOSED, STRONGEST, m)]
    theirs = [ERRORS[m] for m in known if single.better(STRONGEST, PROPOSED, m)]
    open_ = [ERRORS[m] for m in known if ERRORS[m] not in (*ours, *theirs)]
    here = [f"it holds in {names_of(ours)}"] if ours else []
    here += [f"the opposite holds in {names_of(theirs)}"] if theirs else []
    here += [f"the tests do not decide in {names_of(open_)}"] if open_ else []
    yield f"{says} Here {'; '.join(here)} (Wilcoxon, Holm over the paper's six)."


def _strongest(single: Summary) -> Iterator[str]:
    parts: dict[str, list[str]] = {}
    for metric, name in ERRORS.items():
        known = [e for e in OTHERS if _known(single, e, metric)]
        if len(known) < 2:
            return
        least = min(known, key=lambda e: single.value(e, metric).mean)
        told = "" if least == STRONGEST or single.better(least, STRONGEST, metric) else " (not told apart from it)"
        parts.setdefault(label(least), []).append(f"{name}{told}")
    says = f"The paper: {label(STRONGEST)} is the strongest of its five baselines."
    least_in = [f"{who} has the least mean error of the five in {names_of(where)}" for who, where in parts.items()]
    yield f"{says} Here {'; '.join(least_in)}."


def _numbers(single: Summary) -> Iterator[str]:
    for metric, paper in REPORTED.items():
        yield from _number(single, metric, f"{ERRORS[metric]} error", paper)
    for metric, name in MEASURED.items():
        measured = f"coverage of measured states' 95 % intervals, {name},"
        yield from _number(single, metric, measured, REPORTED_COVERAGE_PCT)


def _number(single: Summary, metric: str, name: str, paper: float) -> Iterator[str]:
    value = single.value(PROPOSED, metric)
    if not math.isfinite(value.low):
        return
    beside = "lies above" if value.low > paper else "lies below" if value.high < paper else "holds"
    here = f"{number(value.mean)} % ({span(value.low, value.high, to=True)})"
    yield f"The paper: {name} {number(paper)} %. Here it is {here}: the interval {beside} the paper's number."


def _parts(scores: pd.DataFrame, failures: Mapping[str, str]) -> Iterator[str]:
    present = set(scores["estimator"])
    for name, part, metric, paper in PARTS:
        if {PROPOSED, f"{PROPOSED}{ABLATION}{name}"} <= present:
            rows = differences(sequence_scores(scores, metric, failures), PROPOSED).set_index("estimator")
            worth, low, high = rows.loc[[f"{PROPOSED}{ABLATION}{name}"], CHANGE].to_numpy(dtype=float)[0]
            yield f"{_paper_on(part, metric, paper)} {_change(worth, low, high)}"


def _paper_on(part: str, metric: str, paper: float) -> str:
    error = f"the {ERRORS[metric]} error"
    if math.isnan(paper):
        return f"Without {part}, {error}:"
    if paper == 0.0:
        return f"The paper: without {part}, little changes inside the envelope. Here {error}:"
    return f"The paper: without {part}, {error} grows by {number(paper)} percentage points. Here:"


def _change(worth: float, low: float, high: float) -> str:
    says = "it grows" if low > 0.0 else "it falls" if high < 0.0 else "no difference is found"
    return f"{says}, {number(worth, 2)} percentage points ({span(low, high, to=True)})."


def _trust(robustness: pd.DataFrame) -> Iterator[str]:
    """What the trust coefficient does at the loads that lie farthest out."""
    farthest = max((c for c in CONDITIONS if c.group == "envelope"), key=lambda c: c.beyond)
    without = f"{PROPOSED}{ABLATION}no_trust"
    chosen = robustness[robustness["condition"] == farthest.name]
    if not {PROPOSED, without} <= set(chosen["estimator"]):
        return
    parts = []
    for metric in STATE_ERRORS:
        rows = differences(sequence_scores(chosen, metric), PROPOSED).set_index("estimator")
        worth, low, high = rows.loc[[without], CHANGE].to_numpy(dtype=float)[0]
        parts.append(f"{ERRORS[metric]}: {_change(worth, low, high).removesuffix('.')}")
    yield (
        f"The paper: without the trust coefficient the worst error beyond the envelope grows from 3.4 to 7.9 %. Here, "
        f"at {farthest.name.removeprefix('loads ')} the envelope, {'; '.join(parts)}."
    )


def _known(summary: Summary, estimator: str, metric: str) -> bool:
    return math.isfinite(summary.value(estimator, metric).mean)
