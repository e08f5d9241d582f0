"""What a report keeps of earlier ones where the store no longer holds the estimates that it was made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from twinbench.bench.report.claims import Claim
from twinbench.bench.report.evidence import Evidence
from twinbench.bench.roster import PROPOSED, REFERENCE, TRUE_START, label
from twinbench.bench.statistics.regimes import REGIMES
from twinbench.bench.statistics.summary import Summary


def lacking(summary: Summary, evidence: Evidence) -> list[str]:
    """The estimators that did not fail and whose estimates are not in the store."""
    return [e for e in summary.estimators if e not in (*evidence.errors, *summary.failures, TRUE_START)]


def lacks(gone: Sequence[str]) -> str:
    """Why what is drawn from estimates stays as it was."""
    return f"the store lacks the estimates of {', '.join(map(label, gone))}"


def with_earlier_regimes(
    coverage: pd.DataFrame, tables: Path, gone: list[str], known: Mapping[str, str] = REGIMES
) -> pd.DataFrame:
    """What ``coverage_table`` returned, with the rows that an earlier report has of those who are gone.

    Args:
        known: by name the machine's regimes.
    """
    path = tables / "regimes.csv"
    if not gone or not path.is_file():
        return coverage
    earlier = pd.read_csv(path, keep_default_na=False, na_values=[""], converters={"reason": str})
    if "estimator" not in earlier:
        return coverage
    # Regimes that are told apart otherwise today have no place in today's table.
    kept = earlier[earlier["estimator"].isin(gone) & earlier["regime"].isin(list(known))]
    return pd.concat([table for table in (coverage, kept) if len(table)], ignore_index=True) if len(kept) else coverage


def with_earlier_claims(found: list[Claim], tables: Path, gone: list[str]) -> list[Claim]:
    """The claims, with an earlier report's numbers of the proposed method and of the oracle where these are gone."""
    path = tables / "claims.csv"
    columns = [column for name, column in ((PROPOSED, "ours"), (REFERENCE, "reference")) if name in gone]
    if not columns or not path.is_file():
        return found
    earlier = pd.read_csv(path).drop_duplicates("says").set_index("says")
    filled = []
    for claim in found:
        known = {c: earlier[c].get(claim.says) for c in columns if c in earlier and pd.isna(getattr(claim, c))}
        numbers = {c: float(v) for c, v in known.items() if v is not None}
        ours, reference = numbers.get("ours", claim.ours), numbers.get("reference", claim.reference)
        filled.append(claim._replace(ours=ours, reference=reference))
    return filled
