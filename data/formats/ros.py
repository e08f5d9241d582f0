"""ROS bags and MCAP, by rosbags: each topic at the times at which its messages were logged."""

from __future__ import annotations

import functools
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from twinbench.common.shown import bare
from twinbench.data.formats import holdings
from twinbench.data.formats.holdings import Holdings, Zero, library, too_large
from twinbench.data.formats.united import NANOSECONDS, Series, united

LONGEST_ARRAY = 64
"""Numbers of an array that become columns of their own; longer ones are pictures and scans."""
_HEADER = "std_msgs/msg/Header"
"""The part of a message that says when and where it was made; no reading."""


def read(path: Path) -> Holdings:
    """The numbers of every topic, a column for each: ``/topic/field.part``, an array's ``/topic/field[0]`` and so on.

    Raises:
        BadInput: rosbags is not installed, too large, or no numbers.
    """
    highlevel = library("rosbags.highlevel", "rosbags", "ros", path)
    usual = None
    if path.suffix == ".db3":  # before ROS Iron such a bag did not hold the definitions of its messages
        usual = _usual_types(library("rosbags.typesys", "rosbags", "ros", path))
    with highlevel.AnyReader([path], default_typestore=usual) as bag:
        if bag.message_count > holdings.MOST_CELLS:
            raise too_large(path, bag.message_count, 1)
        zero_ns, found, unread = bag.start_time, [], []
        for topic in sorted({c.topic for c in bag.connections}):
            connections = [c for c in bag.connections if c.topic == topic]
            if columns := _columns(bag, connections, zero_ns):
                found += columns
            elif bag.topics[topic].msgcount:
                unread.append(topic)
    left_out = (f"topics without numbers ({', '.join(map(bare, unread[:5]))})",) if unread else ()
    return Holdings(united(path, found), {}, Zero(zero_ns, utc=True), left_out)


@functools.cache
def _usual_types(typesys: Any) -> Any:
    """The messages that ROS itself defines, which take a moment to make."""
    return typesys.get_typestore(typesys.Stores.LATEST)


def _columns(bag: Any, connections: list[Any], zero_ns: int) -> list[Series]:
    """A topic's numbers at its times, NaN where a message lacks one. Of messages logged at once the last counts."""
    import pandas as pd

    alike: dict[tuple[str, ...], tuple[array[int], array[float]]] = {}  # messages with the same numbers
    for connection, stamp, raw in bag.messages(connections=connections):
        found = dict(_numbers(bag.deserialize(raw, connection.msgtype), f"{connection.topic}/"))
        stamps, values = alike.setdefault(tuple(found), (array("q"), array("d")))
        stamps.append(stamp)
        values.extend(found.values())
    tables = [
        pd.DataFrame(np.reshape(values, (len(stamps), len(names))), index=np.array(stamps), columns=list(names))
        for names, (stamps, values) in alike.items()
        if names
    ]
    if not tables:
        return []
    table = pd.concat(tables).sort_index(kind="stable") if len(tables) > 1 else tables[0]
    table = table[~table.index.duplicated(keep="last")]
    time_s = (table.index.to_numpy() - zero_ns) / NANOSECONDS
    return [Series("", str(name), time_s, table[name].to_numpy()) for name in table]


def _numbers(message: Any, name: str) -> Iterator[tuple[str, float]]:
    """Every number in a message, by name."""
    for field in message.__dataclass_fields__:
        yield from _numbers_of(getattr(message, field), f"{name}{field}")


def _numbers_of(value: Any, name: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, int | float | np.number | np.bool_):
        yield name, float(value)
    elif isinstance(value, np.ndarray | list):
        if len(value) <= LONGEST_ARRAY:
            for k, part in enumerate(value):
                yield from _numbers_of(part, f"{name}[{k}]")
    elif not isinstance(value, str) and value.__msgtype__ != _HEADER:
        yield from _numbers(value, f"{name}.")
