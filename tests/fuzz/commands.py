"""How a case of each command is made: which inputs it reads, and which of them is spoilt how."""

from __future__ import annotations

import copy
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from helpers.tiny_profile import PROFILE

from fuzz.arguments import ARGUMENTS
from fuzz.cases import CLOSE_OR_TOLD, ORDERLY, REFUSED, SAME, SAME_OR_REFUSED, TOLD, Case, Mutator, generator
from fuzz.estimators import ESTIMATORS, MINE
from fuzz.finished_runs import RUNS
from fuzz.given import Given
from fuzz.models import MODEL, MODELS
from fuzz.profiles import PROFILES
from fuzz.recording_cells import CELLS
from fuzz.recording_files import FILES
from fuzz.recording_names import NAMES
from fuzz.recording_time import CLOCK
from fuzz.records import RECORDS
from fuzz.simulators import SIMULATORS, TANK
from fuzz.world import ESTIMATOR, EXPORTED, World

Made = tuple[list[str], tuple[str, ...]]
"""A command line, and the words of which a refusal has to hold one."""
CASES = 320
"""Of each command, in the whole fuzz."""
RECORDINGS = (*FILES.mutators, *CELLS.mutators, *CLOCK.mutators, *NAMES.mutators)


def write(path: Path, text: str) -> str:
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    return path.name


def good_files(folder: Path, world: World) -> None:
    """What stands in every case's folder."""
    write(folder / "tank.py", TANK)
    write(folder / "mine.py", MINE)
    write(folder / "a_file", "")
    write(folder / "tiny.toml", PROFILE)
    shutil.copy(world.profile, folder / "trained.toml")


def command_line(command: str, world: World, **spoilt: Any) -> list[str]:
    """The good command line, with those of its parts that are spoilt in their places."""
    trained = ["--profile", "trained.toml", "--results", str(spoilt.get("run", world.run))]
    recording, simulator = spoilt.get("recording", "day.csv"), spoilt.get("simulator", "tank.py")
    return {
        "estimate": ["estimate", ESTIMATOR, recording, "--out", "out", *trained],
        "simulate": ["simulate", "--simulator", simulator, "--inputs", recording, "--out", "out"],
        "mismatch": [
            "mismatch",
            simulator,
            recording,
            "--hold-out",
            spoilt.get("held_out", "next.csv"),
            "--out",
            "out",
        ],
        "list": ["list", "mechanisms", "--simulator", simulator, "--json"],
        "check": ["check", "mine.py", "--json"],
        "run": ["run", "--profile", "tiny.toml", "--only", "mine.py", "--out", "out"],
        "report": ["report", "run"],
        "export": ["export", "--out", "out", *trained, "--estimator", EXPORTED],
        "latency": ["latency", "--out", "out", *trained, "--estimator", ESTIMATOR, "--updates", "10", "--ticks", "0"],
        "tune": ["tune", "mine.py", "--profile", "tiny.toml", "--trials", "1", "--out", "out"],
        "look": ["look", recording, "--out", "out", "--json"],
        "fmu": ["fmu", simulator, "--out", "tank.fmu"],
        "record": ["record", ESTIMATOR, recording, "--out", "online.npz", "--every", "40", *trained],
        "replay": ["replay", "online.npz", "--json"],
        "schema": ["schema", "verdict"],
    }[command]


def machine_of(command: str) -> str:
    return "compressor" if command in ("estimate", "record") else "tank"


def with_recordings(folder: Path, world: World, command: str) -> None:
    """Good recordings, and the record of a run, as far as the command reads any."""
    if command in ("estimate", "simulate", "mismatch", "look", "record"):
        world.recording(machine_of(command)).write(folder)
    if command == "replay":
        shutil.copy(world.online, folder)
    if command == "mismatch":
        world.held_out.to_csv(folder / "next.csv", index=False)


def recording_case(command: str, mutator: Mutator[Any], folder: Path, world: World, rng: np.random.Generator) -> Made:
    with_recordings(folder, world, command)
    given = world.recording(machine_of(command))
    held = command == "mismatch" and rng.random() < 0.25
    if command == "mismatch" and mutator in NAMES.mutators:  # --map is for all recordings alike
        held, other = False, Given(given.machine, world.held_out.copy(), name="next.csv")
        mutator.spoil(other, copy.deepcopy(rng))
        other.write(folder)
    if held:
        given.frame, given.name = world.held_out.copy(), "next.csv"
    mutator.spoil(given, rng)
    if given.name.startswith("day") and held:
        given.name = "next" + given.name.removeprefix("day")
    given.write(folder)
    name = f"./{given.name}" if given.name.startswith("-") else given.name
    line = command_line(command, world, **{"held_out" if held else "recording": name})
    line += [f"--map={item}" for item in given.maps]
    return line, (given.stem, "day", "next", "--map", ".toml")


def text_case(command: str, mutator: Mutator[Any], folder: Path, world: World, rng: np.random.Generator) -> Made:
    """A simulator, a model, a profile or an estimator, whose file has the name that the command line holds."""
    with_recordings(folder, world, command)
    text, name, part = next(t for shelf, t in TEXTS if mutator in shelf.mutators)
    write(folder / name, mutator.spoil(text, rng))
    return command_line(command, world, **{part: name}), (
        name,
        "tank.py",
        "day.csv",
        "simulator",
        "mechanism",
        "mine",
        "profile",
        "estimator",
        "plug-in",
    )


