"""A run's folder is published whole or not at all, and later runs and versions can read it."""

from __future__ import annotations

import datetime
import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.wbflow.records.test_record import some_record
from wbflow.cache.layout import WorkFolder, run_id
from wbflow.records.events import Event, TaskEvent, WarningEvent, event_from_json, event_to_json
from wbflow.records.findings import Level, Verdict
from wbflow.records.run_folder import NoSuchRun, RunFolder, UnfinishedRun, new_run, update_links
from wbflow.task import Task

REJECTED = TaskEvent(
    Task("matches", ("gate", "roof")), "rejected", "t", fresh=True, reason="3 inliers", code="too-few", key="ab", cpu=0.1
)
EVENTS: list[Event] = [
    REJECTED,
    WarningEvent("picture not drawn", "t", Task("frames", ("gate",)), "install more", "Traceback"),
    WarningEvent("the ledger was not written", "t"),
]


def publish(
    work: WorkFolder, name: str, cloud: bool = True, level: Level | None = "degraded", date: str = "2026-11-19"
) -> RunFolder:
    unfinished = UnfinishedRun(work, name)
    if cloud:
        unfinished.write("cloud.ply", b"ply")
        unfinished.write("cloud-component-2.ply", b"more")
        unfinished.write_cameras({"gate": {"K": []}})
    record = replace(some_record(), run=name, date=date, verdict=Verdict(level) if level else None)
    return unfinished.publish(record, EVENTS, "<html>")


