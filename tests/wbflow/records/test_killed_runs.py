"""Runs that were killed stand in the history."""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path

from tests.helpers.toy_site import ToySite


def kill_a_run(toy: ToySite) -> None:
    """Start a run, and kill it without warning after its first results."""
    toy.fault("slow", "0.3")
    process = subprocess.Popen(toy.command("run", str(toy.file), "--jobs", "1"), env=toy.env(), stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while not list((toy.work / "cache").glob("frames/*/*.json")):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.02)
    process.kill()
    process.wait()
    (toy.folder / "faults" / "slow").unlink()


def rows(toy: ToySite) -> list[dict[str, object]]:
    listed: list[dict[str, object]] = json.loads(toy.wbflow("history", "--json").stdout)
    return listed


def test_a_killed_run_stands_in_the_history_with_its_time_and_how_far_it_came(toy: ToySite) -> None:
    kill_a_run(toy)
    (killed,) = rows(toy)
    assert killed["killed"] and killed["verdict"] is None
    assert str(killed["started"]) <= str(killed["finished"])
    ran = killed["ran"]
    assert isinstance(ran, int) and ran >= 1
    assert f"killed or crashed after {ran} task" in toy.wbflow("history").stdout


def test_it_stays_in_the_history_after_the_run_that_continues_it(toy: ToySite) -> None:
    kill_a_run(toy)
    (before,) = rows(toy)
    toy.run()
    killed, finished = rows(toy)
    assert killed == before
    assert not finished["killed"] and finished["exit_code"] == 0
    toy.run()
    assert len(rows(toy)) == 3
    assert [row["exit_code"] for row in json.loads(toy.wbflow("runs", "--json").stdout)] == [0, 0]  # it has no results


def test_a_run_that_is_at_work_is_not_called_killed(toy: ToySite) -> None:
    toy.fault("slow", "0.3")
    process = subprocess.Popen(toy.command("run", str(toy.file), "--jobs", "1"), env=toy.env(), stdout=subprocess.DEVNULL)
    try:
        mark = Path(toy.work / "current-run.json")
        deadline = time.monotonic() + 60
        while not mark.exists():
            assert time.monotonic() < deadline and process.poll() is None
            time.sleep(0.02)
        assert rows(toy) == []
    finally:
        process.kill()
        process.wait()
