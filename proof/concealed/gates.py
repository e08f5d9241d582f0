"""What must be reached, what was, and how sure that is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import norm

from twinbench.proof.concealed.findings import SINGLE, miss, stated, with_marks
from twinbench.proof.concealed.outcome import SOUND, UNKNOWN, WRONG_NAMES
from twinbench.proof.concealed.power import reliability, reliability_error

COMPARED = {
    "by_class": "single effect: right name or class, all machines",
    "by_name": "single effect: right name alone, all machines",
    "pairs": "both of two effects, by class",
    "false_name": "sound machine: false name",
    "fault_by_class": "sensor or input fault, by class",
    "called_physics": "sensor or input fault called physics",
    "confidently_wrong": "confidently wrong, of all verdicts",
    "abstains": "not in the catalogue: no wrong name",
    "located": "not in the catalogue: located within two ports",
    "gain": "held-out gain of every detectable effect, median",
}
"""Gates that engines are held against each other by: column of ``engines.csv``, gate."""
BY_KIND = {"tuned": (0.90, 0.85), "untuned": (0.80, np.nan), "random": (0.80, np.nan)}
"""Least rates of a right name or class, and of a right name alone, by kind of machine."""


def wilson(hits: float, cases: int, level: float = 0.95) -> tuple[float, float]:
    """Wilson's score interval of a rate; (0, 1) without cases."""
    if cases == 0:
        return 0.0, 1.0
    z2 = float(norm.ppf(0.5 + level / 2.0)) ** 2
    middle = (hits + z2 / 2.0) / (cases + z2)
    half = np.sqrt(z2 * (hits * (cases - hits) / cases + z2 / 4.0)) / (cases + z2)
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))


def gate_table(rows: pd.DataFrame) -> pd.DataFrame:
    """The gates of one engine's rows: gate, required, measured, low, high, cases, met, ideal.

    Rates come with Wilson's 95 % interval, medians and quantiles with that of their order statistics. ``met`` is None
    where there is no case. ``ideal`` is what the ideal observer reaches on the same cases; NaN where it is not asked.
    """
    rows = with_marks(rows)
    there = rows[rows["detectable"]]
    table = _singles(there[there["cell"].isin(SINGLE)]) + _others(rows, there)
    return pd.DataFrame(table + _numbers(rows, there))


