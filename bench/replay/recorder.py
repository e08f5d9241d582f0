"""Steps an estimator over one machine's readings and keeps all that goes in and comes out."""

from __future__ import annotations

import hashlib
import platform
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import binding
from numba import config
from numpy.typing import ArrayLike

from twinbench.bench import cells
from twinbench.bench.estimate.apply import Training, read_all, trained_cells
from twinbench.bench.profile import profile_on
from twinbench.bench.replay.record import RECORD_VERSION, SAID, Record
from twinbench.common.documents import made_from, strict
from twinbench.common.errors import BadInput
from twinbench.common.store import sha256_of
from twinbench.common.threads import pin_torch
from twinbench.common.versions import code_version, provenance
from twinbench.data.recording import files_of
from twinbench.machines.load import load_machine
from twinbench.methods.estimator import Estimator, Info, Sample, State


class Recorder:
    """A trained estimator on one machine, from the first sample on.

    Attributes:
        estimator: fitted.
        every: in so many ticks one is kept in full; of the others a checksum is.
    """

    def __init__(self, estimator: Estimator, every: int = 1) -> None:
        self.estimator, self.every = estimator, every
        self._state = estimator.init(1)
        self._given: list[tuple[float, np.ndarray, np.ndarray]] = []
        self._checksums: list[int] = []
        self._said: list[list[np.ndarray]] = []

    def update(self, time_s: float, measured: ArrayLike, lag_s: ArrayLike | None = None) -> tuple[State, Info]:
        """Take in a tick's readings.

        Args:
            time_s: of the tick.
            measured: (nu + ny,) readings in the channels' units, inputs first; NaN means missing.
            lag_s: (nu + ny,) seconds, how long before the tick each was read; None: nobody says.

        Returns:
            What ``Estimator.step`` returns, leading axis 1.
        """
        readings = np.array(measured, np.float64)
        lags = np.full(readings.shape, np.nan) if lag_s is None else np.array(lag_s, np.float64)
        sample = Sample(float(time_s), readings[None].copy(), None if lag_s is None else lags[None].copy())
        self._state, info = self.estimator.step(self._state, sample)
        if len(self._given) % self.every == 0:
            said = {**self._state._asdict(), **info._asdict()}
            self._said.append([said[name][0].copy() for name in SAID])
        self._given.append((sample.time_s, readings, lags))
        self._checksums.append(checksum(self._state, info))
        return self._state, info

    def record(self, settings: Mapping[str, Any] | None = None, files: Sequence[Mapping[str, Any]] = ()) -> Record:
        """The run so far.

        Args:
            settings: how the run was asked for, for its provenance.
            files: what was read for it, as ``common.documents.read_file`` tells it.

        Raises:
            ValueError: nothing has gone in yet.
        """
        if not self._given:
            raise ValueError("nothing is recorded yet; call update with the first readings")
        estimator, machine = self.estimator, self.estimator.machine
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "model.npz"
            estimator.save(file)
            model, digest = file.read_bytes(), sha256_of(file)
        about = {
            "record_version": RECORD_VERSION,
            "estimator": estimator.name,
            "machine": machine.name,
            "channels": machine.channels,
            "outputs": machine.outputs,
            "quantities": machine.quantities,
            "every": self.every,
            "model_sha256": digest,
            "code": code_version(type(estimator).__module__),
            "place": place(),
            "provenance": made_from(settings or {}, files),
        }
        time_s, measured, lag_s = (np.array(part) for part in zip(*self._given, strict=True))
        said = dict(zip(SAID, map(np.array, zip(*self._said, strict=True)), strict=True))
        return Record(strict(about), model, time_s, measured, lag_s, np.array(self._checksums, np.uint64), said)


def checksum(state: State, info: Info) -> int:
    """64 bits of all that comes out of a tick, with what is carried to the next."""
    digest = hashlib.blake2b(digest_size=8)
    for array in (*state[:-1], *info, *state.memory):
        _take_in(digest, array)
    return int.from_bytes(digest.digest(), "little")


def _take_in(digest: Any, array: np.ndarray) -> None:
    """Of records each field by itself: what lies between them is nobody's, and may be anything."""
    if array.dtype.names:
        for name in array.dtype.names:
            _take_in(digest, array[name])
    else:
        digest.update(array.tobytes())


def place() -> dict[str, str]:
    """What the bits depend on besides the code: processor, system and versions."""
    here = provenance()
    return {
        "processor": here["machine"]["processor"],
        "instructions": _instructions(),
        "system": platform.platform(),
        "python": here["python"],
        **here["versions"],
    }


def _instructions() -> str:
    """What numba compiles for: processors of one name may have others."""
    name = config.CPU_NAME or binding.get_host_cpu_name()  # type: ignore[attr-defined]
    has = config.CPU_FEATURES or binding.get_host_cpu_features().flatten()  # type: ignore[attr-defined]
    return f"{name} {hashlib.sha256(has.encode()).hexdigest()[:8]}"


def record_run(name: str, path: Path, where: Training, mapping: Sequence[str], every: int) -> Record:
    """Run a trained estimator over a recording, reading by reading as they came.

    Args:
        every: in so many ticks one is kept in full.

    Raises:
        BadInput: one line; the estimator is not trained there, or the recording cannot be read.
    """
    if every < 1:
        raise BadInput(f"--every is {every}, must be at least 1; 1 keeps every tick in full")
    profile = profile_on(where.profile, where.machine)
    (recording,) = read_all([path], mapping, load_machine(profile.machine))
    store, (cell,) = trained_cells(where, [name])
    pin_torch()
    recorder = Recorder(cells.load_fit(store, cell), every)
    batch = recording.to_batch(recorder.estimator.machine)
    for time_s, readings in zip(batch.time_s, batch.measured[0], strict=True):
        recorder.update(time_s, readings)
    settings = {
        "estimator": name,
        "profile": where.profile,
        "results": where.folder(profile).as_posix(),
        "machine": profile.machine,
        "map": list(mapping),
        "every": every,
    }
    return recorder.record(settings, list(files_of(path)))
