"""Which estimator keeps a machine's digital twin true, and what does its simulator leave out?

The names below are the public face; each is imported when it is first asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from twinbench.common.compiled_code import settle

if TYPE_CHECKING:
    from twinbench.data.recording import Recording
    from twinbench.machines.load import load_machine
    from twinbench.machines.machine import Machine
    from twinbench.machines.parts import Health, Lag, Reading
    from twinbench.machines.sensors import Drift, Noise
    from twinbench.methods.estimator import Estimator, Sample, gaussian_state, no_info, register
    from twinbench.mismatch import diagnose
    from twinbench.mismatch.model import load_catalogue, load_simulator
    from twinbench.mismatch.recordings import read_recordings
    from twinbench.physics.simulator import Amplitude, Mechanism, Series, Simulator, Term, Variable

__all__ = [
    "Amplitude", "Drift", "Estimator", "Health", "Lag", "Machine", "Mechanism", "Noise", "Reading", "Recording",
    "Sample", "Series", "Simulator", "Term", "Variable", "diagnose", "gaussian_state", "load_catalogue",
    "load_machine", "load_simulator", "no_info", "read_recordings", "register",
]  # fmt: skip

_HOMES = {
    "physics.simulator": ("Simulator", "Variable", "Mechanism", "Term", "Amplitude", "Series"),
    "data.recording": ("Recording",),
    "machines.load": ("load_machine",),
    "machines.machine": ("Machine",),
    "machines.parts": ("Health", "Lag", "Reading"),
    "machines.sensors": ("Drift", "Noise"),
    "methods.estimator": ("Estimator", "Sample", "gaussian_state", "no_info", "register"),
    "mismatch": ("diagnose",),
    "mismatch.model": ("load_catalogue", "load_simulator"),
    "mismatch.recordings": ("read_recordings",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

settle()  # before anything is compiled


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'twinbench' has no attribute {name!r}; it has: {', '.join(__all__)}")
    return getattr(importlib.import_module(f"twinbench.{_HOME_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
