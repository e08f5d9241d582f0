"""The ``twinbench`` command. Heavy imports wait until a command needs them."""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import math
import shlex
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from bench.mismatch_status import SAYS
from bench.threads import pin

pin()

EPILOG = """examples:
  twinbench run --profile quick                    every estimator, in minutes
  twinbench run --only oracle nominal_ekf          two of them
  twinbench run --only oracle my_baseline.py       yours, from one file
  twinbench check my_baseline.py                   the contract every estimator keeps
  twinbench simulate --out recordings              the benchmark's recordings as CSV
  twinbench estimate deeponet_kalman plant.csv --out estimates --map PT101[psi]=p_dis_bar
  twinbench export --out controller                the trained operator as ONNX, for a controller
  twinbench list mechanisms                        what a compressor model can leave out
  twinbench list mechanisms --simulator tanks.py   what mismatch looks for in yours
  twinbench mismatch tanks.py day1.csv day2.csv --hold-out day3.csv --out found
                                                   what your simulator leaves out, and proof of it
  twinbench simulate --simulator found/model.toml --inputs day4.csv --out replayed
exit status:
    0  done
    1  a method, a check or a worker process failed; what was finished is kept
    2  bad input: one line says what and where, and nothing is written
    3  estimate: a result is not usable and was not written
   10  mismatch: something is wrong and has a name; 11: and has none, or not in full
  130  stopped with Ctrl-C, 143 by SIGTERM; run the same command again to go on
completion: eval "$(twinbench completion bash)", or zsh; twinbench completion fish | source"""
_PARALLEL = ("run", "mismatch", "prove", "flagship", "tune", "check")
_LOGGED = ("physics", "data", "methods", "baselines", "mismatch", "bench")
_VERBOSE = "say on stderr what is done, with times; twice: more"
log = logging.getLogger(__name__)
_SIMULATOR_HELP = "compressor, nominal, path/to/file.py[:NAME], package.module:NAME, or a model.toml"
_TRUST_HELP = "run the Python that a model.toml names though it lies outside its folder and the one you are in"


class _Version(argparse.Action):
    """The version, and in a checkout the commit: asked for only when somebody asks."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        from bench.versions import version

        print(f"twinbench {version()}")
        parser.exit()


class _Terminated(BaseException):
    """SIGTERM came."""

_ESTIMATE = """columns, a reading each 0.05 s (20 Hz, as in training), empty where missing:
  time_s       s      time, increasing
  p_suc_bar    bar    suction pressure, absolute
  T_suc_K      K      suction temperature
  N_rpm        rpm    speed
  valve        -      command of the discharge valve, 0 to 1
  p_dis_bar    bar    discharge pressure, absolute
  T_dis_K      K      discharge temperature
  m_flow_kg_s  kg/s   mass flow
--map 'COLUMN[UNIT]=channel' converts other units: kPa, psi, degC, Hz, percent, kg/h, ...
barg, mbarg, kPag, MPag, psig are gauge: 1.01325 bar is added to them.
more seldom readings are refused below what the estimator bears; the line says the limit

