"""Mutators of what names a recording's columns: ``--map`` and the TOML file beside it."""

from __future__ import annotations

import json

import numpy as np

from fuzz.cases import CLOSE_OR_TOLD, ORDERLY, REFUSED, SAME, SAME_OR_REFUSED, TOLD, Shelf, pick
from fuzz.given import TIME, Given
from fuzz.recording_cells import AWKWARD_NAMES

NAMES: Shelf[Given] = Shelf()
mutator = NAMES
BAD_UNITS = (
    "flurb", "kg/", "(", "5 psi", "kg/h)", "10**10**10", "bar**1e9", "2**2**2**2**2**2", "bar" * 500, "[[", "''", "m/0",
    "__import__('os')", "lambda: 1", "bar; import os", "µ" * 90, "9" * 400, "1e308 bar", "nan bar", "\\", "((((" * 200,
    "bar*" * 300 + "bar", "1/0 bar", "delta_degC*bar", "bar barg", "💥",
)  # fmt: skip
BAD_SIDECARS = (
    "channels = 3\n", "[channels\n", "[chanels]\n", "channels = [1, 2]\n", "[channels]\nno_channel = 'x'\n", "\x00",
    "a = " + "[" * 2000 + "]" * 2000, "[channels]\n" + "a." * 3000 + "b = 1\n", "[channels.x.y]\nz = 1\n",
    "x = 9" + "9" * 6000,
    "[channels]\n{c} = 7\n", "[channels]\n{c} = {{ colum = 'x' }}\n", "[channels]\n{c} = {{ unit = 7 }}\n",
    "[channels]\n{c} = ['x']\n", "[channels]\n{c} = ''\n", "[channels]\n{c} = {{ unit = '10**10**10' }}\n",
    "[channels]\n{c} = {{ column = 'gone' }}\n", "[channels]\n{c} = 1979-05-27\n", "[channels]\n{c} = nan\n",
    "[channels]\n{c} = 'a'\n{c} = 'b'\n", "= = =\n", "<xml/>",
    "rate_Hz = -1\n", "rate_Hz = nan\n", "rate_Hz = 1e9\n", "rate_Hz = 1e-9\n", "rate_Hz = [1]\n",
    "stamp = 'left'\naverage_s = 1\n", "stamp = 'end'\n", "stamp = {{}}\naverage_s = 1\n", "average_s = 'x'\n",
    "join = ['day.csv', 'next.csv']\n", "join = ['gone.csv']\n", "join = [7]\n", "join = ['.']\n", "join = '\\u0000'\n",
    "[constants]\n{c} = 'x'\n", "[constants]\nno_channel = 1.0\n", "[constants]\n{c} = inf\n", "time_zone = '/'\n",
    "[channels]\n{c} = 'x'\n[constants]\n{c} = 1.0\n", "time_zone = 'Mars'\n", "time_zone = 3\n",
)  # fmt: skip


@mutator(SAME)
def renamed_and_mapped(given: Given, rng: np.random.Generator) -> None:
    channel = given.channel(rng)
    given.frame = given.frame.rename(columns={channel: "PT101"})
    given.maps.append(f"PT101={channel}")


@mutator(SAME_OR_REFUSED)
def renamed_awkwardly_and_mapped(given: Given, rng: np.random.Generator) -> None:
    channel = given.channel(rng)
    names = ("PT 101", "PT[1]", "PT=101", "PT101[bar]", "µ", "PT[1][bar]", "=", "[", "]", "PT]101", *AWKWARD_NAMES)
    name = pick(rng, names)
    given.frame = given.frame.rename(columns={channel: name})
    given.maps.append(f"{name}={channel}")


@mutator(CLOSE_OR_TOLD)
def another_unit_told(given: Given, rng: np.random.Generator) -> None:
    channel = given.channel(rng)
    unit, factor, offset = pick(rng, given.machine.others[channel])
    given.frame[channel] = (given.frame[channel] + offset) * factor
    if rng.random() < 0.5:
        given.maps.append(f"{channel}[{unit}]={channel}")
    else:
        given.sidecar = f"[channels]\n{channel} = {{ unit = {json.dumps(unit)} }}\n"


@mutator(CLOSE_OR_TOLD)
def milliseconds_told(given: Given, rng: np.random.Generator) -> None:
    given.frame[TIME] *= 1e3
    given.maps.append(f"{TIME}[ms]={TIME}")


@mutator(TOLD, mismatch=ORDERLY, simulate=ORDERLY)
def a_unit_told_that_is_not(given: Given, rng: np.random.Generator) -> None:
    channel = given.channel(rng)
    unit, _, _ = pick(rng, given.machine.others[channel])
    given.maps.append(f"{channel}[{unit}]={channel}")


