"""Mutators of a recording's file: bytes, encoding, dialect, kind, size."""

from __future__ import annotations

import gzip

import numpy as np
import pandas as pd
from helpers.recording_kinds import ROS, WRITERS, maps_of

from fuzz.cases import ORDERLY, REFUSED, SAME, SAME_OR_REFUSED, Shelf, pick
from fuzz.given import TIME, Given

FILES: Shelf[Given] = Shelf()
mutator = FILES


@mutator(SAME)
def nothing(given: Given, rng: np.random.Generator) -> None:
    """The control: what is equal here is equal."""


@mutator(SAME)
def gzipped(given: Given, rng: np.random.Generator) -> None:
    given.name = "day.csv.gz"


@mutator(SAME)
def as_parquet(given: Given, rng: np.random.Generator) -> None:
    given.name = "day.parquet"


@mutator(SAME)
def crlf(given: Given, rng: np.random.Generator) -> None:
    given.to_text = lambda frame: frame.to_csv(index=False, lineterminator="\r\n")


@mutator(SAME_OR_REFUSED)
def carriage_returns_alone(given: Given, rng: np.random.Generator) -> None:
    given.encode = lambda text: text.replace("\n", "\r").encode()


@mutator(SAME)
def trailing_blank_lines(given: Given, rng: np.random.Generator) -> None:
    given.spoil = lambda data: data + b"\n" * int(rng.integers(1, 5))


@mutator(SAME)
def no_last_line_end(given: Given, rng: np.random.Generator) -> None:
    given.spoil = lambda data: data.rstrip(b"\n")


@mutator(SAME)
def byte_order_mark(given: Given, rng: np.random.Generator) -> None:
    given.encode = lambda text: text.encode("utf-8-sig")


@mutator(SAME)
def quoted_cells(given: Given, rng: np.random.Generator) -> None:
    given.to_text = lambda frame: frame.to_csv(index=False, quoting=1)


@mutator(SAME_OR_REFUSED)
def another_encoding(given: Given, rng: np.random.Generator) -> None:
    given.frame["µ"] = "°C"
    code = pick(rng, ("utf-16", "utf-32", "latin-1", "cp1252", "utf-16-le"))
    given.encode = lambda text: text.encode(code)


@mutator(REFUSED)
def semicolons_and_decimal_commas(given: Given, rng: np.random.Generator) -> None:
    given.to_text = lambda frame: frame.to_csv(index=False, sep=";", decimal=",")


@mutator(SAME_OR_REFUSED)
def another_separator(given: Given, rng: np.random.Generator) -> None:
    separator = pick(rng, "\t|; ")
    given.to_text = lambda frame: frame.to_csv(index=False, sep=separator)


@mutator(SAME_OR_REFUSED)
def comment_lines_on_top(given: Given, rng: np.random.Generator) -> None:
    given.encode = lambda text: ("# logger 7, site 3\n" * int(rng.integers(1, 4)) + text).encode()


@mutator(REFUSED)
def header_twice(given: Given, rng: np.random.Generator) -> None:
    given.to_text = lambda frame: (lambda t: t + t)(frame.to_csv(index=False))


@mutator(REFUSED)
def no_header(given: Given, rng: np.random.Generator) -> None:
    given.to_text = lambda frame: frame.to_csv(index=False, header=False)


@mutator(SAME_OR_REFUSED)
def spaces_after_commas(given: Given, rng: np.random.Generator) -> None:
    given.encode = lambda text: text.replace(",", ", ").encode()


@mutator(SAME_OR_REFUSED)
def spaces_in_the_header(given: Given, rng: np.random.Generator) -> None:
    spaces = pick(rng, (" ", "  ", "\t", "\u00a0"))
    given.frame = given.frame.rename(columns=lambda name: name + spaces if rng.random() < 0.5 else spaces + name)


@mutator(REFUSED, look=REFUSED)
def empty_file(given: Given, rng: np.random.Generator) -> None:
    given.name = pick(rng, ("day.csv", "day.csv.gz", "day.parquet"))
    given.spoil = lambda data: pick(rng, (b"", b"\n\n"))