each result says what it rests on: readings used, innovations against what is expected, gaps, flags.
exit status: 0 usable, 1 the method failed, 2 bad input, 3 not usable and not written (but with --force)"""


class _Parser(argparse.ArgumentParser):
    """Usage errors in one line, as all bad input."""

    def error(self, message: str) -> NoReturn:
        from data.shown import printable

        print(f"{self.prog}: {printable(message)}; see {self.prog} --help", file=sys.stderr)
        raise SystemExit(2)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="twinbench",
        description="Which estimator keeps a machine's digital twin true, and how sure is that?",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", nargs=0, action=_Version, help="the version, and the commit in a checkout")
    parser.add_argument("-v", "--verbose", action="count", default=0, help=_VERBOSE)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_Parser)

    def command(name: str, says: str, example: str) -> argparse.ArgumentParser:
        return commands.add_parser(
            name,
            help=says,
            description=says[0].upper() + says[1:] + ".",
            epilog=f"example:\n  {example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )

    run = command("run", "simulate, train, evaluate, compare, report", "twinbench run --only oracle gru_kf")
    run.add_argument("--profile", default="quick", help="quick, paper, or the path of a .toml file (default: quick)")
    run.add_argument(
        "--only", nargs="+", default=(), metavar="NAME",
        help="estimators by name or by path/to/file.py; those that are in --out already keep their rows beside them",
    )  # fmt: skip
    run.add_argument(
        "--ablations", action="store_true",
        help="besides, each of the estimators without each of its parts (twinbench list ablations)",
    )  # fmt: skip
    run.add_argument(
        "--robustness", action="store_true",
        help="besides, under more noise and dropout, faster wear, loads beyond the envelope and sensor faults",
    )  # fmt: skip
    run.add_argument("--out", type=Path, metavar="DIR", help="where results go (results/<profile>)")
    run.add_argument(
        "--resume", action=argparse.BooleanOptionalAction, default=True,
        help="keep what an earlier run finished (default); --no-resume does over what it runs",
    )  # fmt: skip
    run.add_argument("--backend", choices=("local", "dask"), default="local", help="where the cells run")
    run.add_argument("--scheduler", default="", metavar="ADDRESS", help="the Dask scheduler, tcp://host:port")

    listing = command("list", "list what there is", "twinbench list estimators --json")
    listing.add_argument("what", nargs="?", default="estimators", choices=tuple(_LISTS))
    listing.add_argument(
        "--simulator", metavar="SIMULATOR", help=f"for mechanisms: all that mismatch looks for in it; {_SIMULATOR_HELP}"
    )
    listing.add_argument("--trust", action="store_true", help=_TRUST_HELP)

    check = command("check", "run the contract battery on an estimator", "twinbench check my_baseline.py")
    check.add_argument("estimator", metavar="NAME", help="an estimator's name, or path/to/file.py[:Class]")

    tuning = command(
        "tune", "choose an estimator's settings on the validation sequences", "twinbench tune gru_kf --trials 20"
    )
    tuning.add_argument("estimators", nargs="+", metavar="NAME", help="estimators' names, or path/to/file.py[:Class]")
    tuning.add_argument("--profile", default="tuning", help="whose data and training (default: tuning)")
    tuning.add_argument("--trials", type=int, default=20, metavar="N", help="in all, earlier ones included")
    tuning.add_argument("--online", action="store_true", help="only settings that need no new training")
    tuning.add_argument("--out", type=Path, default=Path("results/tuning"), metavar="DIR")

    simulate = command(
        "simulate", "write the benchmark's recordings, or what a simulator of yours makes of recorded inputs",
        "twinbench simulate --out recordings\n"
        "  twinbench simulate --simulator tanks.py --inputs day4.csv --out replayed",
    )  # fmt: skip
    simulate.add_argument("--out", type=Path, required=True, metavar="DIR")
    simulate.add_argument("--simulator", metavar="SIMULATOR", help=_SIMULATOR_HELP)
    simulate.add_argument("--trust", action="store_true", help=_TRUST_HELP)
    simulate.add_argument(
        "--inputs", nargs="+", default=(), type=Path, metavar="RECORDING",
        help="recordings whose inputs drive --simulator; it starts from their first readings",
    )  # fmt: skip
    simulate.add_argument("--map", action="append", default=[], metavar="COLUMN[UNIT]=CHANNEL", help="rename, convert")
    simulate.add_argument("--profile", default="quick", help="whose data (default: quick)")
    simulate.add_argument("--part", choices=("train", "validation", "test"), default="test")
    simulate.add_argument("--format", choices=("csv", "parquet"), default="csv")
    simulate.add_argument("--no-truth", action="store_true", help="sensor columns only")

    estimate = command(
        "estimate", "run a trained estimator over your recordings of a compressor like the built-in one",
        "twinbench estimate deeponet_kalman plant.csv --out estimates --map 'PT101[psig]=p_dis_bar'\n\n" + _ESTIMATE,
    )  # fmt: skip
    estimate.add_argument("estimator", metavar="NAME")
    estimate.add_argument("recordings", nargs="+", type=Path, metavar="RECORDING", help=".csv, .csv.gz or .parquet")
    estimate.add_argument("--out", type=Path, required=True, metavar="DIR")
    estimate.add_argument("--profile", default="quick", help="whose training (default: quick)")
    estimate.add_argument("--results", type=Path, metavar="DIR", help="the run it comes from (results/<profile>)")
    estimate.add_argument("--map", action="append", default=[], metavar="COLUMN[UNIT]=CHANNEL", help="rename, convert")
    estimate.add_argument(
        "--force", action="store_true", help="write estimates that are not usable, too; the exit status stays 3"
    )

    export = command(
        "export", "write a trained DeepONet-Kalman as an ONNX graph and arrays, for machines without this package",
        "twinbench export --results results/quick --out controller\n\n"
        "writes operator.onnx and filter.npz into DIR; docs/controller.md has the thirty lines that run them",
    )  # fmt: skip
    export.add_argument("--out", type=Path, required=True, metavar="DIR")
    export.add_argument(
        "--estimator", default="deeponet_kalman", metavar="NAME",
        help="deeponet_kalman (default) or one of its ablations",
    )  # fmt: skip
    export.add_argument("--profile", default="quick", help="whose training (default: quick)")
    export.add_argument("--results", type=Path, metavar="DIR", help="the run it comes from (results/<profile>)")

    mismatch = command(
        "mismatch", "find what a simulator leaves out, name it, model it, and prove it on held-out recordings",
        "twinbench mismatch tanks.py day1.csv day2.csv --hold-out day3.csv --out found --map 'LT1[cm]=level_m'\n\n"
        "writes verdict.json, report.html and model.toml, the mended simulator, into DIR\n"
        "exit status: " + "; ".join(f"{status} {says}" for status, says in SAYS.items()) + "; 2 bad input",
    )  # fmt: skip
    mismatch.add_argument("simulator", metavar="SIMULATOR", help=_SIMULATOR_HELP)
    mismatch.add_argument("recordings", nargs="+", type=Path, metavar="RECORDING", help=".csv, .csv.gz or .parquet")
    mismatch.add_argument("--out", type=Path, required=True, metavar="DIR")
    mismatch.add_argument(
        "--hold-out", nargs="+", default=(), type=Path, metavar="RECORDING",
        help="recordings for the proof, best of another regime: no parameter is learnt from them",
    )  # fmt: skip
    mismatch.add_argument(
        "--catalogue", default="", metavar="FILE",
        help="mechanisms of your own, to be tried too: path/to/file.py[:NAME]",
    )  # fmt: skip
    mismatch.add_argument(
        "--inputs", choices=("auto", "held", "linear"), default="auto",
        help="between samples: each value holds until the next, or lines join them; auto (default) tries both",
    )  # fmt: skip
    mismatch.add_argument("--trust", action="store_true", help=_TRUST_HELP)
    mismatch.add_argument("--map", action="append", default=[], metavar="COLUMN[UNIT]=CHANNEL", help="rename, convert")

    prove = command(
        "prove", "hide effects in simulated machines and see whether mismatch finds them",
        "twinbench prove --cases 40 --out results/prove\n\n"
        "draws each case from the seed, seals the truth, asks the engine blindly and judges; resumes where it stopped",
    )  # fmt: skip
    prove.add_argument("--cases", type=int, default=40, metavar="N", help="how many (default: 40)")
    prove.add_argument("--seed", type=int, default=1, metavar="S", help="1 is for development (default)")
    prove.add_argument("--out", type=Path, default=Path("results/prove"), metavar="DIR")
    prove.add_argument(
        "--engines", default="twinbench", metavar="NAME,...",
        help="whom to ask: twinbench (default), oracle, opponents, ablations, or all; an unknown name lists them",
    )  # fmt: skip
    prove.add_argument(
        "--opponent-cases", type=int, metavar="N",
        help="so many cases, spread over all, for all but twinbench and oracle (default: all)",
    )  # fmt: skip

    flagship = command(
        "flagship", "let mismatch mend the nominal model on drawn plants that differ from it in eleven ways",
        "twinbench flagship --draws 10 --out results/flagship\n\n"
        "draws each plant from the seed, seals the truth, asks the engine blindly, filters with what it mended",
    )  # fmt: skip
    flagship.add_argument("--draws", type=int, default=2, metavar="N", help="how many plants (default: 2)")
    flagship.add_argument("--seed", type=int, default=1, metavar="S", help="1 is for development (default)")
    flagship.add_argument("--out", type=Path, default=Path("results/flagship"), metavar="DIR")
    flagship.add_argument("--told", action="store_true", help="also ask an engine that is told the effects' names")

    report = command("report", "draw tables, figures and report again", "twinbench report results/quick")
    report.add_argument("results", type=Path, metavar="DIR")

    latency = command(
        "latency", "time one online update of trained estimators and of their peers, on one core",
        "twinbench latency --results results/quick\n\n"
        "back to back and at 20 Hz, beside filterpy's EKF and UKF in the same run; nothing else should run meanwhile",
    )  # fmt: skip
    latency.add_argument("--estimator", nargs="+", default=(), metavar="NAME", help="(default: all that are trained)")
    latency.add_argument("--profile", default="quick", help="whose training (default: quick)")
    latency.add_argument("--results", type=Path, metavar="DIR", help="the run they come from (results/<profile>)")
    latency.add_argument(
        "--updates", type=int, default=2000, metavar="N", help="of each, back to back (default: 2000)"
    )
    latency.add_argument(
        "--ticks", type=int, default=200, metavar="N", help="of each, at 20 Hz; 0: none (default: 200, ten seconds)"
    )
    latency.add_argument("--out", type=Path, metavar="DIR", help="where tables and figures go (results/latency)")

    completion = command(
        "completion", "print a script that completes commands, options and names in your shell",
        'eval "$(twinbench completion bash)"\n\n'
        "best as a line of ~/.bashrc, or with zsh of ~/.zshrc; fish: twinbench completion fish | source",
    )  # fmt: skip
    completion.add_argument("shell", choices=("bash", "zsh", "fish"))
    for name, added in commands.choices.items():
        if name in _PARALLEL:
            says = "at most so many at once (default: one per core; fewer need less memory)"
            added.add_argument("--jobs", type=int, metavar="N", help=says)
        if added is not completion:
            added.add_argument("--json", action="store_true", help="machine-readable, alone on stdout")
        # After the command's name it must not undo what stands before it.
        added.add_argument("-v", "--verbose", action="count", default=argparse.SUPPRESS, help=_VERBOSE)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; the exit status."""
    arguments = _parser().parse_args(argv)
    from data.errors import BadInput
    from data.shown import printable

    try:
        with _surroundings(arguments):
            return int(_COMMANDS[arguments.command](arguments))
    except BadInput as error:
        print(f"twinbench: {printable(str(error))}", file=sys.stderr)
        return 2
    except FloatingPointError as error:
        print(f"twinbench: {printable(str(error))}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return _stopped(130)
    except _Terminated:
        return _stopped(143)
    except BrokenPipeError:
        return 0
    except RuntimeError as error:
        workers = sys.modules.get("bench.workers")
        if workers is None or not isinstance(error, workers.WorkerKilled):
            raise
        print(f"twinbench: {error}", file=sys.stderr)
        return 1


def _stopped(status: int) -> int:
    """End what works for this process, and say how to go on."""
    if workers := sys.modules.get("bench.workers"):
        workers.end_workers()
    print("twinbench: stopped; run the same command again to go on", file=sys.stderr)
    return status


@contextlib.contextmanager
def _surroundings(a: argparse.Namespace) -> Iterator[None]:
    """What holds for every command: logging, the number of jobs, where output goes, what SIGTERM does."""
    from data.jobs import at_most

    a.stdout = sys.stdout
    with contextlib.ExitStack() as stack:
        if getattr(a, "json", False):
            # What a plug-in prints must not stand between what a program reads.
            stack.enter_context(contextlib.redirect_stdout(sys.stderr))
        stack.enter_context(at_most(getattr(a, "jobs", None)))
        stack.enter_context(_logging(a.verbose))
        stack.enter_context(_sigterm())
        begun = time.monotonic()
        log.info("twinbench %s begins", a.command)
        yield
        log.info("twinbench %s ends after %.1f s", a.command, time.monotonic() - begun)


@contextlib.contextmanager
def _logging(verbose: int) -> Iterator[None]:
    """With --verbose: what this package does, with times, on stderr; twice: details as well."""
    if not verbose:
        yield
        return
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s: %(message)s"))
    loggers = [logging.getLogger(name) for name in _LOGGED]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(logging.DEBUG if verbose > 1 else logging.INFO)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.removeHandler(handler)
            logger.setLevel(level)


@contextlib.contextmanager
def _sigterm() -> Iterator[None]:
    """SIGTERM unwinds this process as Ctrl-C does, where it is the main thread's to decide."""

    def stop(*_: object) -> NoReturn:
        raise _Terminated

    try:
        before = signal.signal(signal.SIGTERM, stop)
    except ValueError:  # a program runs the command in another thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _tell(a: argparse.Namespace, value: Any) -> None:
    """One JSON value on stdout."""
    print(json.dumps(value, indent=2, allow_nan=False), file=a.stdout)


def _rows(frame: Any) -> list[dict[str, Any]]:
    """A table as records; null where there is no number."""
    return list(json.loads(frame.to_json(orient="records", double_precision=15)))


def _failed(outcomes: Any) -> list[dict[str, Any]]:
    """Cells that failed."""
    return [
        {"estimator": o.cell.estimator, "seed": o.cell.seed, "stage": o.stage, "reason": o.reason} for o in outcomes
    ]


def _run(a: argparse.Namespace) -> int:
    from shutil import get_terminal_size

    from bench.profile import load_profile
    from bench.runner import run
    from bench.table_formats import to_text

    profile = load_profile(a.profile)
    out = a.out or Path("results") / profile.name
    command = "twinbench " + shlex.join(sys.argv[1:])
    finished = run(profile, out, tuple(a.only), a.ablations, a.robustness, a.resume, a.backend, a.scheduler, command)
    if a.json:
        page = str((out / "report.html").resolve())
        rows = _rows(finished.comparison.frame)
        _tell(a, {"comparison": rows, "failed": _failed(finished.failed), "report": page})
        return 1 if finished.failed else 0
    print(to_text(finished.comparison, get_terminal_size().columns))
    for outcome in finished.failed:
        print(f"failed: {outcome.cell.estimator}, seed {outcome.cell.seed}, {outcome.stage}: {outcome.reason}")
    print(f"report: {(out / 'report.html').resolve()}")
    return 1 if finished.failed else 0


def _list(a: argparse.Namespace) -> int:
    from data.errors import BadInput

    if a.simulator and a.what != "mechanisms":
        raise BadInput(f"list {a.what}: --simulator goes with mechanisms only; leave it out")
    rows = _mechanisms(a.simulator, a.trust) if a.what == "mechanisms" else _LISTS[a.what]()
    if a.json:
        _tell(a, rows)
        return 0
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None)
    for column in rows[0] if rows else ():
        table.add_column(column)
    for row in rows:
        table.add_row(*(escape(str(v)) for v in row.values()))
    Console().print(table)
    return 0


