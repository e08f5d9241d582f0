"""``twinbench estimate``: a trained estimator on a user's recordings."""

from __future__ import annotations

import argparse
from pathlib import Path

from twinbench.bench.cli.output import tell
from twinbench.bench.cli.parser import add_machine, add_map, add_recordings, add_training

ESTIMATE = """columns of the compressor, one reading each 0.05 s (20 Hz, as in training), a cell empty where missing:
  time_s       s      time, increasing
  p_suc_bar    bar    suction pressure, absolute
  T_suc_K      K      suction temperature
  N_rpm        rpm    speed
  valve        -      command of the discharge valve, 0 to 1
  p_dis_bar    bar    discharge pressure, absolute
  T_dis_K      K      discharge temperature
  m_flow_kg_s  kg/s   mass flow
of another machine: time_s, its inputs and its outputs by their names, each in its unit, at its sample period.
--map 'COLUMN[UNIT]=channel' converts other units: kPa, psi, degC, Hz, percent, kg/h, ...
barg, mbarg, kPag, MPag, psig are gauge: 1.01325 bar is added to them.
Each estimator refuses recordings that are sampled more slowly than it can use, and names its limit.

Each result says what it rests on: readings used, innovations against their expected range, gaps, flags.
exit status:
    0  usable
    1  the method failed
    2  bad input
    3  not usable, and not written without --force"""

SAYS = "run a trained estimator over your recordings of the machine it was trained for"
EXAMPLE = "twinbench estimate deeponet_kalman plant.csv --out estimates --map 'PT101[psig]=p_dis_bar'\n\n" + ESTIMATE


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("estimator", metavar="NAME", help="a trained estimator")
    add_recordings(parser)
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for the estimates and their figures"
    )
    add_machine(parser, default="")
    add_training(parser)
    add_map(parser)
    parser.add_argument(
        "--delay",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="of each time, write what is known at most so many seconds later, and surer (default: 0, at that time)",
    )
    parser.add_argument(
        "--force", action="store_true", help="also write estimates that are not usable; the exit status stays 3"
    )


def run(a: argparse.Namespace) -> int:
    """The exit status."""
    from twinbench.bench.estimate.apply import Training, apply

    where = Training(a.profile, a.results, a.machine)
    summaries = apply(a.estimator, a.recordings, a.out, where, a.map, a.force, a.delay)
    if a.json:
        tell(a, summaries)
    else:
        for summary in summaries:
            print("\n".join(summary["rests_on"]))
            if summary["usable"] or a.force:
                print(summary["says"])
            else:
                print("nothing was written for it; --force writes it all the same")
    return 0 if all(summary["usable"] for summary in summaries) else 3
