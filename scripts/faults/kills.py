"""Killed processes: a run at each of its file operations, its workers in each stage, its parent alone."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from tests.helpers.toy_site import STAGES, ToySite

from .bench import Bench, Row, Strike


@dataclass(frozen=True)
class Scene:
    """A command to strike, and its expected cloud."""

    name: str
    toy: ToySite
    """The site before the command."""
    cloud: bytes
    arguments: tuple[str, ...] = ()
    command: str = "run"


def first_night(bench: Bench) -> Scene:
    """A first night: nothing is cached."""
    toy = bench.site(without_memo=True)
    bench.night(toy, "one")
    return Scene("first night", toy, bench.cloud(2, "one"))


def nothing_to_do(bench: Bench) -> Scene:
    """The same night again."""
    scene = first_night(bench)
    bench.run(scene.toy)
    return replace(scene, name="nothing to do")


def next_night(bench: Bench) -> Scene:
    """A second night with other captures, after which the first night is not kept."""
    toy = bench.site(keep={"nights": 1, "clouds": 1, "reports": 1})
    bench.night(toy, "one")
    bench.run(toy, "--date", "2026-11-01")
    bench.night(toy, "two")
    return Scene("next night, keep: 1", toy, bench.cloud(2, "two"), ("--date", "2026-11-02"))


def pinning(bench: Bench) -> Scene:
    """`wbflow pin` makes a run the reference."""
    return replace(nothing_to_do(bench), name="pin", command="pin")


def cleaning(bench: Bench) -> Scene:
    """`wbflow clean` removes all but the newest of three nights."""
    scene = nothing_to_do(bench)
    for view in ("two", "one"):
        bench.night(scene.toy, view)
        bench.run(scene.toy)
    return replace(scene, name="clean", command="clean", arguments=("--keep", "1", "--clouds", "1", "--reports", "1"))


def kills_in(make: Callable[[Bench], Scene], together: int) -> Callable[[Bench, bool], Row]:
    """The fault for a scene: the command and all its processes are killed right before each file operation that writes.

    Parameters
    ----------
    make : callable
        Makes the scene.
    together : int
        Number of commands that are killed in sequence before a plain run must recover.
    """

    def kills(bench: Bench, reduced: bool) -> Row:
        scene = make(bench)
        row = Row(f"killed: {scene.name}")
        twin = bench.copy(scene.toy)
        count = bench.operations(twin, *scene.arguments, command=scene.command)
        receipts = bench.receipts(twin)
        bench.discard(twin)
        points = list(range(1, count + 1))
        bench.random.shuffle(points)
        for start in range(0, 2 if reduced else count, together):
            twin = bench.copy(scene.toy)
            group = points[start : start + together]
            what = f"operations {group} of {count}"
            for at in group:
                ended = bench.run(twin, *scene.arguments, strike=Strike(at), command=scene.command)
                if ended.code == -signal.SIGKILL:
                    row.tries += 1
                else:  # earlier commands of the group left it fewer operations than `at`
                    bench.check_exit(row, ended, what, {0})
            missing = len(receipts - bench.receipts(twin)) if scene.command == "run" else 0
            bench.check_recovery(row, twin, scene.cloud, what, at_most=missing)
            bench.discard(twin)
        return row

    return kills


def parents(bench: Bench, reduced: bool) -> Row:
    """A run with two workers is killed at a random moment, entirely or its parent alone; no worker may survive."""
    row = Row("killed at a random moment")
    cloud = bench.cloud(3, "one")
    for k in range(2 if reduced else 60):
        toy = bench.site(3)
        bench.night(toy, "one")
        toy.fault("slow", "0.05")
        is_new = k % 10 > 7
        process = bench.start(toy, "--jobs", "2", new_interpreter=is_new)
        time.sleep(bench.random.uniform(0.3, 3.0) if is_new else bench.random.uniform(0.05, 1.0))
        alone = k % 2 == 1
        (os.kill if alone else os.killpg)(process.pid, signal.SIGKILL)
        process.wait()
        row.tries += 1
        what = f"{'parent alone' if alone else 'all processes'}, try {k}"
        if alone and (left := _left(process.pid, 10.0)):
            row.add_loss("hang", f"{what}: {left} workers live on")
        (toy.folder / "faults" / "slow").unlink()
        bench.check_recovery(row, toy, cloud, what)
        bench.discard(toy)
    return row


def workers(bench: Bench, reduced: bool) -> Row:
    """A worker kills itself in a stage, once or every time; all stages are tried."""
    row = Row("worker killed in a stage")
    cloud = bench.cloud(2, "one")
    for stage in list(STAGES)[:: 4 if reduced else 1]:
        for k in range(1 if reduced else 60):
            toy = bench.site(2)
            bench.night(toy, "one")
            fault = "die" if k % 3 == 2 else "once"
            toy.fault(fault, stage)
            what = f"{stage}, {'every time' if fault == 'die' else 'once'}"
            row.tries += 1
            ended = bench.start(toy, "--jobs", str(1 + k % 3), "-q", new_interpreter=k % 20 == 19).wait()
            bench.check_exit(row, ended, what, {1, 3} if fault == "die" else {0})
            (toy.folder / "faults" / fault).unlink(missing_ok=True)
            bench.check_recovery(row, toy, cloud, what)
            bench.discard(toy)
    return row


def _left(session: int, seconds: float) -> int:
    """Number of processes of a session that are still alive after this many seconds."""
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
