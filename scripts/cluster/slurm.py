"""Run sites on a Slurm cluster with one Slurm job per worker (needs pip install dask-jobqueue).

python scripts/cluster/slurm.py /srv/harbour/site.yaml --workers 40 --partition night
"""

from __future__ import annotations

import argparse
import importlib
import subprocess
import sys
from typing import Any


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sites", nargs="+", help="site files, in a folder that all nodes can read")
    parser.add_argument("--workers", type=int, default=16, help="number of workers, one processor each")
    parser.add_argument("--memory", default="4GB", help="memory of each worker")
    parser.add_argument("--walltime", default="06:00:00", help="time after which Slurm may end a worker")
    parser.add_argument("--partition", help="Slurm's partition (queue)")
    parser.add_argument("--show", action="store_true", help="only print the job that would be given to Slurm")
    asked = parser.parse_args()
    jobqueue: Any = importlib.import_module("dask_jobqueue")
    with jobqueue.SLURMCluster(
        queue=asked.partition, cores=1, processes=1, memory=asked.memory, walltime=asked.walltime, log_directory="slurm-logs"
    ) as cluster:
        if asked.show:
            print(cluster.job_script())
            return
        cluster.scale(jobs=asked.workers)
        cluster.wait_for_workers(1)  # jobs may queue for long; wbflow itself waits only seconds for a worker
        night = ["wbflow", "run", *asked.sites, "--backend", "dask", "--scheduler", cluster.scheduler_address]
        sys.exit(subprocess.run(night, check=False).returncode)


if __name__ == "__main__":
    main()
