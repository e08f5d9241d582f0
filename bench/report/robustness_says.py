"""What sensor faults do to the proposed method's health, in sentences that the table's intervals hold."""

from __future__ import annotations

from collections.abc import Iterable

import pandas as pd

from twinbench.bench.report.robustness_tables import mean_by_kind
from twinbench.bench.report.table_formats import number, span
from twinbench.bench.report.words import names_of
from twinbench.bench.roster import PROPOSED, TRIVIAL, label
from twinbench.bench.statistics.bootstrap import differences, ratios, sequence_scores
from twinbench.bench.statistics.subject import PAPERS, Subject
from twinbench.data.disturb import UNDISTURBED

AFTER = "health_after_fault_pct"


def faults_say(scores: pd.DataFrame, subject: Subject = PAPERS) -> list[str]:
    """After which kinds of fault the error grows, and where it stays below that of a row that costs nothing.

    Args:
        scores: ``robustness.csv``.
        subject: what the run was about.

    Returns:
        A paragraph per string; nothing where the run does not tell.
    """
    of_faults = (scores["metric"] == AFTER) & (scores["group"] == "fault")
    chosen = mean_by_kind(scores[of_faults], subject)
    own = chosen[chosen["estimator"] == PROPOSED]
    # Conditions take the place of estimators: what is paired are the recordings.
    by_kind = own.assign(estimator=own["condition"])
    if not {UNDISTURBED.name} < set(by_kind["estimator"]):
        return []
    times = ratios(sequence_scores(by_kind, AFTER), UNDISTURBED.name).set_index("estimator")
    grown, kept = times[times["low"] > 1.0], times[times["low"] <= 1.0]
    multiples = [
        f"{kind} {number(r['ratio'], 2)} times ({span(r['low'], r['high'], to=True)})" for kind, r in grown.iterrows()
    ]
    said = [
        f"From a minute after the longest fault on, the health error of {label(PROPOSED)} is larger than without a "
        f"fault: {names_of(multiples)}."
    ]
    said += [f"It is not shown to be larger after {names_of(kept.index)}."] if len(kept) else []
    paragraphs = [" ".join(said if len(grown) else said[1:])]
    return [*paragraphs, *_against_nothing(chosen, times.index)]


def _against_nothing(chosen: pd.DataFrame, kinds: Iterable[str]) -> list[str]:
    """Where the proposed method errs less than the best row that costs nothing, by the paired interval."""
    free = chosen[chosen["estimator"].isin(TRIVIAL)]
    if free.empty:
        return []
    against = str(free.groupby("estimator")["value"].mean().idxmin())
    less, rest = [], []
    for kind in kinds:
        scores = sequence_scores(chosen[chosen["condition"] == kind], AFTER)
        found = differences(scores, against).set_index("estimator").loc[PROPOSED, ["difference", "low", "high"]]
        worth, low, high = map(float, found)
        if high < 0.0:
            less.append(kind)
        else:
            says = "it errs more" if low > 0.0 else "no difference is found"
            rest.append(f"After {kind} {says}: {number(worth)} % of a life ({span(low, high, to=True)}).")
    first = [f"By the paired 95 % interval it errs less than {label(against)} after {names_of(less)}."] if less else []
    return [" ".join([*first, *rest])]