@mutator(REFUSED)
def rows_cut_to_few(given: Given, rng: np.random.Generator) -> None:
    given.frame = given.frame.head(int(rng.integers(0, 8)))


@mutator(ORDERLY)
def cut_short(given: Given, rng: np.random.Generator) -> None:
    given.spoil = lambda data: data[: int(rng.integers(1, len(data)))]


@mutator(REFUSED, look=REFUSED)
def packed_and_cut_short(given: Given, rng: np.random.Generator) -> None:
    given.name = pick(rng, ("day.csv.gz", "day.parquet"))
    given.spoil = lambda data: data[: int(rng.integers(1, len(data) - 8))]


@mutator(REFUSED, look=REFUSED)
def garbage(given: Given, rng: np.random.Generator) -> None:
    given.name = pick(rng, ("day.csv", "day.csv.gz", "day.parquet"))
    given.spoil = lambda data: rng.bytes(int(rng.integers(1, 5000)))


@mutator(REFUSED, look=REFUSED)
def another_kind_of_file(given: Given, rng: np.random.Generator) -> None:
    fakes = (b"PK\x03\x04", b"%PDF-1.7\n", b"<html><body>", b'{"a": [1, 2]}', b"\x89PNG\r\n", b"\x00" * 300)
    start = pick(rng, fakes)
    given.spoil = lambda data: start + rng.bytes(200)


@mutator(REFUSED, look=REFUSED)
def kind_and_name_disagree(given: Given, rng: np.random.Generator) -> None:
    name = pick(rng, ("day.parquet", "day.csv.gz", "day.xlsx", "day", "day.CSV.bak"))
    given.spoil = lambda data: given.to_text(given.frame).encode()
    given.name = name


@mutator(ORDERLY)
def bytes_flipped(given: Given, rng: np.random.Generator) -> None:
    given.name = pick(rng, ("day.csv", "day.csv", "day.csv.gz", "day.parquet"))

    def spoil(data: bytes) -> bytes:
        spoilt = bytearray(data)
        for at in rng.integers(0, len(spoilt), int(rng.integers(1, 6))):
            spoilt[int(at)] ^= 1 << int(rng.integers(8))
        return bytes(spoilt)

    given.spoil = spoil


@mutator(ORDERLY)
def bytes_put_in_or_taken_out(given: Given, rng: np.random.Generator) -> None:
    def spoil(data: bytes) -> bytes:
        at = int(rng.integers(len(data)))
        return data[:at] + rng.bytes(int(rng.integers(0, 4))) + data[at + int(rng.integers(0, 4)) :]

    given.spoil = spoil


@mutator(ORDERLY)
def nul_bytes(given: Given, rng: np.random.Generator) -> None:
    given.spoil = lambda data: data[:200] + b"\x00" * int(rng.integers(1, 9)) + data[200:]


@mutator(REFUSED)
def a_cell_of_megabytes(given: Given, rng: np.random.Generator) -> None:
    given.cells()
    given.frame.loc[int(rng.integers(len(given.frame))), given.channel(rng)] = pick(rng, "9x[") * 3_000_000


@mutator(SAME_OR_REFUSED)
def a_column_of_long_text(given: Given, rng: np.random.Generator) -> None:
    given.frame["remarks"] = "x" * int(rng.integers(10, 3000))


@mutator(SAME_OR_REFUSED)
def very_many_columns(given: Given, rng: np.random.Generator) -> None:
    more = {f"tag{i}": np.zeros(len(given.frame)) for i in range(500)}
    given.frame = pd.concat([given.frame, pd.DataFrame(more)], axis=1)


@mutator(SAME_OR_REFUSED)
def a_bomb_in_gzip(given: Given, rng: np.random.Generator) -> None:
    """A hundred megabytes of blank lines behind it."""
    given.name = "day.csv.gz"
    given.spoil = lambda data: data + gzip.compress(b"\n" * 100_000_000, 9, mtime=0)