def _estimators() -> list[dict[str, Any]]:
    from bench.registry import discover
    from bench.roster import ordered

    known = discover()
    return [{"name": n, "says": known[n].says, "module": known[n].__module__} for n in ordered(known)]


def _ablations() -> list[dict[str, Any]]:
    from bench.registry import discover

    return [
        {"estimator": name, "ablation": ablation, "settings": {k: _finite(v) for k, v in settings.items()}}
        for name, kind in sorted(discover().items())
        for ablation, settings in kind.ablations.items()
    ]


def _finite(setting: Any) -> Any:
    """As it is, or in words: JSON has no infinity."""
    return str(setting) if isinstance(setting, float) and not math.isfinite(setting) else setting


def _mechanisms(spec: str | None = None, trust: bool = False) -> list[dict[str, Any]]:
    from mismatch.model import load_simulator, whole_catalogue
    from physics.mechanisms import CATALOGUE

    mechanisms = whole_catalogue(load_simulator(spec, trust)) if spec else CATALOGUE
    return [
        {
            "name": m.name,
            "port": m.port,
            "parameter": ", ".join(f"{v.name} = {v.nominal:g} {v.unit}" for v in m.parameters),
            "says": m.says,
        }
        for m in mechanisms
    ]


def _simulators() -> list[dict[str, Any]]:
    from physics.compressor import PLANT
    from physics.nominal import NOMINAL

    return [
        {"name": s.name, "states": len(s.states), "parameters": len(s.parameters), "says": s.says}
        for s in (PLANT, NOMINAL)
    ]


