"""Every result that is missing has a reason, as a text and as a code that can be counted."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.toy_site import ToySite
from wbflow import api
from wbflow.cache.memo import Digests
from wbflow.errors import WbflowError
from wbflow.runner.state import Cause
from wbflow.site import hanging_disks


def events_of_newest_run(toy: ToySite) -> list[dict[str, Any]]:
    """The events of the newest run."""
    newest = max(p for p in (toy.work / "runs").iterdir() if not p.is_symlink())
    return [json.loads(line) for line in (newest / "log.jsonl").read_text().splitlines()]


def first_pixel(capture: bytes) -> int:
    """The first pixel value of the frame that the toy stage makes of a capture."""
    return hashlib.sha256(capture).digest()[0]


def codes(rows: list[dict[str, Any]], name: str) -> dict[str, str | None]:
    return {row[name]: row["code"] for row in rows}


def test_a_lost_camera_is_recorded_with_a_code(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    toy.capture("crane").unlink()
    record = toy.run(code=3)
    assert codes(record["cameras"], "id") == {"gate": None, "roof": Cause.BAD_INPUT, "crane": Cause.NO_CAPTURE, "mast-1": None}
    assert codes(events_of_newest_run(toy), "task")["features roof"] == Cause.BAD_INPUT


def test_a_run_without_a_cloud_is_recorded_with_a_code(toy: ToySite) -> None:
    for camera in toy.cameras[1:]:
        toy.capture(camera).write_text("broken")
    assert toy.run(code=1)["code"] == Cause.TOO_FEW_CAMERAS


def test_a_lost_pair_is_recorded_with_a_code_in_this_and_the_next_run(toy: ToySite) -> None:
    toy.parameters = {"matches": {"reject": str(first_pixel(b"a view from gate"))}}
    toy.write()
    for _ in range(2):  # the second run takes them from the receipts
        pairs = toy.run(code=3)["pairs"]  # the gate has no pair left
        assert {pair["code"] for pair in pairs if pair["left"] == "gate"} == {"too-few-matches"}
        assert {pair["code"] for pair in pairs if pair["left"] != "gate"} == {None}


def test_a_camera_without_a_pose_has_the_code_unsolved(toy: ToySite) -> None:
    toy.parameters = {"poses": {"leave_out": "gate"}}
    toy.write()
    assert codes(toy.run(code=3)["cameras"], "id")["gate"] == Cause.UNSOLVED


def test_an_error_in_a_stage_function_has_the_code_fault(toy: ToySite) -> None:
    toy.parameters = {"poses": {"worlds": 0}}  # division by zero
    toy.write()
    assert toy.run(code=1)["code"] == Cause.FAULT
    assert codes(events_of_newest_run(toy), "task")["poses"] == Cause.FAULT


def test_every_reason_has_a_code_and_every_code_a_reason(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    toy.capture("crane").unlink()
    toy.parameters = {"poses": {"worlds": 2}}
    toy.write()
    record = toy.run(code=3)
    rows = [
        record,
        *record["cameras"],
        *record["pairs"],
        *(event for event in events_of_newest_run(toy) if event["event"] == "task"),
    ]
    assert len([row for row in rows if row["reason"]]) > 5
    assert [row for row in rows if (row["reason"] is None) != (row["code"] is None)] == []


RAISES = """
import numpy as np
from toy_stages import detect as well

class Unpicklable(Exception):
    def __init__(self, a, b):
        super().__init__("of two arguments")
        self.lock = __import__("threading").Lock()

def detect(frame, *, raises: str = ""):
    raise {
        "interrupt": KeyboardInterrupt("on its own"),
        "generator": GeneratorExit("on its own"),
        "unpicklable": Unpicklable(1, 2),
        "value": ValueError("shapes differ"),
        "linalg": np.linalg.LinAlgError("Singular matrix"),
    }[raises]
"""


@pytest.mark.parametrize(
    ("raises", "words"),
    [
        ("interrupt", "KeyboardInterrupt: on its own"),
        ("generator", "GeneratorExit: on its own"),
        ("unpicklable", "Unpicklable: of two arguments"),
        ("value", "ValueError: shapes differ"),
        ("linalg", "LinAlgError: Singular matrix"),
    ],
)
def test_any_exception_of_a_stage_is_reported_with_class_stage_and_remedy(toy: ToySite, raises: str, words: str) -> None:
    (toy.folder / "raising.py").write_text(RAISES)
    site = json.loads(toy.file.read_text())
    site["stages"]["features"] = {"use": "raising:detect", "raises": raises}
    toy.file.write_text(json.dumps(site))
    toy.run("--until", "features", code=None)
    (event,) = (event for event in events_of_newest_run(toy) if event.get("task") == "features roof")
    assert (event["outcome"], event["code"]) == ("failed", Cause.FAULT)
    assert words in event["reason"] and "the function of features" in event["reason"]
    assert "wbflow debug SITE.yaml 'features roof' --out DIR" in event["reason"]


def test_a_capture_folder_that_does_not_answer_costs_only_its_camera(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hanging_disks, "ANSWER_SECONDS", 0.5)
    read = Digests.of
    dead = threading.Event()

    def hangs(self: Digests, path: Path) -> str:
        if path == toy.capture("roof"):
            dead.wait()
        return read(self, path)

    monkeypatch.setattr(Digests, "of", hangs)
    try:
        record = toy.run(code=3)
    finally:
        dead.set()
    reasons = {camera["id"]: camera["reason"] for camera in record["cameras"]}
    assert "roof" in reasons["roof"] and "no answer within" in reasons["roof"]
    assert [reason for camera, reason in reasons.items() if camera != "roof" and reason] == []


def test_a_capture_folder_that_cannot_be_read_costs_only_its_camera(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = toy.capture("roof").parent
    lstat = os.lstat

    def refusing(path: str, **how: Any) -> os.stat_result:
        if Path(path).parent == folder and "roof" in Path(path).name:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)
        return lstat(path, **how)

    monkeypatch.setattr(os, "lstat", refusing)
    record = toy.run(code=3)
    reasons = {camera["id"]: camera["reason"] for camera in record["cameras"]}
    assert f"folder {folder} cannot be read: Permission denied; give the user who runs wbflow" in reasons["roof"]
    assert [reason for camera, reason in reasons.items() if camera != "roof" and reason] == []


CLOSES = """
import os

from toy_stages import detect as detected


def detect(frame, *, offset: float = 0.0):
    os.closerange(3, 4096)
    return detected(frame)
"""


def test_no_result_is_lost_if_a_stage_closes_all_file_descriptors(toy: ToySite) -> None:
    (toy.folder / "closing.py").write_text(CLOSES)
    site = json.loads(toy.file.read_text())
    site["stages"]["features"] = {"use": "closing:detect"}
    toy.file.write_text(json.dumps(site))
    record = toy.run("--until", "features")
    assert [camera["keypoints"] for camera in record["cameras"]] == [1, 1, 1, 1]


def test_an_interpreter_that_is_not_executable_is_named_in_the_error(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    python = toy.folder / "python"
    python.write_text("no program")
    monkeypatch.setattr(sys, "executable", str(python))
    with pytest.raises(WbflowError, match=f"this user may not execute {python}"):
        api.run(toy.file, jobs=1)