@mutator(SAME)
def awkward_file_name(given: Given, rng: np.random.Generator) -> None:
    stems = (
        "[red]day[/]",
        "day 1",
        "Tag-ä°µ",
        "$x^2$",
        "a;b&c",
        "-day",
        "day.1.2",
        "'day'",
        "日",
        "%s{0}",
    )
    given.name = f"{pick(rng, stems)}.{pick(rng, ('csv', 'csv.gz', 'parquet'))}"


@mutator(SAME_OR_REFUSED)
def a_file_name_that_no_result_can_have(given: Given, rng: np.random.Generator) -> None:
    stem = pick(rng, ("day\x1b[31m", ".day", "day\n", "day\u202e", "day" * 80))
    given.name = f"{stem}.csv"


@mutator(SAME)
def numbers_as_text_in_parquet(given: Given, rng: np.random.Generator) -> None:
    given.name = "day.parquet"
    given.frame = given.frame.map(lambda value: repr(value) if value == value else None)


@mutator(SAME)
def dates_in_parquet(given: Given, rng: np.random.Generator) -> None:
    given.name = "day.parquet"
    given.frame[TIME] = pd.Timestamp("2026-03-01") + pd.to_timedelta(given.frame[TIME], unit="s")


def as_kind(given: Given, kind: str) -> None:
    """The recording as a file of another kind, with a sidecar where that names its columns itself."""
    given.name = f"day{kind}"
    pairs = [item.rsplit("=", 1) for item in maps_of(kind, list(given.machine.channels))]
    given.sidecar = "\n".join(["[channels]", *(f"{channel} = '{column}'" for column, channel in pairs)])


def _as(kind: str) -> None:
    FILES.add(f"as_{kind[1:]}", lambda given, rng: as_kind(given, kind), SAME)


for _kind in WRITERS:
    _as(_kind)


@mutator(ORDERLY)
def another_kind_cut_short(given: Given, rng: np.random.Generator) -> None:
    as_kind(given, pick(rng, WRITERS))
    given.spoil = lambda data: data[: int(rng.integers(1, len(data)))]


@mutator(ORDERLY)
def another_kind_with_bytes_flipped(given: Given, rng: np.random.Generator) -> None:
    as_kind(given, pick(rng, WRITERS))
    given.spoil = lambda data: flipped(data, rng)


def flipped(data: bytes, rng: np.random.Generator) -> bytes:
    """A few bits turned, most of them where the file says what it holds."""
    spoilt = bytearray(data)
    end = len(data) if rng.random() < 0.3 else min(len(data), 3000)
    for at in rng.integers(0, end, int(rng.integers(1, 6))):
        spoilt[int(at)] ^= 1 << int(rng.integers(8))
    return bytes(spoilt)


@mutator(REFUSED, look=REFUSED)
def another_kind_of_garbage(given: Given, rng: np.random.Generator) -> None:
    given.name = f"day{pick(rng, WRITERS)}"
    given.spoil = lambda data: rng.bytes(int(rng.integers(1, 5000)))


@mutator(REFUSED, look=REFUSED)
def another_kind_by_name_only(given: Given, rng: np.random.Generator) -> None:
    given.name, given.spoil = f"day{pick(rng, WRITERS)}", lambda data: given.to_text(given.frame).encode()


@mutator(REFUSED)
def a_bag_without_the_topic(given: Given, rng: np.random.Generator) -> None:
    as_kind(given, pick(rng, ROS))
    given.sidecar = str(given.sidecar).replace(f"/{given.machine.channels[0]}/data", "/tank/data")


@mutator(REFUSED)
def another_kind_whose_time_goes_back(given: Given, rng: np.random.Generator) -> None:
    as_kind(given, pick(rng, [kind for kind in WRITERS if kind not in ROS]))  # a bag's messages are sorted by time
    given.frame = given.frame.iloc[::-1].reset_index(drop=True)
