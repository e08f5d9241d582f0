"""Recordings of a machine: files of many kinds in, checked and in our units; CSV or Parquet out.

Columns are ``time_s`` and one per channel. NaN and empty cells mean missing; time stamps may be
uneven. A TOML file beside the recording, or ``--map PT101[psi]=p_dis_bar``, renames and converts
channels and the time (``--map stamp[ms]=time_s``); the file says more of a run, see ``sidecar``.
Columns named ``true_*`` exist in simulated data only and never get past this door.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twinbench.common.documents import read_file
from twinbench.common.errors import BadInput
from twinbench.common.shown import bare
from twinbench.data.batch import Batch
from twinbench.data.clock import check_clock
from twinbench.data.formats.holdings import TIME, Zero
from twinbench.data.gather import gather
from twinbench.data.resample import resampled
from twinbench.data.sidecar import sidecar_of
from twinbench.data.table import TRUTH_PREFIX, check_file, stem
from twinbench.data.units import Limits, check_plausible, limits_of, short_unit, units_of
from twinbench.machines.compressor import COMPRESSOR
from twinbench.machines.coordinates import Array
from twinbench.machines.machine import Machine

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["TIME", "Recording", "check_overlap", "files_of", "read_recording", "truth_table"]

LONGEST_RUN_S = 14 * 86400.0
LONGEST_NAME_BYTES = 150
"""Bytes of a recording's name; files are named after it, with endings, and may have 255."""
_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
"""Names that Windows keeps for devices, whatever their ending."""


@dataclass(frozen=True)
class Recording:
    """One recording, its channels in our units.

    Attributes:
        name: after which results are named.
        time_s: (N,) seconds, increasing, as recorded.
        channels: C names.
        values: (N, C), each channel in its unit; NaN where missing.
        unread: columns of the file that no channel came from.
        zero: when ``time_s`` is 0; None where the file does not say.
        notes: what was done to it as its sidecar says, and what the file holds besides.
    """

    name: str
    time_s: Array
    channels: tuple[str, ...]
    values: Array
    unread: tuple[str, ...] = ()
    zero: Zero | None = None
    notes: tuple[str, ...] = ()

    def to_batch(self, machine: Machine = COMPRESSOR) -> Batch:
        """On the machine's grid from the first time stamp: each channel's nearest reading, if within half a period.

        Args:
            machine: of which it is a recording, with the same channels.

        Returns:
            A batch of one, ``measured`` (1, N, C) in the channels' units.
        """
        ticks = (self.time_s - self.time_s[0]) / machine.sample_period_s
        steps = np.round(ticks).astype(int)
        nearest_last = np.argsort(-np.abs(ticks - steps), kind="stable")  # of several in one slot the last stays
        measured = np.full((1, steps[-1] + 1, len(self.channels)), np.nan)
        for c, values in enumerate(self.values.T):  # each by itself: channels may report at different times
            found = nearest_last[~np.isnan(values[nearest_last])]
            measured[0, steps[found], c] = values[found]
        time_s = self.time_s[0] + np.arange(measured.shape[1]) * machine.sample_period_s
        return Batch((self.name,), time_s, measured, machine=machine)


def read_recording(
    path: Path,
    mapping: Sequence[str] = (),
    units: Mapping[str, str] = units_of(COMPRESSOR),
    limits: Mapping[str, Limits] = limits_of(COMPRESSOR),
    may_lack: Sequence[str] = (),
    longest_s: float = LONGEST_RUN_S,
    period_s: float = COMPRESSOR.sample_period_s,
) -> Recording:
    """Read a recording and check it.

    Args:
        path: of a kind that ``formats.kinds`` lists.
        mapping: ``COLUMN=channel`` or ``COLUMN[unit]=channel``, each over a TOML sidecar's.
        units: the channels to read and their units; the compressor's by default.
        limits: where a channel's median has to lie; outside it is taken for another unit.
        may_lack: channels that are missing throughout where the file has no column for them.
        longest_s: the longest time span that is no mistake in the unit of time.
        period_s: how far apart samples usually are, to tell such a mistake; infinite where that may be anything.

    Raises:
        BadInput: one line that says what is wrong, where, and how to mend it.
    """
    check_file(path)
    name = name_of(path)
    sidecar = sidecar_of(path)
    run = gather(path, sidecar, mapping, units, may_lack)
    check_clock(run.time_s, run.usual_s, path, run.sources[TIME].column, longest_s, period_s)
    for channel in (c for c in units if c in limits):
        source = run.sources[channel]
        if source.constant is None:
            where = f"{path}, column {bare(source.column)}"
            check_plausible(run.values[channel], limits[channel], units[channel], where, source.column, channel)
        elif not limits[channel][0] <= source.constant <= limits[channel][1]:
            value = f"{source.constant:g} {short_unit(units[channel])}"
            raise BadInput(f"{sidecar.path}: {channel} = {value}, which no such machine shows; give it in that unit")
    values = np.stack([run.values[channel] for channel in units], axis=-1)
    time_s, values, said = resampled(run.time_s, values, sidecar.rate_Hz, path)
    return Recording(name, time_s, tuple(units), values, run.unread, run.zero, (*run.notes, *said))


def files_of(path: Path, held_out: bool = False) -> Iterator[dict[str, Any]]:
    """What was read of a recording as a document's provenance names it: its file, what its sidecar joins, the sidecar.

    Raises:
        BadInput: the sidecar cannot be read.
    """
    sidecar = sidecar_of(path)
    for file in (path, *sidecar.join):
        yield from read_file("recording", file, held_out)
    if sidecar.path.is_file():
        yield from read_file("sidecar", sidecar.path, held_out)


def name_of(path: Path) -> str:
    """The recording's name, after which files are named.

    Raises:
        BadInput: no file can bear it everywhere.
    """
    name = stem(path)
    if not name.strip(". ") or name.startswith(".") or not name.isprintable():
        raise BadInput(f"{path}: no result can be named after this; rename it, printable, without a point in front")
    if len(name.encode(errors="surrogateescape")) > LONGEST_NAME_BYTES:
        raise BadInput(
            f"{path}: results are named after it, and it is longer than {LONGEST_NAME_BYTES} bytes; rename it"
        )
    if _DEVICES.fullmatch(name):
        raise BadInput(f"{path}: Windows keeps {name} for a device and results are named after it; rename it")
    return name


def check_overlap(recordings: Sequence[Recording]) -> None:
    """Refuse recordings that share no channel that was ever measured.

    Raises:
        BadInput: names the two that have nothing in common.
    """
    measured = [{c for c, v in zip(r.channels, r.values.T, strict=True) if not np.isnan(v).all()} for r in recordings]
    for recording, channels in zip(recordings[1:], measured[1:], strict=True):
        if not channels & measured[0]:
            raise BadInput(
                f"recordings {recordings[0].name} and {recording.name} share no measured channel; "
                "estimate them one by one"
            )


def truth_table(batch: Batch, b: int) -> pd.DataFrame:
    """A simulated sequence as a table: time, channels, and ``true_*`` columns where it has truth."""
    import pandas as pd

    machine = batch.machine
    columns: dict[str, Array] = {TIME: batch.time_s}
    columns |= dict(zip(machine.channels, batch.measured[b].T, strict=True))
    if batch.truth is not None:
        truth = zip(machine.quantities, batch.truth.estimated[b].T, strict=True)
        columns |= {TRUTH_PREFIX + name: values for name, values in truth}
        clean = zip(machine.outputs, batch.truth.outputs[b].T, strict=True)
        columns |= {TRUTH_PREFIX + name: values for name, values in clean}
    return pd.DataFrame(columns)