def _check(a: argparse.Namespace) -> int:
    from bench.contract import run_battery
    from bench.registry import find

    results = run_battery(find(a.estimator))
    failed = sum(r.status == "fail" for r in results)
    if a.json:
        _tell(a, [{"name": r.name, "status": r.status, "detail": r.detail} for r in results])
        return 1 if failed else 0
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table("check", "status", "detail", box=None)
    colours = {"pass": "green", "fail": "red", "skip": "yellow"}
    for r in results:
        table.add_row(r.name, f"[{colours[r.status]}]{r.status}[/]", escape(r.detail))
    Console().print(table, f"{len(results)} checks, {failed} failed")
    return 1 if failed else 0


def _tune(a: argparse.Namespace) -> int:
    import tomllib

    from rich.console import Console

    from bench.profile import load_profile
    from bench.tune import tune

    command = "twinbench " + shlex.join(sys.argv[1:])
    profile = load_profile(a.profile)
    console = Console(stderr=True)
    chosen = [tune(spec, profile, a.out, a.trials, console, command, a.online) for spec in a.estimators]
    if a.json:
        _tell(a, [tomllib.loads(section)["settings"] for section in chosen])
    else:
        print("".join(chosen), end="")
    return 0


def _simulate(a: argparse.Namespace) -> int:
    from data.errors import BadInput

    if bool(a.simulator) != bool(a.inputs):
        raise BadInput("--simulator and --inputs go together; give the recordings that drive it with --inputs")
    if a.simulator:
        from bench.replay import replay

        _tell_files(a, replay(a.simulator, a.inputs, a.out, a.map, a.format, a.trust))
        return 0
    return _simulate_benchmark(a)


