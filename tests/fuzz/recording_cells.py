"""Mutators of a recording's columns and cells."""

from __future__ import annotations

import numpy as np

from fuzz.cases import CLOSE_OR_TOLD, ORDERLY, REFUSED, SAME, SAME_OR_REFUSED, TOLD, Shelf, pick
from fuzz.given import TIME, Given

CELLS: Shelf[Given] = Shelf()
mutator = CELLS
AWKWARD_NAMES = (
    "[red]x[/red]", "[/]", "$\\frac{1}{", "<b>x</b>", "a,b", 'say "x"', "x\ny", "$(ls)", "{0}", "%s", "_x", "x" * 3000,
    "T°", "time", "index", "Unnamed: 0", "\x1b[2J", "true_p_dis_bar", "__class__", "=1+1",
)  # fmt: skip


@mutator(SAME)
def columns_in_another_order(given: Given, rng: np.random.Generator) -> None:
    given.frame = given.frame[list(rng.permutation(given.frame.columns))]


@mutator(SAME)
def another_column_besides(given: Given, rng: np.random.Generator) -> None:
    given.frame.insert(int(rng.integers(3)), "operator", pick(rng, ("Eve", 1.5, np.nan, "", "x,y")))


@mutator(SAME)
def an_index_column(given: Given, rng: np.random.Generator) -> None:
    given.to_text = lambda frame: frame.to_csv()


@mutator(SAME)
def another_column_of_awkward_name(given: Given, rng: np.random.Generator) -> None:
    given.frame[pick(rng, AWKWARD_NAMES)] = 1.0


@mutator(SAME)
def truth_of_another_machine_besides(given: Given, rng: np.random.Generator) -> None:
    given.frame["true_capacity"] = rng.random(len(given.frame))


@mutator(TOLD, simulate=ORDERLY)
def two_columns_swapped(given: Given, rng: np.random.Generator) -> None:
    a, b = rng.choice(given.machine.channels, 2, replace=False)
    given.frame[[a, b]] = given.frame[[b, a]].to_numpy()


@mutator(TOLD, simulate=ORDERLY)
def names_shifted_by_one(given: Given, rng: np.random.Generator) -> None:
    channels = list(given.machine.channels)
    given.frame[channels] = given.frame[channels[1:] + channels[:1]].to_numpy()


@mutator(TOLD, simulate=ORDERLY)
def a_column_shuffled(given: Given, rng: np.random.Generator) -> None:
    channel = given.moving(rng)
    given.frame[channel] = rng.permutation(given.frame[channel])


@mutator(TOLD, simulate=ORDERLY)
def all_columns_shuffled(given: Given, rng: np.random.Generator) -> None:
    for channel in given.machine.channels:
        given.frame[channel] = rng.permutation(given.frame[channel])


@mutator(TOLD, simulate=ORDERLY)
def a_column_of_noise(given: Given, rng: np.random.Generator) -> None:
    """Of the right size, and of nothing."""
    channel = given.moving(rng)
    values = given.frame[channel]
    size = max(3.0 * values.std(), 0.05 * abs(values.mean()))
    given.frame[channel] = values.mean() + size * rng.standard_normal(len(values))


@mutator(CLOSE_OR_TOLD, mismatch=TOLD, simulate=ORDERLY)
def an_output_emptied(given: Given, rng: np.random.Generator) -> None:
    """From the other two an estimator may know what it says it knows."""
    given.frame[str(rng.choice(given.machine.outputs))] = np.nan


@mutator(TOLD, simulate=ORDERLY)
def all_outputs_emptied(given: Given, rng: np.random.Generator) -> None:
    given.frame[list(given.machine.outputs)] = np.nan


@mutator(TOLD)
def an_input_emptied(given: Given, rng: np.random.Generator) -> None:
    given.frame[str(rng.choice(given.machine.inputs))] = np.nan


@mutator(TOLD)
def every_channel_emptied(given: Given, rng: np.random.Generator) -> None:
    given.frame[list(given.machine.channels)] = np.nan


@mutator(REFUSED)
def an_input_dropped(given: Given, rng: np.random.Generator) -> None:
    given.frame = given.frame.drop(columns=str(rng.choice(given.machine.inputs)))


@mutator(TOLD, simulate=ORDERLY)
def an_output_dropped(given: Given, rng: np.random.Generator) -> None:
    given.frame = given.frame.drop(columns=str(rng.choice(given.machine.outputs)))


@mutator(REFUSED)
def an_input_renamed(given: Given, rng: np.random.Generator) -> None:
    channel = str(rng.choice(given.machine.inputs))
    given.frame = given.frame.rename(columns={channel: pick(rng, (*AWKWARD_NAMES, channel.upper(), channel + "2"))})


@mutator(REFUSED)
def a_column_twice(given: Given, rng: np.random.Generator) -> None:
    """With other numbers: which of them is meant?"""
    channel = given.channel(rng)
    given.frame.insert(len(given.frame.columns), channel, 1.1 * given.frame[channel], allow_duplicates=True)


@mutator(TOLD, mismatch=ORDERLY, simulate=ORDERLY)
def a_pressure_or_speed_off_by_ten(given: Given, rng: np.random.Generator) -> None:
    scalable = [c for c in given.machine.channels if not c.startswith("T_")]
    given.frame[str(rng.choice(scalable))] *= pick(rng, (10.0, 0.1))


