"""What must be reached, what was, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import norm

from twinbench.proof.concealed.judge import COLUMNS
from twinbench.proof.concealed.marks import DETECTABLE, REACHED_SHARE, SOUND, UNKNOWN, marks, miss

COMPARED = {
    "right_name": "right name, single detectable effect",
    "right_or_in_set": "right name, alone or in a set of at most three",
    "both_of_two": "both of two effects",
    "false_name": "false name: clean, parameters, poor excitation",
    "sensor_called_physics": "sensor fault called physics",
    "fault_named": "sensor or input fault named",
    "confidently_wrong": "confidently wrong",
    "abstains": "truth not in the catalogue: abstains or a right set",
    "located": "located within two ports",
    "gain": "held-out gain of every detectable effect, median",
}
"""Gates that engines are held against each other by: column of ``engines.csv``, gate."""
TEXTS = ("truth", "verdict", "named", "set", "port_truth", "ports_named", "alike")


def read_cases(path: Path) -> pd.DataFrame:
    """``cases.csv``, empty texts as such."""
    return pd.read_csv(
        path,
        dtype=dict.fromkeys(("case", *TEXTS), str),
        keep_default_na=False,
        na_values={c: [""] for c in COLUMNS if c not in ("case", *TEXTS)},
    )


def wilson(hits: int, cases: int, level: float = 0.95) -> tuple[float, float]:
    """Wilson's score interval of a rate; (0, 1) without cases."""
    if cases == 0:
        return 0.0, 1.0
    z2 = float(norm.ppf(0.5 + level / 2.0)) ** 2
    middle = (hits + z2 / 2.0) / (cases + z2)
    half = np.sqrt(z2 * (hits * (cases - hits) / cases + z2 / 4.0)) / (cases + z2)
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))


def gate_table(rows: pd.DataFrame) -> pd.DataFrame:
    """The gates of one engine's rows: gate, required, measured, low, high, cases, met.

    Rates come with Wilson's 95 % interval, medians and quantiles with that of their order statistics.
    ``met`` is None where there is no case.
    """
    marked = pd.DataFrame([marks(row) for _, row in rows.iterrows()], index=rows.index)
    detectable = rows["severity"] >= REACHED_SHARE * DETECTABLE
    named = marked["confidently_wrong"].eq(False) & detectable & (rows["named"] != "") & ~rows["cell"].isin(SOUND)
    sized = rows.loc[detectable & marked["named_right"].eq(True)]
    gains = rows.loc[named & ~rows["cell"].isin([*UNKNOWN, "sensor"])]
    # Who says nothing gains nothing.
    any_gain = rows.loc[detectable & ~rows["cell"].isin(SOUND), "gain"].fillna(0.0)
    table = [
        rate("right name, single detectable effect", ">=", 0.85, marked["named_right"]),
        rate("right name, alone or in a set of at most three", "", np.nan, marked["set_right"]),
        rate("both of two effects", ">=", 0.75, marked["pair_right"]),
        rate("false name: clean, parameters, poor excitation", "<=", 0.02, marked["false_name"]),
        rate("sensor fault called physics", "<=", 0.02, marked["physics_for_sensor"]),
        rate("sensor or input fault named", "", np.nan, marked["fault_right"]),
        rate("confidently wrong", "<=", 0.03, marked["confidently_wrong"]),
        rate("truth not in the catalogue: abstains or a right set", ">=", 0.85, marked["abstained_right"]),
        rate("located within two ports", ">=", 0.90, marked["located"]),
        quantile("onset error, median, s", "<=", 10.0, rows.loc[detectable, "onset_error_s"]),
        quantile("error of the size, median, %", "<=", 5.0, sized["size_error_pct"]),
        rate("90 % interval covers the size", "in", (0.85, 0.95), sized["size_covered"].dropna() > 0.5),
        quantile("held-out gain, median", ">=", 0.9, gains["gain"]),
        quantile("held-out gain, 5 % quantile", ">=", 0.5, gains["gain"], 0.05),
        quantile("held-out gain of every detectable effect, median", "", np.nan, any_gain),
        quantile("share of the oracle's gain, median", ">=", 0.95, gains["gain"] / gains["oracle_gain"]),
    ]
    return pd.DataFrame(table)


def engine_table(rows: pd.DataFrame) -> pd.DataFrame:
    """The engines side by side, over the cases that all of them answered: a row per engine.

    Columns are engine, cases, then for each of ``COMPARED`` the measured value, ``_low``, ``_high`` (95 %, as in
    ``gate_table``) and ``_cases``, last the median seconds.
    """
    engines = list(dict.fromkeys(rows["engine"]))
    by_all = rows.groupby("case")["engine"].transform("nunique") == len(engines)
    table = []
    for engine in engines:
        own = rows[by_all & (rows["engine"] == engine)]
        gates = gate_table(own).set_index("gate")
        line: dict[str, Any] = {"engine": engine, "cases": len(own)}
        for column, gate in COMPARED.items():
            g = gates.loc[gate]
            line |= {column: g["measured"], f"{column}_low": g["low"], f"{column}_high": g["high"]}
            line[f"{column}_cases"] = g["cases"]
        table.append(line | {"seconds": own["seconds"].median()})
    return pd.DataFrame(table)


