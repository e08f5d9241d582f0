"""The ``twinbench`` command: its parser, and how it ends. Heavy imports wait until a command needs them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from twinbench.bench.cli import (
    check,
    compare,
    complete,
    design,
    estimate,
    export,
    flagship,
    fleet,
    fmu,
    latency,
    listing,
    look,
    machines,
    mismatch,
    prove,
    record,
    replay,
    report,
    run,
    schema,
    simulate,
    tune,
)
from twinbench.bench.cli.parser import VERBOSE_HELP, Parser, Version, add_backend
from twinbench.bench.cli.surroundings import Terminated, surroundings
from twinbench.common.threads import pin

pin()

COMMANDS = {
    "run": run,
    "list": listing,
    "check": check,
    "tune": tune,
    "simulate": simulate,
    "look": look,
    "estimate": estimate,
    "record": record,
    "replay": replay,
    "compare": compare,
    "machines": machines,
    "export": export,
    "mismatch": mismatch,
    "fleet": fleet,
    "design": design,
    "fmu": fmu,
    "prove": prove,
    "flagship": flagship,
    "report": report,
    "latency": latency,
    "schema": schema,
    "completion": complete,
}
PARALLEL = ("run", "mismatch", "design", "fleet", "prove", "flagship", "tune", "check", "compare")
SPREAD = ("run", "fleet", "prove", "flagship", "tune", "compare")
"""What a cluster can do, too."""
EPILOG = """examples:
  twinbench run --profile quick                    every estimator, in minutes
  twinbench run --only oracle nominal_ekf          two of them
  twinbench run --only oracle my_baseline.py       yours, from one file
  twinbench check my_baseline.py                   the contract every estimator keeps
  twinbench simulate --out recordings              the benchmark's recordings as CSV
  twinbench look plant.mf4 --out looked            what a recording holds, and a figure of it
  twinbench estimate deeponet_kalman plant.csv --out estimates --map PT101[psi]=p_dis_bar
  twinbench record deeponet_kalman plant.csv --out run.npz
                                                   an online run with all that went in and came out
  twinbench replay run.npz                         the same run again, equal to the bit or not
  twinbench export --out controller                the trained operator as ONNX, for a controller
  twinbench list mechanisms                        what a compressor model can leave out
  twinbench list mechanisms --simulator tanks.py   what mismatch looks for in yours
  twinbench mismatch tanks.py day1.csv day2.csv --hold-out day3.csv --out found
                                                   what your simulator leaves out, and proof of it
  twinbench fleet tanks.py plant1 plant2 plant3 --out fleet
                                                   what all of them lack, and which are unlike the others
  twinbench design tanks.py --verdict found/verdict.json --inputs limits.toml --out next
                                                   the experiment that would settle it
  twinbench simulate --simulator found/model.toml --inputs day4.csv --out replayed
  twinbench fmu found/model.toml --out mended.fmu  the mended simulator for other tools, as an FMU
  twinbench schema verdict                         what verdict.json holds, for programs
exit status:
    0  done
    1  a method, a check or a worker process failed; what was finished is kept
    2  bad input: one line says what and where, and nothing is written
    3  estimate: a result is not usable and was not written
   10  mismatch, fleet: something is wrong, and it has a name
   11  mismatch, fleet: something is wrong, and it has no name or is not named in full
  130  stopped with Ctrl-C (143 by SIGTERM); run the same command again to go on
completion of commands and options:
  eval "$(twinbench completion bash)"              likewise for zsh
  twinbench completion fish | source"""


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    parser = Parser(
        prog="twinbench",
        description="Which estimator keeps a machine's digital twin true, and how sure is that?",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", nargs=0, action=Version, help="print the version, and in a checkout the commit")
    parser.add_argument("-v", "--verbose", action="count", default=0, help=VERBOSE_HELP)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=Parser)
    for name, command in COMMANDS.items():
        added = commands.add_parser(
            name,
            help=command.SAYS,
            description=command.SAYS[0].upper() + command.SAYS[1:] + ".",
            epilog=f"example:\n  {command.EXAMPLE}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.add_options(added)
        if name in PARALLEL:
            says = "processes or threads at once (default: one per core); fewer need less memory"
            added.add_argument("--jobs", type=int, metavar="N", help=says)
        if name in SPREAD:
            add_backend(added)
        if name != "completion":
            added.add_argument("--json", action="store_true", help="write JSON to stdout, and nothing else")
        # After the command's name it must not undo what stands before it.
        added.add_argument("-v", "--verbose", action="count", default=argparse.SUPPRESS, help=VERBOSE_HELP)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; the exit status."""
    parser = build_parser()
    arguments = parser.parse_args(argv)
    arguments.parser = parser
    from twinbench.common.errors import BadInput, WorkerKilled
    from twinbench.common.shown import printable, shown

    try:
        with surroundings(arguments):
            return int(COMMANDS[arguments.command].run(arguments))
    except BadInput as error:
        print(f"twinbench: {printable(str(error))}", file=sys.stderr)
        return 2
    except (FloatingPointError, WorkerKilled) as error:
        print(f"twinbench: {printable(str(error))}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return _stopped(130)
    except Terminated:
        return _stopped(143)
    except BrokenPipeError:
        return 0
    except OSError as error:  # the machine says no, where nothing better is said
        name = f" {shown(error.filename)}" if error.filename is not None else ""
        print(f"twinbench: cannot use{name}: {error.strerror or error}; give another path, or mend it", file=sys.stderr)
        return 2


def _stopped(status: int) -> int:
    """End what works for this process, and say how to go on."""
    if workers := sys.modules.get("twinbench.common.workers"):
        workers.end_workers()
    print("twinbench: stopped; run the same command again to go on", file=sys.stderr)
    return status
