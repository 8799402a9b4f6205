"""Run sites on Kubernetes with pods as workers (needs pip install dask-kubernetes, and the Dask operator in the cluster).

The image must contain wbflow[dask] and all that the sites' modules need.  The claim is a volume that all pods mount at --there
and this machine at --here.

python scripts/cluster/kubernetes.py /srv/harbour/site.yaml --image registry/wbflow:1 --claim captures --here /srv --there /mnt
"""

from __future__ import annotations

import argparse
import importlib
import subprocess
import sys
from typing import Any


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sites", nargs="+", help="site files")
    parser.add_argument("--image", required=True, help="an image with the same wbflow and libraries as here; others are refused")
    parser.add_argument("--claim", required=True, help="persistent volume claim that holds captures and work folders")
    parser.add_argument("--here", required=True, help="folder of the volume on this machine")
    parser.add_argument("--there", required=True, help="folder of the volume in the pods")
    parser.add_argument("--workers", type=int, default=16, help="number of workers, one processor each")
    parser.add_argument("--memory", default="4Gi", help="memory of each worker")
    asked = parser.parse_args()
    operator: Any = importlib.import_module("dask_kubernetes.operator")
    spec = operator.make_cluster_spec(
        name="wbflow", image=asked.image, n_workers=asked.workers, resources={"limits": {"cpu": "1", "memory": asked.memory}}
    )
    pod = spec["spec"]["worker"]["spec"]
    pod["volumes"] = [{"name": "site", "persistentVolumeClaim": {"claimName": asked.claim}}]
    pod["containers"][0]["volumeMounts"] = [{"name": "site", "mountPath": asked.there}]
    pod["containers"][0]["args"] += ["--nthreads", "1"]
    with operator.KubeCluster(custom_cluster_spec=spec) as cluster:
        cluster.wait_for_workers(1)
        night = ["wbflow", "run", *asked.sites, "--backend", "dask", "--scheduler", cluster.scheduler_address]
        sys.exit(subprocess.run([*night, "--worker-root", f"{asked.here}={asked.there}"], check=False).returncode)


if __name__ == "__main__":
    main()