def run_case(command: str, mutator: Mutator[Any], folder: Path, world: World, rng: np.random.Generator) -> Made:
    with_recordings(folder, world, command)
    shutil.copytree(world.unused, folder / "run")
    if command != "report":  # what is trained is all that they need: what is spoilt is among that
        shutil.rmtree(folder / "run" / "store" / "estimate")
    mutator.spoil(folder / "run", rng)
    return command_line(command, world, run="run"), ("run",)


def record_case(command: str, mutator: Mutator[Any], folder: Path, world: World, rng: np.random.Generator) -> Made:
    with_recordings(folder, world, command)
    mutator.spoil(folder / world.online.name, rng)
    return command_line(command, world), (world.online.name,)


def arguments_case(command: str, mutator: Mutator[Any], folder: Path, world: World, rng: np.random.Generator) -> Made:
    with_recordings(folder, world, command)
    if command == "report":
        shutil.copytree(world.unused, folder / "run")
    return mutator.spoil(command_line(command, world), rng), ("",)


TEXTS = (
    (SIMULATORS, (TANK, "tank.py", "simulator")),
    (MODELS, (MODEL, "model.toml", "simulator")),
    (PROFILES, (PROFILE, "tiny.toml", "profile")),
    (ESTIMATORS, (MINE, "mine.py", "estimator")),
)
Maker = Callable[[str, Mutator[Any], Path, World, np.random.Generator], Made]


def _all(maker: Maker, mutators: Any) -> list[tuple[Maker, Mutator[Any]]]:
    return [(maker, m) for m in mutators]


_RECORDINGS, _ARGUMENTS = _all(recording_case, RECORDINGS), _all(arguments_case, ARGUMENTS.mutators)
_SIMULATORS = _all(text_case, (*SIMULATORS.mutators, *MODELS.mutators))
_RUNS = _all(run_case, RUNS.mutators)
_FILELESS = [way for way in _ARGUMENTS if way[1].name != "a_file_that_is_not_there"]
_PARTS = [way for way in _RUNS if any(word in way[1].name for word in ("part", "seal", "store", "everything"))]
_REFUSED = [way for way in _ARGUMENTS if way[1].otherwise == REFUSED]
WAYS: dict[str, list[tuple[Maker, Mutator[Any]]]] = {
    "estimate": [*_RECORDINGS, *_RUNS, *_ARGUMENTS],
    "mismatch": [*_RECORDINGS, *_SIMULATORS, *_ARGUMENTS],
    "simulate": [*_RECORDINGS, *_SIMULATORS, *_ARGUMENTS],
    "list": [*_SIMULATORS, *_ARGUMENTS],
    "check": [*_all(text_case, ESTIMATORS.mutators), *_ARGUMENTS],
    "run": [*_all(text_case, (*PROFILES.mutators, *ESTIMATORS.mutators)), *_ARGUMENTS],
    "report": [*_RUNS, *_ARGUMENTS],
    "export": [*_RUNS, *_ARGUMENTS],
    "latency": [*_PARTS, *_REFUSED],  # an answer takes it half a minute
    "tune": [*_all(text_case, PROFILES.mutators), *_ARGUMENTS],
    "look": [*_RECORDINGS, *_ARGUMENTS],
    "fmu": [*_SIMULATORS, *_ARGUMENTS],
    "record": [*_RECORDINGS, *_RUNS, *_ARGUMENTS],
    "replay": [*_all(record_case, RECORDS.mutators), *_ARGUMENTS],
    "schema": _FILELESS,
}
"""For each command, every mutator of what it reads; cases go round them."""


def expected(command: str, maker: Maker, mutator: Mutator[Any]) -> str:
    """What may come of it: what a command does not judge, it need not tell.

    ``look`` and ``record`` take a recording as it is, and ``look`` knows no machine whose channels were missing in it.
    An FMU cannot hold all that a simulator may do.
    """
    expects = mutator.expected(command)
    if command in mutator.expects or maker not in (recording_case, text_case):
        return expects
    otherwise = {
        "look": {TOLD: ORDERLY, CLOSE_OR_TOLD: ORDERLY, REFUSED: ORDERLY},
        "record": {TOLD: ORDERLY, CLOSE_OR_TOLD: ORDERLY},
        "fmu": {SAME: SAME_OR_REFUSED},
    }
    return otherwise.get(command, {}).get(expects, expects)


def make(command: str, index: int, seed: int, folder: Path, world: World) -> Case:
    """Write the files of a case into its folder, which is made here."""
    rng = generator(command, index, seed)
    ways = WAYS[command]
    maker, mutator = ways[index % len(ways)]
    folder.mkdir()
    good_files(folder, world)
    line, names = maker(command, mutator, folder, world, rng)
    kind = maker.__name__.removesuffix("_case")
    if maker is text_case:
        kind = next(name.partition(".")[0] for shelf, (_, name, _) in TEXTS if mutator in shelf.mutators)
    return Case(
        command, index, f"{kind}: {mutator.name}", tuple(line), expected(command, maker, mutator), names, folder
    )


def unspoilt(command: str, folder: Path, world: World, model: bool = False) -> Case:
    """The good command line with good files, or with a good model.toml: what ``same`` compares with."""
    folder.mkdir()
    good_files(folder, world)
    with_recordings(folder, world, command)
    write(folder / "model.toml", MODEL)
    if command == "report":
        shutil.copytree(world.unused, folder / "run")
    line = command_line(command, world, **({"simulator": "model.toml"} if model else {}))
    return Case(command, -1, "unspoilt", tuple(line), SAME, ("",), folder)
