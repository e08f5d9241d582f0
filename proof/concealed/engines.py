"""The engines of the suite by name: ours, the oracle, the opponents, and ours with a thing left out."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from twinbench.common.errors import BadInput

ORACLE = "oracle"
"""It is told which mechanisms there are."""
ENGINES = {
    "twinbench": "twinbench.mismatch:diagnose",
    ORACLE: "twinbench.mismatch:diagnose",
    "calibrate_only": "twinbench.proof.opponents.calibrate_only:diagnose",
    "sindy": "twinbench.proof.opponents.sindy:sindy",
    "sindy_projected": "twinbench.proof.opponents.sindy:sindy_projected",
    "weak_sindy": "twinbench.proof.opponents.sindy:weak_sindy",
    "weak_sindy_projected": "twinbench.proof.opponents.sindy:weak_sindy_projected",
    "black_box": "twinbench.proof.opponents.black_box:diagnose",
    "bic_picker": "twinbench.proof.opponents.bic_picker:diagnose",
    "no_learnt_decision": "twinbench.proof.opponents.ablations:no_learnt_decision",
    "no_discrepancy": "twinbench.proof.opponents.ablations:no_discrepancy",
    "no_relinearisation": "twinbench.proof.opponents.ablations:no_relinearisation",
}
"""By name, "module:function", called as ``twinbench.diagnose``."""
MAIN = ("twinbench", ORACLE)
"""Those that always get every case."""


def chosen(names: str) -> dict[str, str]:
    """Engines by their names, joined by commas; ``all`` of them.

    ``before=FOLDER`` is the engine of another checkout of Twinbench, under a name of its own.

    Raises:
        BadInput: an unknown name, an engine whose library is not installed, or a folder that is no checkout.
    """
    listed = list(ENGINES) if names == "all" else [name.strip() for name in names.split(",")]
    elsewhere = dict(_elsewhere(*name.split("=", 1)) for name in listed if "=" in name)
    for name in (name for name in listed if "=" not in name):
        if name not in ENGINES:
            raise BadInput(f"engine {name!r} is not known; choose from {', '.join(ENGINES)}, or all")
        if "sindy" in name and importlib.util.find_spec("pysindy") is None:
            raise BadInput(f"engine {name!r} needs pysindy; install it with: pip install 'twinbench[opponents]'")
    return {name.partition("=")[0]: (ENGINES | elsewhere)[name.partition("=")[0]] for name in listed}


def _elsewhere(name: str, folder: str) -> tuple[str, str]:
    if name in ENGINES:
        raise BadInput(f"engine {name!r} is one of this checkout; name the one in {folder} otherwise")
    if not (Path(folder) / "proof" / "blind.py").is_file():
        raise BadInput(f"engine {name!r}: {folder} is no checkout of Twinbench; it has no proof/blind.py")
    return name, f"{ENGINES['twinbench']}@{folder}"