def test_a_published_run_is_read_as_it_was_written(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    folder = publish(work, "20261120T031500Z")
    assert sorted(path.name for path in folder.paths.folder.iterdir()) == [
        "cameras.json",
        "cloud-component-2.ply",
        "cloud.ply",
        "log.jsonl",
        "metrics.prom",
        "report.html",
        "run.json",
    ]
    assert RunFolder.at(folder.paths.folder).record().cameras[0].id == "gate"
    assert folder.events() == EVENTS
    assert folder.tasks() == {REJECTED.task: REJECTED}
    assert folder.cameras() == {"gate": {"K": []}}
    assert RunFolder.of(work, "latest").id == RunFolder.of(work, "latest-good").id == RunFolder.of(work).id == folder.id


def test_an_unpublished_run_is_not_listed_and_is_removed_if_abandoned(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20261120T031500Z")
    UnfinishedRun(work, "20261121T031500Z").write("cloud.ply", b"half")
    assert work.run_ids() == ["20261120T031500Z"]
    work.start_writing()
    assert work.unfinished_run("20261121T031500Z").folder.exists(), "nobody has said that it was left behind"
    work.start_writing()
    assert not work.unfinished_run("20261121T031500Z").folder.exists()


def test_latest_is_the_newest_run_and_latest_good_the_last_good_one(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20261120T031500Z")
    publish(work, "20261121T031500Z", level="failed")
    publish(work, "20261122T031500Z", cloud=False)
    assert work.latest.resolve().name == RunFolder.of(work, "latest").id == RunFolder.of(work).id == "20261122T031500Z"
    assert work.latest_good.resolve().name == RunFolder.of(work, "latest-good").id == "20261120T031500Z"


def test_a_rerun_of_an_old_night_does_not_take_the_links_from_the_newest_night(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    dates = {"20261120T031500Z": "2026-11-19", "20261121T031500Z": "2026-11-20", "20261121T120000Z": "2026-11-12"}
    for name, date in dates.items():
        publish(work, name, date=date)
    assert work.link_target(work.latest) == work.link_target(work.latest_good) == "20261121T031500Z"
    assert RunFolder.of(work).id == RunFolder.of(work, "latest").id == "20261121T031500Z"
    assert RunFolder.of(work, "2026-11-12").id == "20261121T120000Z"
    publish(work, "20261121T130000Z", date="2026-11-20")  # the newest night again
    assert work.link_target(work.latest) == "20261121T130000Z"
    work.latest.unlink()
    assert RunFolder.of(work).id == "20261121T130000Z"


def test_the_last_good_run_is_found_without_the_link_latest_good(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20261120T031500Z", level=None)
    publish(work, "20261121T031500Z", cloud=False, level=None)
    work.latest_good.unlink()
    assert RunFolder.of(work, "latest-good").id == "20261120T031500Z"


def test_links_are_repaired_after_a_kill_and_published_files_are_kept(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20261120T031500Z")
    newest = publish(work, "20261121T031500Z").paths
    files = {path.name: path.read_bytes() for path in newest.folder.iterdir()}
    work.start_writing()
    for link in (work.latest, work.latest_good):
        work.point_link(link, "20261120T031500Z")  # its state at the time of the kill
    work.unfinished_run(work.latest.name).folder.symlink_to(newest.folder.name)
    assert work.start_writing(), "somebody was killed"
    update_links(work)
    assert {path.name: path.read_bytes() for path in newest.folder.iterdir()} == files
    assert sorted(path.name for path in work.runs.iterdir()) == [
        "20261120T031500Z",
        "20261121T031500Z",
        "latest",
        "latest-good",
    ]
    assert {link.resolve().name for link in (work.latest, work.latest_good)} == {"20261121T031500Z"}


def test_half_written_files_left_by_a_kill_are_removed_everywhere(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20261120T031500Z")
    work.start_writing()
    folders = (work.root, work.cache / "frames", work.reference, work.runs, work.run("20261120T031500Z").folder)
    for folder in folders:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".delivered.json.1.ab.tmp").write_bytes(b"half")
    assert work.start_writing(), "somebody was killed"
    assert not [path for folder in folders for path in folder.glob(".*.tmp")]


def test_a_dangling_link_is_updated_to_the_newest_run(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20261120T031500Z")
    work.point_link(work.latest, "20261121T031500Z")
    update_links(work)
    assert work.latest.resolve().name == "20261120T031500Z"


def test_run_ids_increase_even_if_the_clock_is_set_back(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20991231T235959Z")
    (work.runs / "copy-of-mine").mkdir()
    name, moment = new_run(work)
    assert name == "21000101T000000Z"
    assert moment.year < 2099


def test_later_events_can_be_added_to_the_log(tmp_path: Path) -> None:
    folder = publish(WorkFolder(tmp_path), "20261120T031500Z")
    later = WarningEvent("the disk is slow", "t")
    folder.add(later)
    assert folder.events() == [*EVENTS, later]


@pytest.mark.parametrize(
    ("name", "message"), [(None, "has no runs yet"), ("19990101T000000Z", "has no runs yet"), ("latest", "has no runs yet")]
)
def test_opening_a_run_of_an_empty_work_folder_fails_with_a_message(tmp_path: Path, name: str | None, message: str) -> None:
    with pytest.raises(NoSuchRun, match=message):
        RunFolder.of(WorkFolder(tmp_path), name)


def test_missing_and_unreadable_runs_are_named_in_the_error(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    folder = publish(work, "20261120T031500Z", cloud=False)
    with pytest.raises(NoSuchRun, match="no run has made a cloud yet"):
        RunFolder.of(work, "latest-good")
    with pytest.raises(NoSuchRun, match="there is no run '19990101T000000Z'; the last ones are 20261120T031500Z"):
        RunFolder.of(work, "19990101T000000Z")
    folder.paths.record.write_text("{}")
    folder.paths.log.write_text("{")
    with pytest.raises(NoSuchRun, match="is not the folder of a run"):
        folder.record()
    with pytest.raises(NoSuchRun, match="cannot be read"):
        folder.events()


def test_unknown_events_and_keys_of_later_versions_are_ignored() -> None:
    assert event_from_json({"event": "pinned", "at": "t", "who": "me"}) is None
    line = json.loads(json.dumps(event_to_json(REJECTED)))
    assert event_from_json(line | {"more": 1}) == REJECTED


def test_a_warning_is_printed_with_its_task_and_remedy() -> None:
    assert str(EVENTS[1]) == "frames gate: picture not drawn; install more"


def test_no_run_id_is_used_twice(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    first, moment = new_run(work)
    publish(work, first)
    second, later = new_run(work)
    assert first == run_id(moment)
    assert second == max(run_id(later), run_id(moment + datetime.timedelta(seconds=1)))
