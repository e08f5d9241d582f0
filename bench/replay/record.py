"""The file of an online run: the estimator as it was, what went in at each tick, and what came out."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.common.store import write_atomically
from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine
from twinbench.methods.estimator import Estimator

RECORD_VERSION = 1
"""Of the form of a record; another one cannot be read."""
GIVE_ONE = "give a file that twinbench record wrote"
NO_RECORD = f"no record of an online run; {GIVE_ONE}"
ZIP = b"PK"
"""What every .npz begins with."""
SAID = {
    "mean": ("{}", ("quantities",)),
    "cov": ("covariance of {} and {}", ("quantities", "quantities")),
    "low": ("lower end of {}", ("quantities",)),
    "high": ("upper end of {}", ("quantities",)),
    "innovation": ("innovation of {}", ("outputs",)),
    "S": ("innovation covariance of {} and {}", ("outputs", "outputs")),
    "nis": ("NIS", ()),
    "accepted": ("use of {}", ("outputs",)),
    "flags": ("flags", ()),
    "age_s": ("age of {}", ("channels",)),
}
"""By field of State and Info: what a value of it is called, and whose names stand along its axes."""
ABOUT = {
    "record_version": int,
    "estimator": str,
    "machine": str,
    "channels": list,
    "outputs": list,
    "quantities": list,
    "every": int,
    "model_sha256": str,
    "code": str,
    "place": dict,
    "provenance": dict,
}
"""What a record says of itself, and as what."""


@dataclass(frozen=True)
class Record:
    """One machine's run, N ticks.

    Attributes:
        about: as ``ABOUT`` has it. ``code`` is the checksum of the estimator's, ``place`` what else the bits depend on.
        model: settings and weights: the bytes that ``Estimator.save`` writes.
        time_s: (N,) seconds.
        measured: (N, nu + ny) in the channels' units, inputs first; NaN means missing.
        lag_s: (N, nu + ny) seconds, how long before its tick each channel was read; NaN where nobody said.
        checksums: (N,) uint64, dimensionless, of all that came out of each tick, with what is carried to the next.
        said: by field of State and Info, (K, ...) in its units, of the ticks that are kept in full.
    """

    about: Mapping[str, Any]
    model: bytes
    time_s: Array
    measured: Array
    lag_s: Array
    checksums: np.ndarray
    said: Mapping[str, np.ndarray]

    def estimator(self, kind: type[Estimator], machine: Machine) -> Estimator:
        """As it was when the record was made.

        Raises:
            ValueError: the model is another estimator's, of another machine or of another version.
        """
        with TemporaryDirectory() as folder:
            file = Path(folder) / "model.npz"
            file.write_bytes(self.model)
            try:
                return kind.load(file, machine)
            except ValueError as error:
                raise ValueError(str(error).replace(str(file), "its model")) from error

    def save(self, path: Path) -> None:
        """Write it to one compressed ``.npz``, without pickle.

        Raises:
            BadInput: it cannot be written there.
        """
        parts = {
            "about.json": np.frombuffer(json.dumps(self.about).encode(), np.uint8),
            "model.npz": np.frombuffer(self.model, np.uint8),
            **{name: getattr(self, name) for name in ("time_s", "measured", "lag_s", "checksums")},
            **{f"said.{name}": values for name, values in self.said.items()},
        }

        def write(beside: Path) -> None:
            with open(beside, "wb") as file:  # given a path, NumPy would add a suffix of its own
                np.savez_compressed(file, allow_pickle=False, **parts)

        write_atomically(path, write)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what ``save`` wrote.

        Raises:
            BadInput: one line; there is no such file, or it is no whole record.
        """
        try:
            with open(path, "rb") as file:
                if file.read(len(ZIP)) != ZIP:
                    raise BadInput(NO_RECORD)
                file.seek(0)
                with np.load(file, allow_pickle=False) as stored:
                    record = cls._read(stored)
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from error
        except OSError as error:
            raise BadInput(f"cannot read {path}: {error.strerror or error}; {GIVE_ONE}") from error
        except Exception as error:
            why = f"{type(error).__name__}: {error}".splitlines()[0]
            raise BadInput(f"{path}: cut short or damaged ({why}); copy it again, or record the run again") from error
        return record

    @classmethod
    def _read(cls, stored: Mapping[str, np.ndarray]) -> Self:
        if "about.json" not in stored:
            raise BadInput(NO_RECORD)
        about = json.loads(stored["about.json"].tobytes())
        _check(about)
        arrays = {name: stored[name] for name in ("time_s", "measured", "lag_s", "checksums")}
        said = {name: stored[f"said.{name}"] for name in SAID}
        record = cls(about, stored["model.npz"].tobytes(), **arrays, said=said)
        record._check_arrays()
        return record

    def _check_arrays(self) -> None:
        """Are the shapes and types those that belong together, and is the model the one that was recorded?"""
        ticks, every = len(self.time_s), self.about["every"]
        sized = {name: (len(self.about[name]),) for name in ("channels", "outputs", "quantities")}
        due: dict[str, tuple[int, ...]] = dict.fromkeys(("measured", "lag_s"), (ticks, *sized["channels"]))
        due |= {"time_s": (ticks,), "checksums": (ticks,)}
        found = {name: getattr(self, name) for name in due}
        for name, (_, axes) in SAID.items():
            found[name] = self.said[name]
            due[name] = (len(range(0, ticks, every)), *(sized[axis][0] for axis in axes))
        for name, values in found.items():
            if values.shape != due[name] or values.dtype.kind not in "fiub":
                raise BadInput(f"{name} is {values.dtype} {values.shape}, must be numbers {due[name]}; record it again")
        if sha256(self.model).hexdigest() != self.about["model_sha256"]:
            raise BadInput("its model is not the one that was recorded: the checksums differ; record the run again")


def _check(about: Any) -> None:
    """Does a record say of itself what it must?"""
    if not isinstance(about, dict) or "record_version" not in about:
        raise BadInput(NO_RECORD)
    if about["record_version"] != RECORD_VERSION:
        raise BadInput(
            f"a record of version {about['record_version']}, this twinbench reads version {RECORD_VERSION}; "
            "replay it with the twinbench that made it, or record the run again"
        )
    for name, kind in ABOUT.items():
        if not isinstance(about.get(name), kind):
            raise BadInput(f"{name} in about.json must be {kind.__name__}, is {about.get(name)!r}; record it again")
    settings, files = (about["provenance"].get(name, empty) for name, empty in (("settings", {}), ("files", [])))
    if not isinstance(settings, dict) or not isinstance(files, list) or not all(isinstance(f, dict) for f in files):
        raise BadInput("provenance in about.json does not say settings and files as a record does; record it again")
    if about["every"] < 1:
        raise BadInput(f"every in about.json is {about['every']}, must be at least 1; record it again")