def _simulate_benchmark(a: argparse.Namespace) -> int:
    from functools import partial

    from bench.profile import load_profile
    from bench.store import write_atomically
    from data.benchmark import design, run
    from data.recording import truth_table

    profile = load_profile(a.profile)
    scenarios = design(profile.data)[a.part]
    for scenario in scenarios:
        batch = run((scenario,), profile.data.warmup_minutes, profile.corruption)
        table = truth_table(batch.without_truth() if a.no_truth else batch, 0)
        write = table.to_csv if a.format == "csv" else table.to_parquet
        write_atomically(a.out / f"{scenario.name}.{a.format}", partial(write, index=False))
    if a.json:
        _tell_files(a, [a.out / f"{scenario.name}.{a.format}" for scenario in scenarios])
    else:
        print(f"{len(scenarios)} recordings in {a.out}")
    return 0


def _tell_files(a: argparse.Namespace, paths: Sequence[Path]) -> None:
    """The files that were written, a line each."""
    if a.json:
        _tell(a, {"files": [str(path) for path in paths]})
    else:
        print("\n".join(map(str, paths)))


def _estimate(a: argparse.Namespace) -> int:
    from bench.apply import apply

    summaries = apply(a.estimator, a.recordings, a.out, a.profile, a.results, a.map, a.force)
    if a.json:
        _tell(a, summaries)
    else:
        for summary in summaries:
            print("\n".join(summary["rests_on"]))
            if summary["usable"] or a.force:
                print(summary["says"])
            else:
                print("nothing was written for it; --force writes it all the same")
    return 0 if all(summary["usable"] for summary in summaries) else 3


