"""A small good recording, and how the tests write it, whole or spoilt."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from twinbench.common.errors import BadInput
from twinbench.data.recording import read_recording
from twinbench.machines.compressor import COMPRESSOR

TYPICAL = np.array([0.95, 298.0, 1350.0, 0.6, 3.1, 430.0, 0.12])
MENDS = ("check", "copy", "record", "name", "--map", "leave", "sort", "give", "write", "every row", "choose", "move")
MENDS += ("save", "export", "split", "mend")


def table(samples: int = 8) -> pd.DataFrame:
    """(samples, 8): ``time_s`` at 20 Hz and the seven channels, all of them moving a little."""
    wiggle = 1.0 + 0.01 * np.sin(np.arange(samples)[:, None] + np.arange(len(TYPICAL)))
    columns = {"time_s": np.arange(samples) * 0.05} | dict(zip(COMPRESSOR.channels, (TYPICAL * wiggle).T, strict=True))
    return pd.DataFrame(columns)


def write(frame: pd.DataFrame, folder: Path, name: str = "run.csv") -> Path:
    """Write a table by the kind its name says."""
    path = folder / name
    if path.suffix == ".parquet":
        frame.to_parquet(path, index=False)
    else:
        frame.to_csv(path, index=False)
    return path


def refusal(path, *mapping: str) -> str:
    """The one line; it names the file or the option, and tells what to do."""
    with pytest.raises(BadInput) as caught:
        read_recording(path, mapping)
    line = str(caught.value)
    assert "\n" not in line
    assert path.name.split(".")[0] in line or "--map" in line
    assert any(word in line.lower() for word in (*MENDS, "try", "needs", "must"))
    return line
