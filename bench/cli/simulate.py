"""``twinbench simulate``: recordings of the benchmark, or of a user's simulator."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli.output import tell_files
from twinbench.bench.cli.parser import SIMULATOR_HELP, add_machine, add_map, add_trust

SAYS = "write the benchmark's recordings of a machine, or what a simulator of yours makes of recorded inputs"
EXAMPLE = (
    "twinbench simulate --out recordings\n"
    "  twinbench simulate --machine my_machine.py --out recordings\n"
    "  twinbench simulate --simulator tanks.py --inputs day4.csv --out replayed"
)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the recordings")
    add_machine(parser)
    parser.add_argument("--simulator", metavar="SIMULATOR", help=SIMULATOR_HELP)
    add_trust(parser)
    parser.add_argument(
        "--inputs",
        nargs="+",
        default=(),
        type=Path,
        metavar="RECORDING",
        help="recordings whose inputs drive --simulator, which starts from their first readings",
    )
    add_map(parser)
    parser.add_argument("--profile", default="quick", help="write the data of this profile (default: quick)")
    parser.add_argument(
        "--part",
        choices=("train", "validation", "calibration", "test"),
        default="test",
        help="split to write (default: test)",
    )
    parser.add_argument(
        "--format", choices=("csv", "parquet"), default="csv", help="format of the files (default: csv)"
    )
    parser.add_argument("--no-truth", action="store_true", help="leave out the columns of the true states and health")


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from twinbench.common.errors import BadInput

    if bool(a.simulator) != bool(a.inputs):
        raise BadInput("--simulator and --inputs go together; give the recordings that drive it with --inputs")
    if a.simulator and a.machine != "compressor":
        raise BadInput("--simulator is driven by recorded inputs, --machine by its own loads; give one of the two")
    if a.simulator:
        from twinbench.mismatch.replay import replay

        tell_files(a, replay(a.simulator, a.inputs, a.out, a.map, a.format, a.trust))
        return 0
    return _simulate_benchmark(a)


def _simulate_benchmark(a: argparse.Namespace) -> int:
    from functools import partial

    from twinbench.bench.profile import load_profile
    from twinbench.common.store import write_atomically
    from twinbench.data.benchmark import design, run
    from twinbench.data.recording import truth_table
    from twinbench.machines.load import load_machine

    machine = load_machine(a.machine)
    profile = load_profile(a.profile)
    scenarios = design(profile.data, machine)[a.part]
    for scenario in scenarios:
        batch = run((scenario,), profile.data.warmup_minutes, profile.corruption)
        table = truth_table(batch.without_truth() if a.no_truth else batch, 0)
        write = table.to_csv if a.format == "csv" else table.to_parquet
        write_atomically(a.out / f"{scenario.name}.{a.format}", partial(write, index=False))
    if a.json:
        tell_files(a, [a.out / f"{scenario.name}.{a.format}" for scenario in scenarios])
    else:
        print(f"{len(scenarios)} recordings in {a.out}")
    return 0
