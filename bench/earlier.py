"""What earlier runs left in a folder, and what of it a further run keeps: the rows of everyone whom it does not run.

An estimator that is run again replaces its own rows. Rows stand beside each other only where the
recordings, the evaluation and the seeds are the same.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from twinbench.bench.cells import Cell
from twinbench.bench.estimates import Estimates
from twinbench.bench.profile import Profile, flattened
from twinbench.bench.results import load_results
from twinbench.bench.roster import ABLATION
from twinbench.bench.scenes import KIND, recordings_key
from twinbench.common.store import Store
from twinbench.common.versions import provenance

FILES = ("scores.csv", "failures.csv", "latency.csv", "cost.csv", "robustness.csv", "tables/regimes.csv")
COMPARABLE = ("seeds", "data.", "corruption.", "evaluation.")
"""What two runs must agree on for their rows to be compared."""


@dataclass(frozen=True)
class Earlier:
    """An earlier run; empty where there is none.

    Attributes:
        made: by estimator, who made its rows and where its estimates are: ``commit``, ``uncommitted_changes``,
            ``command``, ``processor``, keys ``estimates`` of the store, ``takes`` as pairs of scene and key.
        tables: by name of FILES, its rows.
    """

    manifest: Mapping[str, Any] = field(default_factory=dict)
    made: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)

    def rows(self, file: str, without: Iterable[str]) -> pd.DataFrame:
        """The rows of all estimators but those."""
        table = self.tables.get(file, pd.DataFrame())
        return table[~table["estimator"].isin(list(without))] if len(table) else table

    def others(self, without: Iterable[str]) -> dict[str, Mapping[str, Any]]:
        """Who made the rows of all estimators but those."""
        return {name: made for name, made in self.made.items() if name not in set(without)}

    def unchanged(self, todo: Iterable[Cell]) -> set[str]:
        """Of the estimators about to run, those that are trained and evaluated as they were."""
        keys: dict[str, set[str]] = {}
        for cell in todo:
            keys.setdefault(cell.estimator, set()).add(cell.estimates)
        known = set(self.manifest.get("estimates_keys", [])).union(*(m["estimates"] for m in self.made.values()))
        return {name for name, own in keys.items() if name in self.made and own <= known}


def read_earlier(out: Path) -> Earlier:
    """What is in ``out``.

    Raises:
        BadInput: there is a run, but a file of it is missing or unreadable.
    """
    if not (out / "manifest.json").is_file():
        return Earlier()
    manifest = load_results(out).manifest
    made = manifest.get("made") or _attributed(manifest, Store(out / "store"))
    tables = {}
    for file in FILES:
        if (out / file).is_file():
            # As text: the digits that were written are those that are written again.
            table = pd.read_csv(out / file, dtype=str, keep_default_na=False)
            if "estimator" in table:
                table = table.astype({"seed": int}) if "seed" in table else table
                # Rows of a run that was killed before it wrote its manifest are nobody's; its store is whole.
                whole = table["estimator"].map(lambda name: str(name).partition(ABLATION)[0])
                tables[file] = table[table["estimator"].isin(list(made)) | whole.isin(list(made))]
    return Earlier(manifest, made, tables)


def _attributed(manifest: Mapping[str, Any], store: Store) -> dict[str, dict[str, Any]]:
    """``made`` from a manifest that was written before there was one."""
    about = made_by(manifest, manifest.get("command", ""))
    names = [*manifest.get("estimators", []), *manifest.get("ablations", [])]
    made = {name: {**about, "estimates": [], "takes": []} for name in names}
    found = [("estimate", "estimates", key, key) for key in manifest.get("estimates_keys", [])]
    found += [(KIND, "takes", take[1], list(take)) for take in manifest.get("scenes", {}).get("takes", [])]
    for kind, where, key, entry in found:
        if store.has(kind, key):
            # Seeds of who draws nothing share their estimates.
            own = made.get(Estimates.load(store.path(kind, key)).estimator)
            if own is not None:
                own[where].append(entry)
    return made


def made_by(about: Mapping[str, Any], command: str) -> dict[str, Any]:
    """Which commit, command and processor made something, from what ``common.versions.provenance`` returns."""
    return {
        "command": command,
        "commit": about.get("commit"),
        "uncommitted_changes": about.get("uncommitted_changes"),
        "processor": (about.get("machine") or {}).get("processor"),
    }


def what_differs(earlier: Earlier, profile: Profile, data_key: str) -> str:
    """Why the earlier rows cannot stand beside those of this profile; empty if they can."""
    if not earlier.manifest:
        return ""
    now = flattened(json.loads(json.dumps(asdict(profile))))
    then = flattened(earlier.manifest.get("profile", {}))
    for key in now:
        if key.startswith(COMPARABLE) and then.get(key) != now[key]:
            return f"there {key} is {then.get(key)}, here it is {now[key]}"
    if earlier.manifest.get("data_key") != data_key:
        old, new = earlier.manifest.get("versions", {}), provenance()["versions"]
        names = [
            f"{name} {old[name]} there and {new[name]} here" for name in new if old.get(name, new[name]) != new[name]
        ]
        return f"their recordings were simulated by other code or libraries{': ' * bool(names)}{', '.join(names)}"
    filmed = earlier.manifest.get("scenes", {}).get("recordings")
    if filmed and profile.scenes and filmed != recordings_key(profile):
        return "their scenes were simulated by other code"
    return ""
