"""The flagship's gates: what must be reached over all draws, and what was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from twinbench.bench.statistics.bootstrap import interval, resample_weights
from twinbench.proof.concealed.gates import gate_line, quantile, rate
from twinbench.proof.flagship.judge import ABSTAINS, COLUMNS, METRICS, MODELS

WHOLE = ("plain", "enriched")
"""Cells in which the catalogue holds every effect and nothing else is unknown. All engines are asked about these."""
TEXTS = (
    "case", "cell", "engine", "truth", "without", "verdict", "named_right", "named_wrong", "sets", "sets_right",
    "missed", "amplitude_error_pct", "amplitude_covered",
)  # fmt: skip


def read_draws(path: Path) -> pd.DataFrame:
    """``draws.csv``, empty texts as such."""
    numbers = {c: [""] for c in COLUMNS if c not in TEXTS}
    return pd.read_csv(path, dtype=dict.fromkeys(TEXTS, str), keep_default_na=False, na_values=numbers)


def gate_table(rows: pd.DataFrame) -> pd.DataFrame:
    """Gate, required, measured, low, high, cases, met. Means over plants come with bootstrap 95 % intervals.

    Shares count as 1 at most, since a random-walk oracle is no hard floor, and as 0 where the engine or
    the filter with its model failed.
    """
    whole, loose = rows[rows["cell"].isin(WHOLE)], rows[rows["cell"] == "loose"]
    table, also = [], []
    for says, column, mean, worst in (
        ("parameter error", "parameter_share", 0.80, 0.50),
        ("60 s open loop", "open60_share", 0.95, 0.80),
    ):
        capped = _capped(whole[column])
        table += [_mean(f"gap closed, {says}, mean", mean, capped), _worst(f"gap closed, {says}, worst", worst, capped)]
        also.append(_mean(f"loose constants: gap closed, {says}, mean", np.nan, _capped(loose[column])))
    right, wrong = _several(whole["named_right"]), _several(whole["named_wrong"])
    effects, missed = _several(whole["truth"]), _several(whole["missed"])
    nominal, left_out = rows[rows["cell"] == "nominal"], rows[rows["cell"] == "left_out"]
    loosely_right, loosely_wrong = _several(loose["named_right"]), _several(loose["named_wrong"])
    sizes, covered = (
        pd.Series(_several(whole[c]), dtype=object).astype(float) for c in ("amplitude_error_pct", "amplitude_covered")
    )
    said = left_out["verdict"].isin(ABSTAINS)
    return pd.DataFrame(
        [
            *table,
            rate("wrong single names, of all", "<=", 0.03, _hits(len(wrong), len(right) + len(wrong))),
            rate(
                "effects named alone or in a set of at most three",
                ">=",
                0.90,
                _hits(len(effects) - len(missed), len(effects)),
            ),
            rate("effects named alone", "", np.nan, _hits(len(right), len(effects))),
            rate("nominal model's own recordings: single names", "<=", 0.0, nominal["named_wrong"] != ""),
            rate("nominal model's own recordings: sets", "", np.nan, nominal["sets"] != ""),
            rate("effects taken out of the catalogue: says incomplete", ">=", 0.90, said),
            rate("nothing taken out: says incomplete", "<=", 0.10, whole["verdict"].isin(ABSTAINS)),
            rate(
                "effects taken out, complete it says: a wrong single name",
                "",
                np.nan,
                left_out.loc[~said, "named_wrong"] != "",
            ),
            quantile("error of the amplitude of single names, median, %", "", np.nan, sizes),
            rate("90 % interval covers the amplitude", "", np.nan, covered > 0.5),
            *also,
            rate(
                "loose constants: wrong single names, of all",
                "",
                np.nan,
                _hits(len(loosely_wrong), len(loosely_right) + len(loosely_wrong)),
            ),
            quantile("seconds that the engine takes, median", "<=", 300.0, rows["seconds"]),
        ]
    )


def _several(texts: pd.Series) -> list[str]:
    return [part for text in texts for part in str(text).split("+") if part]


def _capped(shares: pd.Series) -> np.ndarray:
    return np.asarray(shares.fillna(0.0).clip(upper=1.0))


def _hits(hits: int, of: int) -> pd.Series:
    return pd.Series([True] * hits + [False] * (of - hits), dtype=object)


def _mean(gate: str, required: float, values: np.ndarray) -> dict[str, object]:
    n = len(values)
    low, high = interval(resample_weights(n) @ values, n) if n else (np.nan, np.nan)
    return gate_line(
        gate, ">=" if np.isfinite(required) else "", required, float(values.mean()) if n else np.nan, low, high, n
    )


def _worst(gate: str, required: float, values: np.ndarray) -> dict[str, object]:
    return gate_line(gate, ">=", required, float(values.min(initial=np.inf)), np.nan, np.nan, len(values))


def draws_table(rows: pd.DataFrame) -> str:
    """Every case to read: what was said, and the errors of oracle / best nominal / mended model in per cent."""
    heads = ("case", "engine", "verdict", "right", "wrong", "sets", "missed", *METRICS, "shares", "seconds")
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    for _, row in rows.iterrows():
        cells = [row["case"], row["engine"], row["verdict"]]
        cells += [
            row[c].replace("+", ", ").replace("|", " or ") or "-"
            for c in ("named_right", "named_wrong", "sets", "missed")
        ]
        cells += [" / ".join(_short(row[f"{model}_{metric}"]) for model in MODELS) for metric in METRICS]
        cells += [f"{_short(row['parameter_share'])}, {_short(row['open60_share'])}", f"{row['seconds']:.0f}"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _short(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "-"