def misses(rows: pd.DataFrame) -> pd.DataFrame:
    """Every row that missed something, with ``miss``: what."""
    said = rows.assign(miss=[miss(row) for _, row in rows.iterrows()])
    columns = ["miss", "engine", "case", "machine", "cell", "severity", "background_pct", "truth", "named", "set"]
    missed = said.loc[said["miss"] != "", [*columns, "ports_named"]]
    return missed.sort_values(["engine", "miss", "machine", "case"], ignore_index=True)


def rate(gate: str, sense: str, required: Any, hits: pd.Series) -> dict[str, Any]:
    """A gate on a rate, with Wilson's interval; cases that do not ask are None."""
    asked = hits.dropna().astype(bool)
    low, high = wilson(int(asked.sum()), len(asked))
    return gate_line(gate, sense, required, float(asked.mean()) if len(asked) else np.nan, low, high, len(asked))


def quantile(gate: str, sense: str, required: float, values: pd.Series, share: float = 0.5) -> dict[str, Any]:
    """A gate on a quantile, with the interval of its order statistics."""
    known = np.sort(values.dropna().to_numpy(dtype=float))
    n = len(known)
    if n == 0:
        return gate_line(gate, sense, required, np.nan, np.nan, np.nan, 0)
    low, high = wilson(round(share * n), n)
    ends = np.quantile(known, [share, low, high])
    return gate_line(gate, sense, required, float(ends[0]), float(ends[1]), float(ends[2]), n)


def gate_line(
    gate: str, sense: str, required: Any, measured: float, low: float, high: float, cases: int
) -> dict[str, Any]:
    """One gate: what is required of it, what was measured with its 95 % interval, and is it met? None without cases."""
    met: bool | None = None
    if cases and sense:
        met = {
            ">=": lambda: measured >= required,
            "<=": lambda: measured <= required,
            "in": lambda: required[0] <= measured <= required[1],
        }[sense]()
    said = f"{required[0]:g} to {required[1]:g}" if sense == "in" else f"{sense} {required:g}" if sense else ""
    return {"gate": gate, "required": said, "measured": measured, "low": low, "high": high, "cases": cases, "met": met}


def by(rows: pd.DataFrame, columns: Sequence[str]) -> pd.DataFrame:
    """The rate of right names over some columns, such as severity, background or machine, with intervals."""
    right = pd.Series([marks(row).set_right for _, row in rows.iterrows()], index=rows.index, dtype=object)
    marked = rows.assign(right=right)
    table = []
    for key, group in marked.dropna(subset="right").groupby(list(columns)):
        hits, n = int(group["right"].astype(bool).sum()), len(group)
        low, high = wilson(hits, n)
        table.append(dict(zip(columns, key, strict=True)) | {"right": hits / n, "low": low, "high": high, "cases": n})
    return pd.DataFrame(table)


def as_markdown(gates: pd.DataFrame) -> str:
    """A gate table to read."""
    lines = ["| gate | required | measured | 95 % interval | cases | met |", "|---|---|---|---|---|---|"]
    for _, g in gates.iterrows():
        met = "" if g["met"] is None else "yes" if g["met"] else "**no**"
        measured, interval = "-", "-"
        if g["cases"]:
            measured, interval = f"{g['measured']:.3g}", f"{g['low']:.3g} to {g['high']:.3g}"
        lines.append(f"| {g['gate']} | {g['required']} | {measured} | {interval} | {g['cases']} | {met} |")
    return "\n".join(lines) + "\n"


def engines_as_markdown(table: pd.DataFrame) -> str:
    """``engine_table`` to read: each engine's values with their 95 % intervals."""
    lines = [
        f"The {table['cases'].iloc[0]} cases that every engine answered; 95 % intervals in brackets.",
        "",
        "| engine | " + " | ".join(column.replace("_", " ") for column in COMPARED) + " | s |",
        "|---" * (len(COMPARED) + 2) + "|",
    ]
    for _, row in table.iterrows():
        cells = [
            f"{row[c]:.2f} ({row[f'{c}_low']:.2f} to {row[f'{c}_high']:.2f})" if row[f"{c}_cases"] else "-"
            for c in COMPARED
        ]
        lines.append(f"| {row['engine']} | " + " | ".join(cells) + f" | {row['seconds']:.3g} |")
    return "\n".join(lines) + "\n"
