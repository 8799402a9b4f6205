"""A night on which nothing has changed is published once more without being planned; whatever has changed is noticed."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.toy_site import ToySite
from wbflow.store.events import WarningEvent
from wbflow.store.layout import WorkFolder
from wbflow.store.ledger import Ledger
from wbflow.store.run_folder import RunFolder

TIMES = {"run", "started", "finished", "seconds", "peak_rss_mb", "same_as", "signed"}


@pytest.fixture
def toy(toy: ToySite) -> ToySite:
    """Tasks are done in threads: who did them does not matter here."""
    toy.backend = "threading"
    return toy


def folder(toy: ToySite, record: dict[str, Any]) -> Path:
    return toy.work / "runs" / str(record["run"])


def told(record: dict[str, Any]) -> dict[str, Any]:
    """All but what a run's moment decides, and what it is compared with (planned again, it has itself as its past)."""
    cameras = [{**camera, "health": None} for camera in record["cameras"]]
    return {name: value for name, value in record.items() if name not in {*TIMES, "usual"}} | {"cameras": cameras}


def test_the_same_night_again_is_told_as_a_plan_would_tell_it(toy: ToySite) -> None:
    first, again = toy.run(), toy.run()
    assert again["same_as"] == first["run"]
    assert again["tasks"] == {"cached": sum(first["tasks"].values()), "ran": 0, "rejected": 0, "failed": 0, "skipped": 0}
    for name in ("cloud.ply", "report.html"):
        assert (folder(toy, again) / name).read_bytes() == (folder(toy, first) / name).read_bytes()
    WorkFolder(toy.work).unchanged_memo.unlink()
    planned = toy.run()
    assert "same_as" not in planned
    assert told(planned) == told(again)
    events = [RunFolder(WorkFolder(toy.work).run(record["run"])).tasks() for record in (again, planned)]
    assert {task: (event.outcome, event.key) for task, event in events[0].items()} == {
        task: (event.outcome, event.key) for task, event in events[1].items()
    }
    with Ledger(WorkFolder(toy.work)) as ledger:
        assert [(run.run, run.cached) for run in ledger.runs()][1:] == [
            (r["run"], r["tasks"]["cached"]) for r in (again, planned)
        ]
        assert ledger.keys_of_runs([again["run"]]) == ledger.keys_of_runs([planned["run"]])


def test_a_person_is_told_which_run_it_repeats(toy: ToySite) -> None:
    first = toy.run()["run"]
    said = toy.wbflow("run", "--jobs", "1").stdout
    assert f"nothing has changed since run {first}" in said
    assert "wbflow history" in said and "wbflow compare" not in said
    assert toy.wbflow("history").stdout.splitlines()[-1].endswith(f"the same as {first}: good")


def cut(path: Path) -> None:
    path.chmod(0o644)
    path.write_bytes(path.read_bytes()[:-1])


def flipped(path: Path) -> None:
    path.chmod(0o644)
    data = path.read_bytes()
    path.write_bytes(data[:-3] + bytes([data[-3] ^ 1]) + data[-2:])


def piped(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def stated(toy: ToySite) -> None:
    site = json.loads(toy.file.read_text())
    toy.file.write_text(json.dumps({**site, "expect": {"points": 0.5}}))


def first(toy: ToySite, pattern: str) -> Path:
    return next(iter(sorted(toy.work.glob(pattern))))


TOUCHED: dict[str, Callable[[ToySite], object]] = {
    "an artifact is gone": lambda toy: first(toy, "cache/matches/*/*.wbf").unlink(),
    "an artifact is cut short": lambda toy: cut(first(toy, "cache/geometry/*/*.wbf")),
    "a receipt is damaged": lambda toy: flipped(first(toy, "cache/frames/*/*.json")),
    "a picture is damaged": lambda toy: flipped(first(toy, "cache/geometry/*/*.jpg")),
    "a copy of the reference is gone": lambda toy: first(toy, "reference/features/*/*.wbf").unlink(),
    "the published cloud is damaged": lambda toy: flipped(toy.work / "runs" / "latest" / "cloud.ply"),
    "the report is gone": lambda toy: (toy.work / "runs" / "latest" / "report.html").unlink(),
    "what is remembered is damaged": lambda toy: flipped(WorkFolder(toy.work).unchanged_memo),
    "what goes with it is damaged": lambda toy: flipped(WorkFolder(toy.work).unchanged_data),
    "a pipe is in its place": lambda toy: piped(WorkFolder(toy.work).unchanged_data),
    "a capture is another": lambda toy: toy.capture("roof").write_text("another view"),
    "the site file says something else": stated,
}


def test_whatever_is_touched_the_night_is_planned_and_the_next_one_is_the_same_again(toy: ToySite) -> None:
    toy.run()
    for what, touch in TOUCHED.items():
        cloud = toy.cloud
        touch(toy)
        planned, again = toy.run(), toy.run()
        assert "same_as" not in planned, what
        assert planned["tasks"]["failed"] == 0, what
        if not planned["repaired"]:  # a night that has repaired something is planned once more, and finds all in order
            assert again["same_as"] == planned["run"], what
        assert toy.run()["same_as"], what
        assert toy.cloud == cloud or "capture" in what


def test_a_night_that_warns_every_time_says_it_again_and_is_not_planned(toy: ToySite) -> None:
    toy.run()
    toy.keys = {"cameras": toy.cameras[:3], "pairs": {"degree": 40}}  # not those of the reference; more than a view takes
    toy.write()
    first, again = toy.run(), toy.run()
    assert again["same_as"] == first["run"]
    for record in (first, again):
        events = RunFolder(WorkFolder(toy.work).run(record["run"])).events()
        warnings = [event.what for event in events if isinstance(event, WarningEvent)]
        assert len(warnings) == 2 and "takes 32 pairs at most" in warnings[0] and "the reference is not used" in warnings[1]
    said = toy.wbflow("run", "-q").stderr
    assert said.count("takes 32 pairs at most") == said.count("the reference is not used") == 1
    assert toy.run()["same_as"]


@pytest.mark.parametrize("arguments", [["--until", "poses"], ["--force", "fuse"]])
def test_who_asks_for_something_else_gets_it(toy: ToySite, arguments: list[str]) -> None:
    toy.run()
    assert "same_as" not in toy.run(*arguments)
