"""Tables, figures and the report of a run, from what it left in its folder. May be run again at any time."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from twinbench.bench.report import kept
from twinbench.bench.report.claims import claims, claims_table
from twinbench.bench.report.evidence import Evidence, add_scenes, gather
from twinbench.bench.report.figures import FROM_ESTIMATES, draw
from twinbench.bench.report.health_tables import single_table
from twinbench.bench.report.other import write_other
from twinbench.bench.report.paired import ablation_table, parts_are_worth, rivals_table, without_steps
from twinbench.bench.report.paper import COMPARED, paper_says, parts_say
from twinbench.bench.report.provenance import bullets, profile_of, write_page, write_tables
from twinbench.bench.report.robustness_says import faults_say
from twinbench.bench.report.robustness_tables import robustness_tables
from twinbench.bench.report.table_formats import Table
from twinbench.bench.report.tables import build_tables
from twinbench.bench.report.verdicts import verdicts
from twinbench.bench.report.words import answer, certainty, headline
from twinbench.bench.results import Results, load_results
from twinbench.bench.roster import PROPOSED, is_ablation
from twinbench.bench.statistics.strata import of_stratum
from twinbench.bench.statistics.subject import PAPERS
from twinbench.bench.statistics.summary import Summary, summarise
from twinbench.common.page import write_bytes, write_figures


def write_report(out: Path) -> Table:
    """Write ``tables/``, ``figures/``, ``report.html``, ``answer.md`` and ``paper_says.md`` from ``scores.csv`` and
    its neighbours; ``parts_say.md``, ``steps_say.md``, ``worth_say.md`` and ``faults_say.md``, too, where parts were
    left out and faults tried.

    Returns:
        The comparison of the estimators, for a terminal.

    Raises:
        BadInput: the folder holds no run, or cannot be written to.
    """
    results = load_results(out)
    if results.subject.machine != PAPERS.machine:
        return write_other(results)
    whole = ~results.scores["estimator"].map(is_ablation)
    failures = {name: why for name, why in results.failures.items() if not is_ablation(name)}
    summary = summarise(results.scores[whole], failures)
    evidence = _evidence(results)
    gone = kept.lacking(summary, evidence)
    evidence.coverage = kept.with_earlier_regimes(evidence.coverage, out / "tables", gone)
    tables = build_tables(summary, evidence.coverage, results.latency, results.cost, profile_of(results))
    worn = of_stratum(results.scores, "worn")
    if PROPOSED in worn["estimator"].unique():
        tables.insert(1, rivals_table(worn, results.failures))
    if not whole.all():
        tables.append(ablation_table(worn, results.failures))
    scores, single = _of_the_paper(results, failures)
    if results.manifest.get("scenes"):
        own = (single, scores) if single else (summary, worn)
        found = claims(own[0], evidence, own[1], results.robustness, results.latency)
        tables.append(claims_table(kept.with_earlier_claims(found, out / "tables", gone), single is not None))
    tables.append(single_table(single))
    tables += robustness_tables(results.robustness)
    said = (*answer(summary), *verdicts(summary, evidence.coverage))
    compared = scores[scores["estimator"].isin(COMPARED)]
    of_paper = paper_says(single if compared.empty else summarise(compared, failures, "single"))
    of_parts = parts_say(scores, results.failures, results.robustness)
    write_bytes(out / "answer.md", bullets(f"**{headline(summary)}.**", *said).encode())
    write_bytes(out / "paper_says.md", bullets(*of_paper).encode())
    of_faults = faults_say(results.robustness)
    of_steps = without_steps(worn, results.failures)
    of_worth = parts_are_worth(worn, results.failures)
    others = {"parts_say.md": of_parts, "faults_say.md": of_faults, "steps_say.md": of_steps, "worth_say.md": of_worth}
    for name, texts in others.items():
        if texts:
            write_bytes(out / name, bullets(*texts).encode())
    write_tables(out, tables)
    earlier = dict.fromkeys(FROM_ESTIMATES, kept.lacks(gone)) if gone else {}
    figures = write_figures(out / "figures", draw(summary, evidence, results.latency, results.robustness), earlier)
    says = headline(summary), [*said, *of_paper, *of_parts, *of_faults, *of_steps, *of_worth], certainty(summary)
    write_page(results, says, summary.notes, tables, figures)
    return tables[0]


def _of_the_paper(results: Results, failures: dict[str, str]) -> tuple[pd.DataFrame, Summary | None]:
    """Scores and statistics of the recordings of the paper's kind; None where a run has none of them."""
    scores = of_stratum(results.scores, "single")
    if scores.empty:
        return scores, None
    return scores, summarise(scores[~scores["estimator"].map(is_ablation)], failures, "single")


def _evidence(results: Results) -> Evidence:
    truth = results.truth()
    evidence = Evidence() if truth is None else gather(results.estimates(), truth, results.failures)
    add_scenes(evidence, results.scenes())
    return evidence
