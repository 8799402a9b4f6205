"""Measurements of a camera on earlier nights: only the last nights are read, however many there are."""

from __future__ import annotations

import datetime
from dataclasses import replace
from pathlib import Path

import pytest

from tests.wbflow.records.test_record import some_record
from wbflow.cache.layout import RunPaths, WorkFolder
from wbflow.records import run_folder
from wbflow.records.record import CameraRecord, RunRecord
from wbflow.records.run_folder import RunFolder, UnfinishedRun
from wbflow.reference.resolve import MOST_NIGHTS, shift_history
from wbflow_stages.contracts.camera_figures import Health

REFERENCE = "20260101T031500Z"
FIRST = datetime.date(2026, 1, 2)


def night(number: int, shift: float, reference: str = REFERENCE) -> RunRecord:
    """The record of the night `number` days after the first."""
    date = FIRST + datetime.timedelta(days=number)
    figures = {"shift_x_px": shift, "shift_y_px": 0.0, "roll_deg": 0.0}
    gate = CameraRecord("gate", "ok", health=Health("ok", figures=figures))
    return replace(some_record(), run=f"{date:%Y%m%d}T031500Z", date=str(date), cameras=(gate,), reference=reference)


def work_with(folder: Path, records: list[RunRecord]) -> WorkFolder:
    work = WorkFolder(folder)
    for record in records:
        UnfinishedRun(work, record.run).publish(record, [], "")
    return work


def test_shifts_come_from_the_last_nights_and_few_records_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = night(19, 77.0, reference="another")
    work = work_with(tmp_path, [*(night(k, float(k)) for k in range(19)), other, night(20, 99.0)])
    read: list[RunPaths] = []
    record = RunFolder.record

    def counted(run: RunFolder) -> RunRecord:
        read.append(run.paths)
        return record(run)

    monkeypatch.setattr(run_folder.RunFolder, "record", counted)
    past = shift_history(work, night=night(20, 0.0).date, reference=REFERENCE)
    shifts = past["gate"]["shift_x_px"]
    assert shifts == [float(k) for k in range(19 - MOST_NIGHTS, 19)], "oldest first; neither tonight's nor another reference's"
    assert "roof" not in past
    assert len(read) == MOST_NIGHTS + 2


def test_no_run_from_before_the_reference_is_read(tmp_path: Path) -> None:
    work = work_with(tmp_path, [night(k, float(k)) for k in range(3)])
    assert shift_history(work, night="2026-02-01", reference=night(1, 0.0).run) == {}
