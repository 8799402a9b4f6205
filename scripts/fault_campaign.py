#!/usr/bin/env python
"""Inject all faults that can hit a night's run, on stages that take no time, and print a table of tries and losses.

    scripts/fault_campaign.py [--reduced] [--only NAME] [--json FILE] [--seed N]

Faults are kills at file operations, worker deaths, damage to every kind of file, exchanged receipts, full disks, overlapping
runs, wrong clocks and signals.  After each, a plain `wbflow run` must give the cloud of an undisturbed run, with the right exit
code, without manual steps, and without repeating finished tasks.  Hostile site files, calibrations and captures must be refused
by name, or used.  The exit code is 1 if anything was lost.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sys
import tempfile
import time
from pathlib import Path

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "scripts"), str(ROOT / "tests" / "helpers")]

from faults import CAMPAIGN, Bench, Row  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reduced", action="store_true", help="try only a few faults of each kind: under three minutes")
    parser.add_argument("--only", action="append", metavar="NAME", help=f"only this kind of fault: {', '.join(CAMPAIGN)}")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    rows = []
    memory = Path("/dev/shm")  # fsync is free there: the campaign tests the order of operations, not the disk
    with tempfile.TemporaryDirectory(prefix="wbflow-faults-", dir=memory if memory.is_dir() else None) as folder:
        bench = Bench(Path(folder), options.seed)
        print(f"{Row.HEAD}", flush=True)
        for name, fault in CAMPAIGN.items():
            if options.only and name not in options.only:
                continue
            began, busy = time.monotonic(), _busy()
            row = fault(bench, options.reduced)
            row.cpu_s = _busy() - busy
            rows.append(row)
            print(f"{row}   {row.cpu_s:6.0f} CPU s, {time.monotonic() - began:.0f} s", flush=True)
        print(
            f"total: {sum(row.tries for row in rows):,} tries, {sum(len(row.losses) for row in rows)} losses, {_busy():.0f} CPU s"
        )
    if options.json:
        options.json.write_text(json.dumps([row.to_json() for row in rows], indent=1))
    sys.exit(any(row.losses for row in rows))


def _busy() -> float:
    """CPU seconds of this process and of all children that it has waited for."""
    return sum(t.ru_utime + t.ru_stime for t in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)))


if __name__ == "__main__":
    main()