@mutator(REFUSED)
def a_unit_of_another_kind(given: Given, rng: np.random.Generator) -> None:
    given.maps.append(f"{given.channel(rng)}[mol*candela]={given.channel(rng)}")


@mutator(REFUSED)
def a_unit_that_is_none(given: Given, rng: np.random.Generator) -> None:
    channel = pick(rng, (*given.machine.channels, TIME))
    given.maps.append(f"{channel}[{pick(rng, BAD_UNITS)}]={channel}")


@mutator(REFUSED)
def one_column_for_two_channels(given: Given, rng: np.random.Generator) -> None:
    a, b = rng.choice(given.machine.channels, 2, replace=False)
    given.maps.append(f"{a}={b}")


@mutator(REFUSED)
def a_map_to_no_channel(given: Given, rng: np.random.Generator) -> None:
    given.maps.append(f"{given.channel(rng)}={pick(rng, (*AWKWARD_NAMES, 'p_discharge', '', ' '))}")


@mutator(REFUSED, look=REFUSED)
def a_map_of_no_column(given: Given, rng: np.random.Generator) -> None:
    given.maps.append(f"{pick(rng, ('PT999', '', ' ', '[bar]', '[]', '$x', 'PT[9]'))}={given.channel(rng)}")


@mutator(REFUSED, look=REFUSED)
def a_map_that_is_none(given: Given, rng: np.random.Generator) -> None:
    given.maps.append(pick(rng, ("", "=", "==", "x", "[]=", "p_dis_bar", "a=b=c", "=x", "[bar]")))


@mutator(SAME_OR_REFUSED)
def a_channel_mapped_twice(given: Given, rng: np.random.Generator) -> None:
    channel = given.channel(rng)
    given.maps += [f"{channel}={channel}"] * 2


@mutator(SAME)
def renamed_by_a_sidecar(given: Given, rng: np.random.Generator) -> None:
    channel = given.channel(rng)
    given.frame = given.frame.rename(columns={channel: "PT 101 [x]"})
    given.sidecar = f"[channels]\n{channel} = 'PT 101 [x]'\n"


@mutator(REFUSED)
def a_sidecar_that_is_none(given: Given, rng: np.random.Generator) -> None:
    given.sidecar = pick(rng, BAD_SIDECARS).replace("{c}", given.channel(rng)).replace("{{", "{").replace("}}", "}")


@mutator(REFUSED, look=REFUSED)
def a_sidecar_in_another_encoding(given: Given, rng: np.random.Generator) -> None:
    given.sidecar = f"[channels]\n{given.channel(rng)} = 'µ°'\n".encode(pick(rng, ("latin-1", "utf-16")))


@mutator(SAME)
def joined_of_two_files(given: Given, rng: np.random.Generator) -> None:
    half = len(given.frame) // 2
    given.beside[f"{given.stem}_more.csv"] = given.frame.iloc[half:]
    given.frame = given.frame.iloc[:half]
    given.sidecar = f"join = ['{given.stem}_more.csv']\n"


@mutator(REFUSED)
def joined_in_another_order(given: Given, rng: np.random.Generator) -> None:
    half = len(given.frame) // 2
    given.beside[f"{given.stem}_more.csv"] = given.frame.iloc[:half]
    given.frame = given.frame.iloc[half:]
    given.sidecar = f"join = ['{given.stem}_more.csv']\n"


@mutator(CLOSE_OR_TOLD, mismatch=ORDERLY, simulate=ORDERLY)
def means_at_a_lower_rate(given: Given, rng: np.random.Generator) -> None:
    own_Hz = 1.0 / float(given.frame[TIME].diff().median())
    given.sidecar = f"rate_Hz = {own_Hz / int(rng.integers(2, 6))!r}\n"


@mutator(CLOSE_OR_TOLD)
def stamps_of_means(given: Given, rng: np.random.Generator) -> None:
    period_s = float(given.frame[TIME].diff().median())
    given.sidecar = f"stamp = '{pick(rng, ('start', 'middle', 'end'))}'\naverage_s = {period_s!r}\n"


@mutator(CLOSE_OR_TOLD, mismatch=ORDERLY, simulate=ORDERLY)
def a_constant_in_the_place_of_a_channel(given: Given, rng: np.random.Generator) -> None:
    """Its median: right for what hardly moves; of anything else it has to be told."""
    channel = given.channel(rng)
    given.sidecar = f"[constants]\n{channel} = {float(given.frame[channel].median())!r}\n"


@mutator(SAME)
def a_sidecar_that_says_nothing(given: Given, rng: np.random.Generator) -> None:
    given.sidecar = pick(rng, ("", "# nothing\n", "[channels]\n", "\n\n"))
