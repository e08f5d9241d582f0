"""A recording as a user hands it over: a table, the kind of file, what stands beside it and on the command line."""

from __future__ import annotations

import gzip
import io
import pickle
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from helpers.recording_kinds import WRITERS

from twinbench.machines.compressor import CHANNELS, INPUTS, OUTPUTS

TIME = "time_s"


@dataclass(frozen=True)
class Machine:
    """What is recorded of it. ``others``: by channel, (another unit, factor, offset added to the value first)."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    others: dict[str, tuple[tuple[str, float, float], ...]]

    @property
    def channels(self) -> tuple[str, ...]:
        return (*self.inputs, *self.outputs)


_BAR = (("kPa", 100.0, 0.0), ("psi", 14.503774, 0.0), ("MPa", 0.1, 0.0))
_KELVIN = (("degC", 1.0, -273.15), ("degF", 1.8, -255.372222))
COMPRESSOR = Machine(
    INPUTS, OUTPUTS,
    {
        "p_suc_bar": _BAR, "p_dis_bar": _BAR, "T_suc_K": _KELVIN, "T_dis_K": _KELVIN,
        "N_rpm": (("rps", 1.0 / 60.0, 0.0),), "valve": (("percent", 100.0, 0.0),),
        "m_flow_kg_s": (("kg/h", 3600.0, 0.0), ("g/s", 1000.0, 0.0)),
    },
)  # fmt: skip
TANK = Machine(
    ("pump_V",),
    ("h_m",),
    {"pump_V": (("mV", 1000.0, 0.0),), "h_m": (("cm", 100.0, 0.0), ("mm", 1000.0, 0.0), ("ft", 3.2808399, 0.0))},
)


@dataclass
class Given:
    """One recording on its way to a file; mutators change it.

    Attributes:
        encode: text of a CSV to bytes.
        spoil: bytes of the file to other bytes.
        sidecar: the TOML file beside it.
        beside: further recordings in its folder, by name.
        maps: values of ``--map``.
    """

    machine: Machine
    frame: pd.DataFrame
    name: str = "day.csv"
    to_text: Callable[[pd.DataFrame], str] = lambda frame: frame.to_csv(index=False)
    encode: Callable[[str], bytes] = str.encode
    spoil: Callable[[bytes], bytes] = bytes
    sidecar: str | bytes | None = None
    beside: dict[str, pd.DataFrame] = field(default_factory=dict)
    maps: list[str] = field(default_factory=list)

    def write(self, folder: Path) -> Path:
        path = folder / self.name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(self.spoil(self._bytes()))
        for name, frame in self.beside.items():
            frame.to_csv(path.with_name(name), index=False)
        if self.sidecar is not None:
            text = self.sidecar if isinstance(self.sidecar, bytes) else self.sidecar.encode()
            path.with_name(self.stem + ".toml").write_bytes(text)
        return path

    @property
    def stem(self) -> str:
        kinds = [kind for kind in (".csv", ".csv.gz", ".parquet", *WRITERS) if self.name.endswith(kind)]
        return Path(self.name).name.removesuffix(max(kinds, key=len, default=""))

    def _bytes(self) -> bytes:
        if self.name.endswith(".parquet"):
            buffer = io.BytesIO()
            self.frame.to_parquet(buffer, index=False)
            return buffer.getvalue()
        if (kind := Path(self.name).suffix) in WRITERS:
            return written(self.frame, kind)
        data = self.encode(self.to_text(self.frame))
        return gzip.compress(data, mtime=0) if self.name.endswith(".gz") else data

    def channel(self, rng: np.random.Generator) -> str:
        """Any of its channels."""
        return str(rng.choice(self.machine.channels))

    def moving(self, rng: np.random.Generator) -> str:
        """A channel that follows the machine more than its noise: what it was a moment ago says what it is."""
        steady = {c: self.frame[c].autocorr(1) for c in self.machine.channels}
        return str(rng.choice([c for c, r in steady.items() if r > 0.9] or list(steady)))

    def cells(self) -> None:
        """Columns that may hold anything."""
        self.frame = self.frame.astype(object)


_WRITTEN: dict[tuple[str, bytes], bytes] = {}


def written(frame: pd.DataFrame, kind: str) -> bytes:
    """The frame as a file of a kind. Libraries put the time of writing into it, so the first one is kept."""
    key = kind, pickle.dumps(frame)
    if key not in _WRITTEN:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"day{kind}"
            WRITERS[kind](frame, path)
            _WRITTEN[key] = path.read_bytes()
    return _WRITTEN[key]


assert set(CHANNELS) == set(COMPRESSOR.channels)
