"""The runs that found what changed, in the order of their nights, whatever the order of the runs; few records are read."""

from __future__ import annotations

import datetime
from dataclasses import replace
from pathlib import Path

import pytest

from tests.wbflow.records.test_record import some_record
from wbflow.cache.layout import WorkFolder
from wbflow.pipeline.summaries import ChangesSummary, RecordedChange
from wbflow.records import run_folder
from wbflow.records.record import RunRecord
from wbflow.records.run_folder import RunFolder, UnfinishedRun, compared_before, ended_change, newest_compared

REFERENCE = "20260101T031500Z"
CRATE = RecordedChange("new", 1.0, 2.0, id="C1")


def publish(
    work: WorkFolder, run: str, date: str, reference: str = REFERENCE, *, compared: bool = True, things: bool = False
) -> None:
    found = ChangesSummary(compared=compared, changes={"C1": CRATE} if things else {})
    record = replace(some_record(), run=run, date=date, reference=reference, results={"changes": found})
    UnfinishedRun(work, run).publish(record, [], "")


def before(work: WorkFolder, date: str, reference: str = REFERENCE) -> list[tuple[str, str]]:
    return [(record.date, folder.id[6:8]) for folder, record in compared_before(work, date, reference)]


def test_nights_come_newest_first_each_with_its_last_run(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20261119T031500Z", "2026-11-18")
    publish(work, "20261121T031500Z", "2026-11-20")
    publish(work, "20261122T031500Z", "2026-11-21", compared=False)
    publish(work, "20261123T031500Z", "2026-11-19")  # late
    publish(work, "20261124T031500Z", "2026-11-18")  # again
    publish(work, "20261125T031500Z", "2026-11-24", reference="20261101T031500Z")
    assert before(work, "2026-11-30") == [("2026-11-20", "21"), ("2026-11-19", "23"), ("2026-11-18", "24")]
    assert before(work, "2026-11-20") == [("2026-11-19", "23"), ("2026-11-18", "24")]
    assert before(work, "", "20261101T031500Z") == [("2026-11-24", "25")]
    assert before(work, "", "") == [("2026-11-24", "25"), ("2026-11-20", "21"), ("2026-11-19", "23"), ("2026-11-18", "24")]


@pytest.mark.parametrize("late", [False, True])
def test_the_night_before_is_found_by_reading_one_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, late: bool) -> None:
    """Of nights that were worked on one by one, and of a backlog that was worked on in an hour."""
    work = WorkFolder(tmp_path)
    first = datetime.date(2026, 3, 1)
    for k in range(40):
        night = first + datetime.timedelta(days=k)
        run = f"20261101T03{k:02}00Z" if late else f"{night + datetime.timedelta(days=1):%Y%m%d}T031500Z"
        publish(work, run, str(night))
    read: list[str] = []
    record_of = RunFolder.record

    def counted(folder: RunFolder) -> RunRecord:
        read.append(folder.id)
        return record_of(folder)

    monkeypatch.setattr(run_folder.RunFolder, "record", counted)
    tonight = first + datetime.timedelta(days=40)
    _, found = next(compared_before(work, str(tonight), REFERENCE))
    assert found.date == str(tonight - datetime.timedelta(days=1))
    assert len(read) == 1


def test_a_change_that_has_ended_is_found_with_the_night_on_which_it_was_gone(tmp_path: Path) -> None:
    work = WorkFolder(tmp_path)
    publish(work, "20261119T031500Z", "2026-11-18", things=True)
    for day in (19, 20):
        publish(work, f"202611{day + 1}T031500Z", f"2026-11-{day}")
    found = ended_change(work, "C1")
    assert found
    assert (found[0].kind, found[1]) == ("new", "2026-11-19")
    assert ended_change(work, "C2") is None
    newest = newest_compared(work)
    assert newest
    assert newest.date == "2026-11-20"