def _export(a: argparse.Namespace) -> int:
    from bench.export import export

    _tell_files(a, export(a.estimator, a.out, a.profile, a.results))
    return 0


def _mismatch(a: argparse.Namespace) -> int:
    from shutil import get_terminal_size

    from bench.explain import explain

    verdict = explain(a.simulator, a.recordings, a.hold_out, a.out, a.catalogue, a.map, a.trust, a.inputs)
    # What was found is told before it is drawn: drawing takes a while, and may fail.
    from bench.mismatch_report import to_json, to_text, write_page
    from bench.mismatch_status import STATUS

    told = to_json(verdict) if a.json else to_text(verdict, get_terminal_size().columns)
    print(told, file=a.stdout if a.json else None, flush=True)
    write_page(verdict, a.out)
    if not a.json:
        for name, says in (("report.html", "report"), ("verdict.json", "for programs"), ("model.toml", "mended model")):
            print(f"{says}: {(a.out / name).resolve()}")
    return STATUS[verdict.verdict]


def _prove(a: argparse.Namespace) -> int:
    import pandas as pd
    from rich.console import Console

    from bench.prove.engines import chosen
    from bench.prove.gates import as_markdown
    from bench.prove.suite import run

    engines = chosen(a.engines)
    command = "twinbench " + shlex.join(sys.argv[1:])
    console = Console(stderr=True)
    gates = run(a.cases, a.seed, a.out, console, engines, opponent_cases=a.opponent_cases, command=command)
    if a.json:
        compared = _rows(pd.read_csv(a.out / "engines.csv"))
        _tell(a, {"gates": _rows(gates), "engines": compared, "out": str(a.out.resolve())})
        return 0
    print(as_markdown(gates))
    if len(engines) > 1:
        print((a.out / "engines.md").read_text())
    return 0


