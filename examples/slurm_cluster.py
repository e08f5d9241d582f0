"""A Dask cluster of SLURM jobs, for `twinbench ... --scheduler scheduler.json`: python examples/slurm_cluster.py 32

Start it where jobs may be submitted, in a folder that all machines share. It keeps as many jobs in SLURM's queue as you
say, each with one worker on one core. A job that ends after its worker has begun is submitted again. Ctrl-C or SIGTERM
ends them all.
"""

import json
import os
import signal
import sys
import time
from pathlib import Path

from dask_jobqueue import SLURMCluster

JOB = {
    "cores": 1,  # one thread each: Twinbench refuses workers with more
    "processes": 1,
    "memory": "4GB",
    "walltime": "04:00:00",  # longer than the longest cell takes
    "job_name": "twinbench",
    "log_directory": "slurm_logs",
    "scheduler_options": {"dashboard_address": ":0"},  # any free port; others use this machine, too
    # What your site asks for besides:
    # "queue": "normal",
    # "account": "my_project",
    # "interface": "ib0",  # the network that compute nodes reach this machine by
}
FILE = Path("scheduler.json")
LOOK_S = 10.0  # how often it is looked whether jobs have ended


def main(workers: int) -> None:
    """Keep so many workers until somebody ends this process."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: sys.exit(0))
    with SLURMCluster(**JOB) as cluster:
        beside = FILE.with_suffix(".part")
        beside.write_text(json.dumps({"address": cluster.scheduler_address}))
        os.replace(beside, FILE)  # whoever waits for the file finds it whole
        print(f"{workers} workers asked for; the scheduler is at {cluster.scheduler_address}, see {FILE}", flush=True)
        try:
            while True:
                cluster.scale(jobs=workers)  # submits again what has ended
                time.sleep(LOOK_S)
        finally:
            FILE.unlink(missing_ok=True)


if __name__ == "__main__":
    main(int(sys.argv[1]))
