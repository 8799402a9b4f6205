"""Full disks, overlapping runs, signals, and wrong clocks."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

from .bench import Bench, Row, Strike


def full_disks(bench: Bench, reduced: bool) -> Row:
    """The disk is full from some operation on; and file systems that are too small, if this machine allows mounting them."""
    row = Row("disk full")
    cloud = bench.cloud(2, "one")
    toy = bench.site(2)
    bench.night(toy, "one")
    twin = bench.copy(toy)
    count = bench.operations(twin)
    receipts = bench.receipts(twin)
    for at in sorted(bench.random.sample(range(2, count), 3 if reduced else 16)):
        twin = bench.copy(toy)
        ended = bench.run(twin, strike=Strike(at, "full"))
        what = f"full from operation {at} of {count}"
        row.tries += 1
        bench.check_exit(row, ended, what, {0, 1, 3})
        if ended.code == 1 and "disk is full" not in ended.output and "No space" not in ended.output:
            row.add_loss("wrong exit", f"{what}: it does not say so: {ended.output[-300:]}")
        bench.check_recovery(row, twin, cloud, what, at_most=len(receipts - bench.receipts(twin)))
        bench.discard(twin)
    for size in () if reduced else (8_000_000, 15_000_000, 16_100_000, 16_200_000):
        place = bench.folder / f"disk-{size}"
        place.mkdir()
        mounted = ["mount", "-t", "tmpfs", "-o", f"size={size}", "none", str(place)]
        if subprocess.run(mounted, capture_output=True, check=False).returncode:
            continue
        try:
            small = bench.site(2, work=str(place / "work"))
            bench.night(small, "one")
            row.tries += 1
            bench.check_exit(row, bench.run(small), f"a disk of {size} bytes", {1})
            subprocess.run(["mount", "-o", "remount,size=64000000", str(place)], check=True)
            small.folder.joinpath(".wbflow").mkdir(exist_ok=True)
            small.work.symlink_to(place / "work")
            bench.check_recovery(row, small, cloud, f"a disk of {size} bytes that has grown")
        finally:
            subprocess.run(["umount", "-l", str(place)], check=False)
    return row


def overlaps(bench: Bench, reduced: bool) -> Row:
    """A second run starts while the first one is at work: it is refused or waits; sometimes the first one is killed before."""
    row = Row("runs overlap")
    cloud = bench.cloud(2, "one")
    for k in range(1 if reduced else 20):
        toy = bench.site(2)
        bench.night(toy, "one")
        toy.fault("slow", "0.2")
        first = bench.start(toy, "--jobs", "1", "-q")
        _wait_for(toy.work / "cache" / "frames")
        waits = k % 2 == 1
        if k % 4 == 3:
            first.kill_all()
        second = bench.run(toy, *(["--wait"] if waits else []))
        what = f"the second {'waits' if waits else 'does not wait'}"
        row.tries += 1
        bench.check_exit(row, second, what, {0} if waits else {4})
        bench.check_exit(row, first.wait(), "the first", {-9} if k % 4 == 3 else {0})
        (toy.folder / "faults" / "slow").unlink()
        bench.check_recovery(row, toy, cloud, what, at_most=0)
        bench.discard(toy)
    return row


def signals(bench: Bench, reduced: bool) -> Row:
    """A run stops at SIGINT or SIGTERM, and finished tasks stay."""
    row = Row("interrupted or terminated")
    cloud = bench.cloud(2, "one")
    for k in range(1 if reduced else 12):
        toy = bench.site(2)
        bench.night(toy, "one")
        toy.fault("slow", "0.1")
        process = bench.start(toy, "--jobs", str(1 + k % 2), "-q")
        _wait_for(toy.work / "cache" / ("frames" if k % 3 else "matches"))
        process.send(signal.SIGINT if k % 2 else signal.SIGTERM)
        row.tries += 1
        what = f"{'SIGINT' if k % 2 else 'SIGTERM'}, try {k}"
        bench.check_exit(row, process.wait(), what, {130})
        (toy.folder / "faults" / "slow").unlink()
        bench.check_recovery(row, toy, cloud, what)
        bench.discard(toy)
    return row


def clocks(bench: Bench, reduced: bool) -> Row:
    """Captures and runs are dated in the future, or long ago."""
    row = Row("clock wrong")
    for k in range(1 if reduced else 6):
        toy = bench.site(2)
        bench.night(toy, "two")
        bench.run(toy)
        runs = toy.work / "runs"
        before = next(path for path in runs.iterdir() if not path.is_symlink())
        name = "20991231T235959Z" if k % 2 else "19700101T000000Z"
        before.rename(runs / name)
        for link in ("latest", "latest-good"):
            (runs / link).unlink()
            (runs / link).symlink_to(name)
        bench.night(toy, "one")
        for camera in toy.cameras:
            moment = time.time() + (10**9 if k % 3 else -(10**9))
            os.utime(toy.capture(camera), (moment, moment))
        row.tries += 1
        bench.check_recovery(row, toy, bench.cloud(2, "one"), f"a run of {name[:4]}")
        if (runs / "latest").resolve().name == name:
            row.add_loss("manual step", f"a run of {name[:4]}: latest still shows it")
        bench.discard(toy)
    return row


def _wait_for(path: Path, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not path.exists() and time.monotonic() < end:
        time.sleep(0.02)