def _flagship(a: argparse.Namespace) -> int:
    from rich.console import Console

    from bench.flagship.suite import ENGINES, run
    from bench.prove.gates import as_markdown

    command = "twinbench " + shlex.join(sys.argv[1:])
    engines = ENGINES if a.told else ENGINES[:1]
    gates = run(a.draws, a.seed, a.out, Console(stderr=True), engines, command=command)
    if a.json:
        _tell(a, {"gates": _rows(gates), "out": str(a.out.resolve())})
    else:
        print(as_markdown(gates))
    return 0


def _report(a: argparse.Namespace) -> int:
    from bench.report import write_report
    from data.errors import BadInput

    if not (a.results / "manifest.json").is_file():
        raise BadInput(f"{a.results} holds no run (no manifest.json); make one with: twinbench run --out {a.results}")
    comparison = write_report(a.results)
    page = (a.results / "report.html").resolve()
    if a.json:
        _tell(a, {"comparison": _rows(comparison.frame), "report": str(page)})
    else:
        print(f"report: {page}")
    return 0


def _latency(a: argparse.Namespace) -> int:
    from shutil import get_terminal_size

    from rich.console import Console

    from bench.latency.suite import run
    from bench.table_formats import to_text
    from data.errors import BadInput

    for name, value, least in (("--updates", a.updates, 10), ("--ticks", a.ticks, 0)):
        if not least <= value <= 10_000_000:
            raise BadInput(f"{name} is {value:,}, must lie in [{least}, 10,000,000]")
    command = "twinbench " + shlex.join(sys.argv[1:])
    out = a.out or Path("results/latency")
    console = Console(stderr=True)
    table, failed = run(a.profile, a.results, list(a.estimator), a.updates, a.ticks, out, command, console)
    if a.json:
        _tell(a, {"latency": _rows(table.frame), "failed": _failed(failed), "out": str(out.resolve())})
        return 1 if failed else 0
    print(to_text(table, get_terminal_size().columns))
    for outcome in failed:
        print(f"failed: {outcome.cell.estimator}: {outcome.reason}")
    print(f"tables and figures: {out.resolve()}")
    return 1 if failed else 0


def _completion(a: argparse.Namespace) -> int:
    from bench.completion import script

    print(script(_parser(), a.shell), end="")
    return 0


_LISTS = {
    "estimators": _estimators,
    "ablations": _ablations,
    "mechanisms": _mechanisms,
    "simulators": _simulators,
}
_COMMANDS = {
    "run": _run,
    "list": _list,
    "check": _check,
    "tune": _tune,
    "simulate": _simulate,
    "estimate": _estimate,
    "export": _export,
    "mismatch": _mismatch,
    "prove": _prove,
    "flagship": _flagship,
    "report": _report,
    "latency": _latency,
    "completion": _completion,
}
