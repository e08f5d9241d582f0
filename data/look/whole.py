"""A look at a recording's file: what it holds, whatever machine it is of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twinbench.common.errors import BadInput
from twinbench.data.clock import check_clock, usual_period
from twinbench.data.formats.holdings import TIME, Zero
from twinbench.data.formats.united import NANOSECONDS
from twinbench.data.gather import gather
from twinbench.data.look.channel import Channel, look_at
from twinbench.data.look.stretches import Stretch, in_all
from twinbench.data.recording import name_of
from twinbench.data.resample import resampled
from twinbench.data.sidecar import sidecar_of
from twinbench.data.table import check_file
from twinbench.machines.coordinates import Array


@dataclass(frozen=True)
class Look:
    """What a recording holds. N rows, C channels.

    Attributes:
        name: after which what is drawn is named.
        time_s: (N,) seconds.
        values: (N, C), each channel in the unit in which the file has it; NaN where missing.
        channels: what each shows, by name.
        zero: when ``time_s`` is 0; None where nobody says.
        gaps: where no channel was read for longer than its own rate explains.
        unread: columns that hold no numbers.
        notes: what was done to it, what it holds besides, and why other commands refuse it.
    """

    name: str
    time_s: Array
    values: Array
    channels: dict[str, Channel]
    zero: Zero | None
    gaps: tuple[Stretch, ...]
    unread: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def begins(self) -> str | None:
        """Date of the first sample as ISO 8601 writes it; None where nobody says."""
        if self.zero is None:
            return None
        first = np.datetime64(self.zero.ns, "ns") + np.timedelta64(round(float(self.time_s[0]) * NANOSECONDS), "ns")
        return f"{np.datetime_as_string(first, unit='ms')}{'Z' if self.zero.utc else ''}"

    def to_json(self) -> dict[str, Any]:
        """As ``--json`` prints it."""
        return {
            "recording": self.name,
            "samples": len(self.time_s),
            "begins": self.begins,
            "first_s": float(self.time_s[0]),
            "last_s": float(self.time_s[-1]),
            "period_s": usual_period(self.time_s, self.values.T),
            "gaps": [_as_json(stretch) for stretch in self.gaps],
            "channels": {name: _channel_as_json(channel) for name, channel in self.channels.items()},
            "no_numbers": list(self.unread),
            "notes": list(self.notes),
        }


def look(path: Path, mapping: Sequence[str] = ()) -> Look:
    """Read a recording's file, with those that its sidecar joins to it, and look at every column of numbers.

    Args:
        mapping: ``COLUMN=name`` or ``COLUMN[unit]=name``: another name for a column, and its unit. Nothing is converted
            but the time.

    Raises:
        BadInput: one line; it cannot be read, has no time, or its time does not increase.
    """
    check_file(path)
    name = name_of(path)
    sidecar = sidecar_of(path)
    run = gather(path, sidecar, mapping, None)
    notes = list(run.notes)
    try:
        check_clock(run.time_s, run.usual_s, path, run.sources[TIME].column, np.inf, np.inf)
    except BadInput as refusal:
        notes.append(f"other commands refuse it: {refusal}")
    names = list(run.values)
    values = np.stack([run.values[c] for c in names], axis=-1) if names else np.empty((len(run.time_s), 0))
    time_s, values, said = resampled(run.time_s, values, sidecar.rate_Hz, path)
    channels = {
        c: look_at(time_s, values[:, k], run.sources[c].column, run.sources[c].unit) for k, c in enumerate(names)
    }
    missing = _gaps_in_all(time_s, values, list(channels.values()))
    return Look(name, time_s, values, channels, run.zero, tuple(missing), run.unread, (*notes, *said))


def _gaps_in_all(time_s: Array, values: Array, channels: Sequence[Channel]) -> list[Stretch]:
    """Gaps that all channels have that were read more than once; a constant of the sidecar was never read."""
    read = [k for k, channel in enumerate(channels) if channel.column and channel.readings > 1]
    spans = [time_s[~np.isnan(values[:, k])][[0, -1]] for k in read]
    return in_all([channels[k].gaps for k in read], [s[0] for s in spans], [s[1] for s in spans]) if read else []


def _channel_as_json(channel: Channel) -> dict[str, Any]:
    stretches = {key: [_as_json(s) for s in getattr(channel, key)] for key in ("gaps", "stuck", "clipped")}
    return {**asdict(channel), **stretches}


def _as_json(stretch: Stretch) -> dict[str, float]:
    return {key: value for key, value in stretch._asdict().items() if value is not None}