def _singles(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Gates on single detectable effects."""
    table = []
    for kind, (least_class, least_name) in {"all": (np.nan, np.nan), **BY_KIND}.items():
        own = rows if kind == "all" else rows[rows["kind"] == kind]
        where = f"{kind} machines"
        table += [
            _beside(f"single effect: right name or class, {where}", ">=", least_class, own, "class"),
            _beside(f"single effect: right name alone, {where}", ">=", least_name, own, "name"),
        ]
    within = rows["outcome"].isin(("name", "class", "set"))
    return [*table, rate("single effect: right name, class or a set of at most three", "", np.nan, within)]


def _others(rows: pd.DataFrame, there: pd.DataFrame) -> list[dict[str, Any]]:
    """Gates on sound machines, on two effects, on what the catalogue lacks, and on faults."""
    sound, unknown = rows[rows["cell"].isin(SOUND)], rows[rows["cell"].isin(UNKNOWN)]
    pointed = unknown.loc[unknown["detectable"], "pointed"]
    pairs, faults = there[there["cell"] == "two_effects"], there[there["cell"] == "sensor"]
    open_end = sound["verdict"].isin(("unexplained", "incomplete"))
    all_clear = there["verdict"].isin(("consistent", "parameter change"))
    return [
        rate("sound machine: false name", "<=", 0.0, sound["named"] != ""),
        rate("sound machine: false name or set", "<=", 1.0 / max(len(sound), 1), sound["said"]),
        rate("sound machine: called unexplained or incomplete, without a name", "", np.nan, open_end & ~sound["said"]),
        rate("confidently wrong, of all verdicts", "<=", WRONG_NAMES, rows["wrong_name"]),
        share("effects that are certainly not there, named", "<=", 0.01, rows["decoys_named"]),
        rate("detectable effect or fault: called consistent or a parameter change", "", np.nan, all_clear),
        _beside("both of two effects, by class", ">=", 0.75, pairs, "class"),
        rate("not in the catalogue: no wrong name", ">=", 0.95, unknown["named"] == ""),
        rate("not in the catalogue: located within two ports", ">=", 0.90, pointed),
        _beside("sensor or input fault, by class", ">=", 0.85, faults, "class"),
        rate("sensor or input fault called physics", "<=", 0.01, rows.loc[rows["cell"] == "sensor", "physics"]),
    ]


def _numbers(rows: pd.DataFrame, there: pd.DataFrame) -> list[dict[str, Any]]:
    """Gates on stated probabilities, sizes, parameters, gain and onset."""
    claims = stated(rows)
    single, with_effect = claims["single"].astype(bool), ~rows["cell"].isin((*SOUND, "sensor"))
    names, sets = claims[single], claims[~single]
    named = there[there["by_class"] & (there["cell"] != "sensor")]
    covered, sound = rows["parameters_covered"], rows["cell"].isin(SOUND)
    return [
        rate("single names that are wrong, of all that are said", "", np.nan, ~names["right"].astype(bool)),
        reliability_line("stated probability, mean error", 0.05, claims),
        rate("sets that hold an effect of the case", ">=", 0.93, sets["right"]),
        rate("90 % interval covers the size", "in", (0.85, 0.95), there["size_covered"].dropna() > 0.5),
        share("90 % intervals of parameters cover, sound machines", "in", (0.85, 0.95), covered[sound]),
        share("90 % intervals of parameters cover, beside an effect", "in", (0.85, 0.95), covered[with_effect]),
        quantile("error of the size, median, %", "", np.nan, there["size_error_pct"]),
        quantile("held-out gain of named effects, median", ">=", 0.95, named["gain"]),
        # Who says nothing gains nothing.
        quantile("held-out gain of every detectable effect, median", "", np.nan, there["gain"].fillna(0.0)),
        quantile("onset error, median, s", "<=", 5.0, there["onset_error_s"]),
        quantile("seconds of one core that a case takes, median", "<=", 5.0, rows["seconds"]),
    ]


def _beside(gate: str, sense: str, required: float, rows: pd.DataFrame, what: str) -> dict[str, Any]:
    """A rate of ``by_class`` or ``by_name`` beside the ideal observer's."""
    line = rate(gate, sense if np.isfinite(required) else "", required, rows[f"by_{what}"])
    return line | {"ideal": rows[f"ideal_{what}"].mean()}


def share(gate: str, sense: str, required: Any, shares: pd.Series) -> dict[str, Any]:
    """A gate on the mean of a share that each case has; the interval is that of as many independent cases."""
    known = shares.dropna()
    low, high = wilson(known.sum(), len(known))
    return gate_line(gate, sense, required, float(known.mean()) if len(known) else np.nan, low, high, len(known))


def reliability_line(gate: str, required: float, claims: pd.DataFrame) -> dict[str, Any]:
    """Mean distance of stated probabilities of single names from the rate of right ones, bin by bin."""
    bins = reliability(claims)
    return gate_line(gate, "<=", required, reliability_error(bins), np.nan, np.nan, int(bins["cases"].sum()))


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
    said = with_marks(rows)
    said["miss"] = [miss(row) for _, row in said.iterrows()]
    columns = ["miss", "engine", "case", "machine", "cell", "severity", "background_pct", "truth", "class", "D0_sq"]
    missed = said.loc[said["miss"] != "", [*columns, "Dk_sq", "named", "set", "ports"]]
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


def as_markdown(gates: pd.DataFrame) -> str:
    """A gate table to read; with the ideal observer's column where there is one."""
    has_ideal = "ideal" in gates
    head = ["gate", "required", "measured", "95 % interval", *(["ideal observer"] if has_ideal else []), "cases", "met"]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for _, g in gates.iterrows():
        met = "" if g["met"] is None else "yes" if g["met"] else "**no**"
        measured, interval, ideal = "-", "-", []
        if g["cases"]:
            measured = f"{g['measured']:.3g}"
            interval = f"{g['low']:.3g} to {g['high']:.3g}" if np.isfinite(g["low"]) else ""
        if has_ideal:
            ideal = [f"{g['ideal']:.3g}" if np.isfinite(g["ideal"]) else ""]
        lines.append(f"| {' | '.join([g['gate'], g['required'], measured, interval, *ideal, str(g['cases']), met])} |")
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
