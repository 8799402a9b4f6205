"""A task that hangs, ends its worker or fills the memory fails alone, with any number of workers."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from tests.helpers.toy_site import ToySite
from wbflow.cli.main import main
from wbflow.records.costs import TaskCosts
from wbflow.runner import limits
from wbflow.runner.dispatch import Dispatcher
from wbflow.runner.executors import Processes
from wbflow.runner.limits import Limits
from wbflow.task import Task

WICKED = '''
import os, sys, time
import numpy as np
from toy_stages import detect as well

def detect(frame, *, at: float = 0.0):
    """Does to its process what the file `wicked` beside the faults says."""
    features = well(frame)
    with open(os.path.join(os.environ["TOY_FAULTS"], "did"), "a") as did:
        did.write(f"{features.xy[0, 0]}\\n")
    what, _, where = open(os.path.join(os.environ["TOY_FAULTS"], "wicked")).read().partition(" ")
    if what == "hold":
        held = np.ones(300_000_000, np.uint8)
        time.sleep(0.6)
    if str(int(features.xy[0, 1])) == where:
        if what == "hang":
            time.sleep(3600)
        if what == "leave":
            os._exit(3)
        if what == "exit":
            sys.exit("enough")
        if what == "fill":
            held = [np.ones(20_000_000, np.uint8) for _ in range(30)]
            time.sleep(3600)
        if what == "shout":
            raise ValueError("\\x1b[2J" + "x" * 5_000_000)
    return features
'''


@pytest.fixture
def wicked(toy: ToySite) -> ToySite:
    """A site in which one task, `features roof`, misbehaves as the test specifies (`behave`)."""
    (toy.folder / "wicked_stage.py").write_text(WICKED)
    site = json.loads(toy.file.read_text())
    site["stages"]["features"] = {"use": "wicked_stage:detect"}
    toy.file.write_text(json.dumps(site))
    return toy


def behave(site: ToySite, what: str) -> None:
    import hashlib

    site.fault("wicked", f"{what} {hashlib.sha256(b'a view from roof').digest()[0]}")


def reason_of(record: dict[str, Any]) -> str:
    assert record["tasks"]["failed"] == 1
    assert record["cloud"] is not None, "three cameras are left"
    reason: str = next(camera for camera in record["cameras"] if camera["id"] == "roof")["reason"]
    return reason


@pytest.mark.parametrize(
    ("what", "message", "options"),
    [
        ("hang", "took longer than 20 s", ("--jobs", "1", "--time-limit", "20")),  # on a busy machine imports alone take seconds
        ("leave", "exit code 3, twice", ("--jobs", "1")),
        ("leave", "exit code 3, twice", ("--jobs", "2")),
        ("exit", "sys.exit('enough')", ("--jobs", "1")),
        ("fill", "ran out of memory: it held", ("--jobs", "2", "--memory", "500MB")),
    ],
)
def test_a_misbehaving_task_fails_alone_and_its_reason_is_reported(
    wicked: ToySite, what: str, message: str, options: tuple[str, ...]
) -> None:
    behave(wicked, what)
    assert message in reason_of(wicked.run(*options, code=3))


def test_only_the_chain_that_ends_its_worker_is_repeated(tmp_path: Path) -> None:
    site = ToySite(tmp_path / "toy", [f"c{k:02d}" for k in range(11)] + ["roof"])
    (site.folder / "wicked_stage.py").write_text(WICKED)
    described = json.loads(site.file.read_text())
    described["stages"]["features"] = {"use": "wicked_stage:detect"}
    described["cameras"] = ["c00", "c01", "c02", "roof", *site.cameras[3:-1]]
    site.file.write_text(json.dumps(described))
    behave(site, "leave")
    result = site.wbflow("run", "--jobs", "1", "--until", "features")
    assert result.returncode == 3, result.stderr
    done = sorted(Counter((site.folder / "faults" / "did").read_text().split()).values())
    assert done == [1] * 11 + [2], "once more alone, and nobody else for its sake"


def test_a_huge_exception_text_with_escape_codes_becomes_a_short_reason(wicked: ToySite) -> None:
    behave(wicked, "shout")
    result = wicked.wbflow("run", "--jobs", "1")
    assert result.returncode == 3
    assert "\x1b" not in result.stdout + result.stderr and r"\x1b[2J" in result.stderr
    assert len(result.stderr) < 5000
    newest = max((wicked.work / "runs").glob("2*"))
    assert all(len(file.read_bytes()) < 500_000 for file in newest.iterdir())


def test_a_lost_worker_is_reported_with_the_task_that_it_was_running(toy: ToySite) -> None:
    toy.fault("once", "geometry")
    result = toy.wbflow("run", "--jobs", "1")
    assert result.returncode == 0, result.stderr
    lost = [line for line in result.stderr.splitlines() if "SIGKILL" in line]
    assert len(lost) == 1 and " warning: geometry " in lost[0], "the task that was at work is named"
    assert "memory" not in lost[0]


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
def test_workers_end_when_their_run_is_killed(toy: ToySite) -> None:
    toy.fault("slow", "30")
    process = subprocess.Popen(toy.command("run", str(toy.file), "--jobs", "2"), env=toy.env(), start_new_session=True)
    working = toy.folder / "faults"
    until(lambda: len(list(working.glob("slow-*"))) == 2)
    workers = [int(file.name.removeprefix("slow-")) for file in working.glob("slow-*")]
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    until(lambda: not any(Path(f"/proc/{worker}").exists() for worker in workers))
    theirs = {str(pid) for pid in (process.pid, *workers)}
    # joblib's shared-memory tracker outlives the workers briefly
    until(lambda: not [path for path in Path("/dev/shm").glob("*") if theirs & set(re.findall(r"\d+", path.name))])


def test_an_interrupted_run_keeps_finished_results_and_no_half_written_files(
    toy: ToySite, monkeypatch: pytest.MonkeyPatch
) -> None:
    toy.fault("slow", "0.1")

    def interrupted(dispatcher: Dispatcher) -> None:
        """Ctrl-C after a worker has finished one task of its chain, during the next one."""
        dispatcher._begin()
        until(lambda: any(toy.work.rglob("frames/*/*.json")))
        time.sleep(0.05)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Dispatcher, "wait", interrupted)
        assert CliRunner().invoke(main, ["run", str(toy.file), "--jobs", "1", "-q"], env=toy.env()).exit_code == 130
    assert not list(toy.work.rglob("*.tmp"))
    assert list((toy.work / "cache").glob("frames/*/*.json"))
    (toy.folder / "faults" / "slow").unlink()
    assert toy.run()["tasks"]["cached"] >= 1


def until(so: Any, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not so():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_night_with_nothing_to_do_starts_no_worker(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    toy.run()

    def refuse(*arguments: object, **more: object) -> None:
        raise AssertionError("a worker was started")

    monkeypatch.setattr(Processes, "submit", refuse)
    assert toy.run()["tasks"]["ran"] == 0


def test_the_time_limit_of_a_task_depends_on_earlier_times_of_its_stage() -> None:
    past = TaskCosts({"quick": 0.1, "slow": 300.0, "endless": 1e5})
    known = Limits(2**30, costs=past)
    assert known.seconds_for("quick") == limits.LEAST_SECONDS
    assert known.seconds_for("slow") == limits.TIMES_MEDIAN * 300
    assert known.seconds_for("endless") == known.seconds_for("new") == limits.MOST_WAIT_SECONDS
    assert Limits(2**30, seconds=5.0, costs=past).seconds_for("slow") == 5


def test_tasks_that_together_exceed_the_memory_run_one_after_the_other(wicked: ToySite) -> None:
    behave(wicked, "hold")
    wicked.run("--jobs", "1", "--until", "features")
    held = [json.loads(path.read_text())["peak_rss_mb"] for path in (wicked.work / "cache" / "features").glob("*/*.json")]
    assert all(286 < mb < 450 for mb in held), held
    (wicked.folder / "faults" / "did").unlink()
    again = wicked.wbflow("run", "--jobs", "2", "--until", "features", "--force", "features", "--memory", "500MB")
    assert again.returncode == 0 and "alone" not in again.stderr, again.stderr
    assert len((wicked.folder / "faults" / "did").read_text().split()) == len(held), "nobody was ended for another's sake"


def test_memory_used_before_and_tonight_decides_which_tasks_fit() -> None:
    fuse, gate, roof = Task("fuse"), Task("depth", ("gate",)), Task("depth", ("roof",))
    past = TaskCosts(stages_mb={"fuse": 900.0, "depth": 100.0}, tasks_mb={str(gate): 300.0})
    holding = Limits(memory=1000 * 2**20, costs=past)
    assert holding.fits([], [fuse]) and holding.fits([[fuse]], [roof])
    assert not holding.fits([[fuse]], [gate]), "it held 300 MB the last time"
    assert holding.fits([[fuse]], [Task("new", ("roof",))]), "nobody knows"
    holding.learn("new", 700.0)
    assert not holding.fits([[Task("new", ("roof",))]], [Task("new", ("gate",))])


def test_an_invalid_memory_limit_is_refused(toy: ToySite) -> None:
    result = toy.wbflow("run", "--memory", "4 apples")
    assert result.returncode == 2
    assert "--memory: '4 apples' is not a size" in result.stderr


LOUD = '''
import os, sys
from toy_stages import detect as well

def detect(frame):
    """Prints as libraries do: on the descriptors of the process, and as Python does, and leaves a line unfinished."""
    os.write(2, b"Corrupt JPEG data: 40 extraneous bytes\\n")
    os.write(1, b"[h264 @ 0x55] error while decoding MB\\n")
    print("in Python")
    print("begun 7", file=sys.stderr)
    sys.stderr.flush()
    os.write(2, b"libpng warning: unfinished")
    return well(frame)
'''


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_what_libraries_print_is_in_the_log_and_nowhere_else(toy: ToySite, jobs: str) -> None:
    (toy.folder / "loud_stage.py").write_text(LOUD)
    site = json.loads(toy.file.read_text())
    site["stages"]["features"] = {"use": "loud_stage:detect"}
    toy.file.write_text(json.dumps(site))
    result = toy.wbflow("run", "-q", "--jobs", jobs)
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
    log = [json.loads(line) for line in (toy.work / "runs" / "latest" / "log.jsonl").read_text().splitlines()]
    printed = {line["task"]: line["what"] for line in log if line["event"] == "output"}
    assert set(printed) == {f"features {camera}" for camera in toy.cameras}
    for text in printed.values():
        for words in ("40 extraneous bytes", "error while decoding MB", "in Python", "libpng warning: unfinished"):
            assert words in text
    assert toy.wbflow("report").returncode == 0


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_what_libraries_print_in_threads_is_in_the_log_and_nowhere_else(toy: ToySite, jobs: str) -> None:
    (toy.folder / "loud_stage.py").write_text(LOUD)
    site = json.loads(toy.file.read_text())
    site["stages"]["features"] = {"use": "loud_stage:detect"}
    toy.file.write_text(json.dumps(site))
    result = toy.wbflow("run", "-q", "--backend", "threading", "--jobs", jobs)
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
    log = [json.loads(line) for line in (toy.work / "runs" / "latest" / "log.jsonl").read_text().splitlines()]
    [text] = [line["what"] for line in log if line["event"] == "output"]
    for words in ("40 extraneous bytes", "error while decoding MB", "in Python", "libpng warning: unfinished"):
        assert text.count(words) == len(toy.cameras)
    assert toy.wbflow("report").returncode == 0
    loud = toy.wbflow("run", "--backend", "threading", "--force", "features")
    assert "libpng" not in loud.stdout + loud.stderr and "features" in loud.stdout + loud.stderr


@pytest.mark.parametrize("threads", [1, 2])
def test_what_libraries_print_in_a_dask_worker_is_in_the_log_and_nowhere_else(
    toy: ToySite, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], threads: int
) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra wbflow[dask] is not installed")
    (toy.folder / "loud_stage.py").write_text(LOUD)
    site = json.loads(toy.file.read_text())
    site["stages"]["features"] = {"use": "loud_stage:detect"}
    toy.file.write_text(json.dumps(site))
    for name, value in toy.env().items():
        monkeypatch.setenv(name, value)
    with distributed.LocalCluster(n_workers=1, threads_per_worker=threads, processes=True, dashboard_address=None) as cluster:
        result = toy.wbflow("run", "-q", "--backend", "dask", "--scheduler", cluster.scheduler_address)
        # what a worker prints that works on nothing is its own again
        cluster.get_client().run(os.write, 2, b"at rest")
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
    log = [json.loads(line) for line in (toy.work / "runs" / "latest" / "log.jsonl").read_text().splitlines()]
    text = "".join(line["what"] for line in log if line["event"] == "output")
    by_worker = "".join(capfd.readouterr())
    assert "at rest" in by_worker
    for words in ("40 extraneous bytes", "error while decoding MB", "in Python", "libpng warning: unfinished"):
        assert text.count(words) == len(toy.cameras)
        assert words not in by_worker


def test_what_a_lost_worker_has_printed_is_in_the_log(wicked: ToySite) -> None:
    (wicked.folder / "wicked_stage.py").write_text(WICKED.replace("os._exit(3)", 'os.write(2, b"terminate called"), os._exit(3)'))
    behave(wicked, "leave")
    wicked.run("--jobs", "1", code=3)
    assert "terminate called" in (wicked.work / "runs" / "latest" / "log.jsonl").read_text()
