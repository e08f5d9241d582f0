"""Mutators of a recording's clock."""

from __future__ import annotations

import numpy as np
import pandas as pd

from fuzz.cases import CLOSE_OR_TOLD, ORDERLY, REFUSED, SAME, TOLD, Shelf, pick
from fuzz.given import TIME, Given

CLOCK: Shelf[Given] = Shelf()
mutator = CLOCK


@mutator(SAME)
def clock_starts_elsewhere(given: Given, rng: np.random.Generator) -> None:
    given.frame[TIME] += pick(rng, (-1000.0, 86400.0, 1e6))


@mutator(SAME)
def dates_with_a_zone(given: Given, rng: np.random.Generator) -> None:
    begin = pd.Timestamp("2026-03-29T00:59:30", tz=pick(rng, ("UTC", "Europe/Berlin", "Asia/Kolkata")))
    given.frame[TIME] = [t.isoformat() for t in begin + pd.to_timedelta(given.frame[TIME], unit="s")]


@mutator(REFUSED)
def dates_of_which_some_have_a_zone(given: Given, rng: np.random.Generator) -> None:
    begin = pd.Timestamp("2026-03-01T12:00:00")
    given.frame[TIME] = [t.isoformat() for t in begin + pd.to_timedelta(given.frame[TIME], unit="s")]
    given.frame.loc[int(rng.integers(len(given.frame))), TIME] += pick(rng, ("Z", "+01:00"))


@mutator(CLOSE_OR_TOLD)
def clock_of_the_epoch(given: Given, rng: np.random.Generator) -> None:
    given.frame[TIME] += 1.7e9 + rng.random()


@mutator(CLOSE_OR_TOLD)
def stamps_jitter(given: Given, rng: np.random.Generator) -> None:
    period = float(given.frame[TIME].diff().median())
    given.frame[TIME] += rng.uniform(-0.2, 0.2, len(given.frame)) * period


@mutator(TOLD, mismatch=ORDERLY, simulate=ORDERLY)
def milliseconds_untold(given: Given, rng: np.random.Generator) -> None:
    given.frame[TIME] *= pick(rng, (1e3, 1e6, 1e9))


@mutator(CLOSE_OR_TOLD, mismatch=ORDERLY, simulate=ORDERLY)
def minutes_untold(given: Given, rng: np.random.Generator) -> None:
    given.frame[TIME] /= 60.0


@mutator(CLOSE_OR_TOLD, mismatch=ORDERLY, simulate=ORDERLY)
def sampled_more_slowly(given: Given, rng: np.random.Generator) -> None:
    given.frame = given.frame.iloc[:: int(rng.integers(2, 120))]


@mutator(CLOSE_OR_TOLD)
def a_gap(given: Given, rng: np.random.Generator) -> None:
    n = len(given.frame)
    begin = int(rng.integers(n // 4, n // 2))
    given.frame = given.frame.drop(index=given.frame.index[begin : begin + n // 4])


@mutator(TOLD, mismatch=ORDERLY, simulate=ORDERLY)
def a_long_gap(given: Given, rng: np.random.Generator) -> None:
    """The second half comes an hour, a day, a year later."""
    later = pick(rng, (3600.0, 86400.0, 3.15e7, 3.15e10))
    given.frame.loc[len(given.frame) // 2 :, TIME] += later


@mutator(REFUSED, look=REFUSED)
def backwards(given: Given, rng: np.random.Generator) -> None:
    given.frame = given.frame.iloc[::-1]


@mutator(ORDERLY)
def the_film_runs_backwards(given: Given, rng: np.random.Generator) -> None:
    channels = list(given.machine.channels)
    given.frame[channels] = given.frame[channels].to_numpy()[::-1]


@mutator(REFUSED, look=REFUSED)
def rows_repeated(given: Given, rng: np.random.Generator) -> None:
    row = int(rng.integers(1, len(given.frame)))
    given.frame = pd.concat([given.frame.iloc[:row], given.frame.iloc[row - 1 :]])


@mutator(REFUSED, look=REFUSED)
def rows_out_of_order(given: Given, rng: np.random.Generator) -> None:
    given.frame = given.frame.iloc[rng.permutation(len(given.frame))]


@mutator(REFUSED, look=REFUSED)
def the_clock_is_set_back(given: Given, rng: np.random.Generator) -> None:
    given.frame.loc[len(given.frame) // 2 :, TIME] -= rng.uniform(0.2, 1.0) * given.frame[TIME].iloc[-1]


@mutator(REFUSED, look=REFUSED)
def the_clock_stands(given: Given, rng: np.random.Generator) -> None:
    given.frame[TIME] = 3.0


@mutator(REFUSED, look=REFUSED)
def a_stamp_missing(given: Given, rng: np.random.Generator) -> None:
    given.frame.loc[int(rng.integers(len(given.frame))), TIME] = np.nan


@mutator(REFUSED, look=REFUSED)
def stamps_that_are_no_numbers(given: Given, rng: np.random.Generator) -> None:
    given.cells()
    texts = ("2026-03-01T12:00:00", "12:00", "now", "1e400", "-inf", "0,05", "[b]")
    given.frame.loc[int(rng.integers(len(given.frame))), TIME] = pick(rng, texts)


@mutator(REFUSED, look=REFUSED)
def dates_that_are_none(given: Given, rng: np.random.Generator) -> None:
    given.frame[TIME] = [f"2026-03-01T12:00:{s:06.3f}Z" for s in given.frame[TIME] % 60.0]
    odd = ("2026-02-30T12:00:00Z", "2026-03-01T25:00:00Z", "0000-00-00", "99999-01-01T00:00:00Z", "2026-03-01", "now")
    given.frame.loc[int(rng.integers(1, len(given.frame))), TIME] = pick(rng, odd)


@mutator(REFUSED)
def stamps_beyond_reckoning(given: Given, rng: np.random.Generator) -> None:
    given.frame[TIME] *= pick(rng, (1e20, 1e300, 1e306))


@mutator(REFUSED)
def a_last_stamp_far_away(given: Given, rng: np.random.Generator) -> None:
    given.frame.loc[len(given.frame) - 1, TIME] = pick(rng, (1e12, 1e18, 1e300, 1.7e308))


@mutator(TOLD, mismatch=ORDERLY, simulate=ORDERLY)
def stamps_too_fine(given: Given, rng: np.random.Generator) -> None:
    given.frame[TIME] *= pick(rng, (1e-3, 1e-6, 1e-12))
