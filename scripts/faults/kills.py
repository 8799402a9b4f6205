"""Processes that are killed: the run at each of its operations on files, its workers in each stage, the parent alone."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.helpers.toy_site import STAGES, ToySite

from .bench import Bench, Row, Strike


@dataclass(frozen=True)
class Scene:
    """A run that is to be struck."""

    name: str
    toy: ToySite
    """As it stands before."""
    cloud: bytes
    arguments: tuple[str, ...] = ()
    command: str = "run"


def scenes(bench: Bench) -> Iterator[Scene]:
    """A first night; one in which nothing runs; one with other captures, after which old ones go; a cleaning; a pinning."""
    toy = bench.site()
    bench.night(toy, "one")
    yield Scene("first night", toy, bench.cloud(2, "one"))
    done = bench.copy(toy)
    bench.run(done)
    yield Scene("nothing to do", done, bench.cloud(2, "one"))
    kept = bench.site(keep={"nights": 1, "clouds": 1, "reports": 1})
    bench.night(kept, "one")
    bench.run(kept, "--date", "2026-11-01")
    bench.night(kept, "two")
    yield Scene("another night, keep: 1", kept, bench.cloud(2, "two"), ("--date", "2026-11-02"))
    yield Scene("pin", done, bench.cloud(2, "one"), command="pin")
    many = bench.copy(done)
    for view in ("two", "one"):
        bench.night(many, view)
        bench.run(many)
    yield Scene("clean", many, bench.cloud(2, "one"), ("--keep", "1", "--clouds", "1", "--reports", "1"), "clean")


def kills(bench: Bench, reduced: bool) -> Row:
    """The run and all its processes, right before each operation that writes."""
    row = Row("killed at a file operation")
    for scene in scenes(bench):
        twin = bench.copy(scene.toy)
        count = bench.operations(twin, *scene.arguments, command=scene.command)
        receipts = bench.receipts(twin)
        bench.discard(twin)
        points = range(1, count + 1)
        for at in sorted(bench.random.sample(points, 2)) if reduced else points:
            twin = bench.copy(scene.toy)
            ended = bench.run(twin, *scene.arguments, strike=Strike(at), command=scene.command)
            what = f"{scene.name}, operation {at} of {count}"
            row.tries += 1
            if ended.code != -signal.SIGKILL:
                bench.sane(row, ended, what, {0})  # an operation more or less, by chance
            missing = len(receipts - bench.receipts(twin)) if scene.command == "run" else 0
            bench.recovered(row, twin, scene.cloud, what, at_most=missing)
            bench.discard(twin)
    return row


def parents(bench: Bench, reduced: bool) -> Row:
    """A run of many processes: all of it, or its parent alone, at some moment; no worker lives on."""
    row = Row("killed at a random moment")
    cloud = bench.cloud(3, "one")
    for k in range(2 if reduced else 40):
        toy = bench.site(3)
        bench.night(toy, "one")
        toy.fault("slow", "0.05")
        process = bench.start(toy, "--jobs", "2")
        time.sleep(bench.random.uniform(0.3, 3.0))
        alone = k % 2 == 1
        (os.kill if alone else os.killpg)(process.pid, signal.SIGKILL)
        process.wait()
        row.tries += 1
        what = f"{'parent alone' if alone else 'all processes'}, try {k}"
        if alone and (left := _left(process.pid, 10.0)):
            row.lost("hang", f"{what}: {left} workers live on")
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        (toy.folder / "faults" / "slow").unlink()
        bench.recovered(row, toy, cloud, what)
        bench.discard(toy)
    return row


def workers(bench: Bench, reduced: bool) -> Row:
    """A worker kills itself in each stage, once or every time."""
    row = Row("worker killed in a stage")
    cloud = bench.cloud(2, "one")
    for stage in list(STAGES)[:: 4 if reduced else 1]:
        for k in range(1 if reduced else 6):
            toy = bench.site(2)
            bench.night(toy, "one")
            fault = "die" if k % 3 == 2 else "once"
            toy.fault(fault, stage)
            what = f"{stage}, {'every time' if fault == 'die' else 'once'}"
            row.tries += 1
            _expect(row, what, bench.start(toy, "--jobs", "2", "-q"), {1, 3} if fault == "die" else {0})
            (toy.folder / "faults" / fault).unlink(missing_ok=True)
            bench.recovered(row, toy, cloud, what)
            bench.discard(toy)
    return row


def _expect(row: Row, what: str, process: subprocess.Popen[str], codes: set[int]) -> None:
    try:
        said = process.communicate(timeout=120)[1]
    except subprocess.TimeoutExpired:
        row.lost("hang", what)
        os.killpg(process.pid, signal.SIGKILL)
        return
    if process.returncode not in codes:
        row.lost("wrong exit", f"{what}: {process.returncode}: {said[-300:]}")
    if "Traceback" in said or "itself failed" in said:
        row.lost("traceback", f"{what}: {said[-500:]}")


def _left(session: int, seconds: float) -> int:
    """Processes of a session that are still there after some seconds."""
    end = time.monotonic() + seconds
    while left := sum(_session(path) == session for path in Path("/proc").glob("[0-9]*/stat")):
        if time.monotonic() > end:
            return left
        time.sleep(0.1)
    return 0


def _session(stat: Path) -> int:
    try:
        fields = stat.read_text().rpartition(")")[2].split()
    except OSError:
        return 0
    return int(fields[3]) if fields[0] != "Z" else 0