@mutator(TOLD, mismatch=ORDERLY, simulate=ORDERLY)
def another_unit_untold(given: Given, rng: np.random.Generator) -> None:
    channel = given.channel(rng)
    _, factor, offset = pick(rng, given.machine.others[channel])
    given.frame[channel] = (given.frame[channel] + offset) * factor


@mutator(TOLD, mismatch=ORDERLY, simulate=ORDERLY)
def gauge_for_absolute(given: Given, rng: np.random.Generator) -> None:
    pressures = [c for c in given.machine.channels if c.startswith("p_")] or list(given.machine.outputs)
    for channel in pick(rng, ([pressures[0]], [pressures[-1]], pressures)):
        given.frame[channel] -= 1.01325


@mutator(TOLD, simulate=ORDERLY)
def a_sign_turned(given: Given, rng: np.random.Generator) -> None:
    given.frame[given.channel(rng)] *= -1.0


@mutator(TOLD, mismatch=ORDERLY, simulate=ORDERLY)
def an_output_stands_still(given: Given, rng: np.random.Generator) -> None:
    channel = str(rng.choice(given.machine.outputs))
    given.frame[channel] = given.frame[channel].iloc[0]


@mutator(REFUSED)
def text_in_a_cell(given: Given, rng: np.random.Generator) -> None:
    given.cells()
    texts = (
        "#REF!",
        "1,5",
        "0x1F",
        "1.2.3",
        "--",
        "bad",
        "[red]",
        "1e",
        "٣",
        "1_000",
        "$x^2$",
        "True",
        "12 bar",
        "\x1b[31m",
    )
    given.frame.loc[int(rng.integers(len(given.frame))), given.channel(rng)] = pick(rng, texts)


@mutator(CLOSE_OR_TOLD)
def words_for_missing(given: Given, rng: np.random.Generator) -> None:
    given.cells()
    rows = rng.integers(0, len(given.frame), 5)
    given.frame.loc[rows, given.channel(rng)] = pick(rng, ("NaN", "n/a", "NA", "null", "None", "-", "?", " "))


@mutator(REFUSED)
def infinities(given: Given, rng: np.random.Generator) -> None:
    given.cells()
    given.frame.loc[int(rng.integers(len(given.frame))), given.channel(rng)] = pick(rng, ("inf", "-Infinity", "1e999"))


@mutator(CLOSE_OR_TOLD)
def absurd_numbers(given: Given, rng: np.random.Generator) -> None:
    size = pick(rng, (1e308, -1e308, 1e30, -1e9, 1e18, 5e-324, 99999.0))
    given.frame.loc[int(rng.integers(len(given.frame))), given.channel(rng)] = size


@mutator(TOLD)
def a_whole_column_absurd(given: Given, rng: np.random.Generator) -> None:
    given.frame[given.channel(rng)] = pick(rng, (1e308, -1e300, 1e30, 1e200))


@mutator(SAME_OR_REFUSED)
def an_integer_of_many_digits(given: Given, rng: np.random.Generator) -> None:
    given.cells()
    given.frame["serial"] = "9" * int(rng.integers(20, 5000))


@mutator(CLOSE_OR_TOLD)
def cells_missing(given: Given, rng: np.random.Generator) -> None:
    share = rng.uniform(0.01, 0.6)
    for channel in given.machine.channels:
        given.frame.loc[rng.random(len(given.frame)) < share, channel] = np.nan


@mutator(CLOSE_OR_TOLD)
def spikes(given: Given, rng: np.random.Generator) -> None:
    channel = given.channel(rng)
    rows = rng.integers(0, len(given.frame), 5)
    given.frame.loc[rows, channel] += rng.choice((-8.0, 8.0)) * given.frame[channel].std()


@mutator(SAME)
def more_digits_than_a_float_has(given: Given, rng: np.random.Generator) -> None:
    given.to_text = lambda frame: frame.map(lambda v: f"{v:.40f}").to_csv(index=False)


@mutator(CLOSE_OR_TOLD)
def few_digits(given: Given, rng: np.random.Generator) -> None:
    digits = int(rng.integers(4, 7))
    given.to_text = lambda frame: frame.to_csv(index=False, float_format=f"%.{digits}g")
    given.frame[TIME] = given.frame[TIME].round(3)


@mutator(CLOSE_OR_TOLD)
def single_precision(given: Given, rng: np.random.Generator) -> None:
    given.name = "day.parquet"
    given.frame = given.frame.astype(dict.fromkeys(given.machine.channels, np.float32))


@mutator(ORDERLY)
def whole_numbers(given: Given, rng: np.random.Generator) -> None:
    channel = given.channel(rng)
    given.frame[channel] = given.frame[channel].round()


@mutator(TOLD, simulate=ORDERLY)
def numbers_as_truth_values(given: Given, rng: np.random.Generator) -> None:
    channel = given.channel(rng)
    given.frame[channel] = given.frame[channel] > given.frame[channel].median()


@mutator(REFUSED, look=REFUSED)
def no_time(given: Given, rng: np.random.Generator) -> None:
    given.frame = given.frame.drop(columns=TIME)
