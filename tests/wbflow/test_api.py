"""The Python interface of wbflow."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import wbflow
from tests.helpers.toy_site import ToySite
from wbflow.cache.layout import WorkFolder
from wbflow.cache.lock import Locked, hold
from wbflow.errors import UsageError, WbflowError
from wbflow.records.events import Event, Signal, TaskEvent, WarningEvent
from wbflow.records.ledger import Ledger
from wbflow.records.run_folder import NoSuchRun
from wbflow.task import Task


def test_a_site_can_be_loaded_run_and_read_in_python(toy: ToySite) -> None:
    site = wbflow.load_site(toy.file)
    run = wbflow.run(site, jobs=1)
    assert run.record.exit_code == 0
    assert run.cameras["gate"].ok and run.cameras["gate"].figures.keypoints == 1
    assert run.pairs["gate--roof"].figures.density == 1.0
    assert (
        np.asarray(run.cloud.points).shape == (12, 3) == np.asarray(run.cloud.colors).shape == np.asarray(run.cloud.normals).shape
    )
    assert run.artifact("geometry gate--roof").F.shape == (3, 3)
    assert run.artifact(Task("frames", ("gate",))).image.shape == (8, 8, 3)
    assert run.record.cloud is not None
    assert len(run.artifact("fuse").points) == run.record.cloud.points == 12
    assert wbflow.open_run(toy.file).id == wbflow.open_run(run.folder).id == wbflow.open_run(site, "latest").id == run.id


def test_a_run_without_a_cloud_has_a_short_repr(toy: ToySite) -> None:
    run = wbflow.run(toy.file, jobs=1, until="frames")
    assert repr(run) == f"Run({run.id!r}, site 'toy', exit 0, no cloud (not requested))"
    assert set(run.tasks) == {Task("frames", (camera,)) for camera in toy.cameras}
    with pytest.raises(WbflowError, match="made no cloud"):
        _ = run.cloud


def test_a_missing_artifact_is_explained_in_the_error(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    run = wbflow.run(toy.file, jobs=1)
    assert run.calibration["gate"]["K"]
    with pytest.raises(UsageError, match=r"'frames roof' made nothing: failed: .*roof.txt is not an image"):
        run.artifact("frames roof")
    with pytest.raises(UsageError, match=r"had no task 'frames tower'\s+it had frames gate, frames roof"):
        run.artifact("frames tower")
    with pytest.raises(UsageError, match="there is no stage 'coffee'"):
        run.artifact("coffee gate")


def test_the_listener_receives_every_event_of_a_run(toy: ToySite) -> None:
    heard: list[Event | Signal] = []
    run = wbflow.run(toy.file, jobs=1, listen=heard.append)
    assert [event for event in heard if isinstance(event, TaskEvent | WarningEvent)] == run.events
    assert {event.task for event in heard if isinstance(event, TaskEvent)} == set(run.tasks)


def test_wrong_usage_and_a_locked_work_folder_raise_exceptions(toy: ToySite) -> None:
    with pytest.raises(UsageError, match="there is no such stage"):
        wbflow.run(toy.file, until="coffee")
    with pytest.raises(NoSuchRun, match="has no runs yet"):
        wbflow.open_run(toy.file)
    code = (
        "import sys, wbflow\ntry: wbflow.run(sys.argv[1], jobs=1)\nexcept wbflow.errors.WbflowError as e: print(type(e).__name__)"
    )
    with hold(WorkFolder(toy.work).lock, wait=False):
        command = [sys.executable, "-c", code, str(toy.file)]
        printed = subprocess.run(command, env=toy.env(), capture_output=True, text=True, check=True).stdout
    assert printed.strip() == Locked.__name__


def test_importing_wbflow_imports_nothing_heavy() -> None:
    code = "import sys, wbflow; print([m for m in ('numpy', 'yaml', 'pydantic', 'click', 'joblib') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"


def test_a_report_that_cannot_be_built_gives_a_warning(toy: ToySite, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def broken(*_: object) -> str:
        raise KeyError("ink")

    monkeypatch.setattr("wbflow.report.page.build_report", broken)
    run = wbflow.run(toy.file, jobs=1)
    assert run.record.exit_code == 0
    (warning,) = warnings(run)
    assert "the report could not be built: KeyError: 'ink'" in warning.what
    assert "ink" in (warning.trace or "")


def test_a_folder_in_place_of_the_ledger_is_reported_and_replaced(toy: ToySite) -> None:
    toy.work.mkdir(parents=True)
    WorkFolder(toy.work).ledger.mkdir()
    run = wbflow.run(toy.file, jobs=1)
    assert run.record.cloud
    assert any("ledger" in warning.what for warning in warnings(run))
    assert WorkFolder(toy.work).ledger.is_file()
    assert toy.wbflow("run", "-q").stderr == ""


def test_a_ledger_that_cannot_be_written_gives_a_warning(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise sqlite3.OperationalError("disk I/O error")

    monkeypatch.setattr(Ledger, "record_run", broken)
    run = wbflow.run(toy.file, jobs=1)
    assert run.record.cloud
    (warning,) = warnings(run)
    assert warning.what == "the ledger was not written: disk I/O error"


def test_a_damaged_artifact_is_made_again_with_a_warning(toy: ToySite) -> None:
    wbflow.run(toy.file, jobs=1)
    victim = next(WorkFolder(toy.work).task(Task("fuse")).glob("*.ply"))
    victim.write_bytes(victim.read_bytes()[:-1] + b"x")
    run = wbflow.run(toy.file, jobs=1)
    (warning,) = warnings(run)
    assert warning.task == Task("fuse")
    assert "made again" in warning.what


def warnings(run: wbflow.Run) -> list[WarningEvent]:
    return [event for event in run.events if isinstance(event, WarningEvent)]
