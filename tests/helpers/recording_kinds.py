"""One table as a file of every kind that holds recordings, written by the libraries that others write them with."""

from __future__ import annotations

import functools
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

TIME = "time_s"
BEGAN_NS = 1_772_366_400_000_000_000
"""2026-03-01T12:00:00Z, when files that know the date begin."""


def write_mat(frame: pd.DataFrame, path: Path, units: Mapping[str, str] = {}) -> None:
    from scipy.io import savemat

    savemat(path, {name: frame[name].to_numpy() for name in frame})


def write_mdf(frame: pd.DataFrame, path: Path, units: Mapping[str, str] = {}) -> None:
    """One group on the clock ``time_s``."""
    write_mdf_groups([frame], path, units)


def write_mdf_groups(frames: list[pd.DataFrame], path: Path, units: Mapping[str, str] = {}, **more: Any) -> None:
    """A group on a clock of its own for each table; ``more`` are arguments of every signal."""
    from asammdf import MDF, Signal

    file = MDF(version="4.10")
    for frame in frames:
        clock, names = frame[TIME].to_numpy(), [name for name in frame if name != TIME]
        signals = [Signal(frame[n].to_numpy(), clock, name=n, unit=units.get(n, ""), **more) for n in names]
        file.append(signals, common_timebase=True)
    file.header.abs_time, file.header.time_flags = BEGAN_NS, 2
    file.save(path, overwrite=True)
    file.close()


def write_tdms(frame: pd.DataFrame, path: Path, units: Mapping[str, str] = {}, **more: Any) -> None:
    """A channel for each column, the time among them; ``more`` are properties of every channel."""
    from nptdms import ChannelObject, TdmsWriter

    channels = []
    for name in frame:
        stated = {"unit_string": units[name]} if name in units else {}
        channels.append(ChannelObject("log", name, frame[name].to_numpy(), properties={**stated, **more}))
    with TdmsWriter(path) as file:
        file.write_segment(channels)


def write_bag(frame: pd.DataFrame, path: Path, units: Mapping[str, str] = {}) -> None:
    """A topic ``/NAME`` of ``Float64`` for each column; where a cell is empty there is no message."""
    store = _types(ros1=path.suffix == ".bag")
    number = store.types["std_msgs/msg/Float64"]
    with _ros_writer(path) as file:
        for name in (n for n in frame if n != TIME):
            topic = file.add_connection(f"/{name}", number.__msgtype__, typestore=store)
            for time_s, value in frame[[TIME, name]].dropna().itertuples(index=False):
                pack = store.serialize_ros1 if path.suffix == ".bag" else store.serialize_cdr
                message = pack(number(float(value)), number.__msgtype__)
                file.write(topic, BEGAN_NS + round(time_s * 1e9), message)
    if path.suffix != ".bag":
        (written,) = _folder(path).glob(f"*{path.suffix}")
        shutil.move(written, path)
        shutil.rmtree(_folder(path))


@functools.cache
def _types(ros1: bool) -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)


def _folder(path: Path) -> Path:
    return path.with_name(path.name + ".folder")


def _ros_writer(path: Path) -> Any:
    if path.suffix == ".bag":
        from rosbags.rosbag1 import Writer as Writer1

        return Writer1(path)
    from rosbags.rosbag2 import StoragePlugin, Writer

    plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
    return Writer(_folder(path), version=9, storage_plugin=plugin)


WRITERS: dict[str, Callable[..., None]] = {
    ".mat": write_mat,
    ".mf4": write_mdf,
    ".tdms": write_tdms,
    ".mcap": write_bag,
    ".db3": write_bag,
    ".bag": write_bag,
}
"""By the end of a file's name."""
ROS = (".mcap", ".db3", ".bag")


def maps_of(kind: str, names: list[str]) -> list[str]:
    """The ``--map`` that a kind of file needs because it names its columns itself."""
    return [f"/{name}/data={name}" for name in names] if kind in ROS else []


def as_read(frame: pd.DataFrame, kind: str) -> np.ndarray:
    """Times that a file of this kind holds: a bag counts whole nanoseconds from its first message."""
    time_s = frame[TIME].to_numpy()
    if kind not in ROS:
        return time_s
    whole = np.array([round(t * 1e9) for t in time_s])
    return (whole - whole[0]) / 1e9
