"""Whatever left nothing says why, in words and as one word that can be counted."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from tests.helpers.toy_site import ToySite
from wbflow.runner.state import Cause


def told(toy: ToySite) -> list[dict[str, Any]]:
    """The events of the newest run."""
    newest = max(p for p in (toy.work / "runs").iterdir() if not p.is_symlink())
    return [json.loads(line) for line in (newest / "log.jsonl").read_text().splitlines()]


def first_pixel(capture: bytes) -> int:
    """Of the frame that the toy stage makes."""
    return hashlib.sha256(capture).digest()[0]


def codes(rows: list[dict[str, Any]], name: str) -> dict[str, str | None]:
    return {row[name]: row["code"] for row in rows}


def test_a_camera_says_as_one_word_why_it_is_lost(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    toy.capture("crane").unlink()
    record = toy.run(code=3)
    assert codes(record["cameras"], "id") == {"gate": None, "roof": Cause.BAD_INPUT, "crane": Cause.NO_CAPTURE, "mast-1": None}
    assert codes(told(toy), "task")["features roof"] == Cause.BAD_INPUT


def test_a_run_without_a_cloud_says_as_one_word_why(toy: ToySite) -> None:
    for camera in toy.cameras[1:]:
        toy.capture(camera).write_text("broken")
    assert toy.run(code=1)["code"] == Cause.TOO_FEW_CAMERAS


def test_a_pair_says_as_one_word_why_it_is_lost_and_so_does_the_next_run(toy: ToySite) -> None:
    toy.parameters = {"matches": {"reject": str(first_pixel(b"a view from gate"))}}
    toy.write()
    for _ in range(2):  # the second time from the receipts
        pairs = toy.run(code=3)["pairs"]  # the gate has no pair left
        assert {pair["code"] for pair in pairs if pair["left"] == "gate"} == {"too-few-matches"}
        assert {pair["code"] for pair in pairs if pair["left"] != "gate"} == {None}


def test_a_camera_that_is_not_placed(toy: ToySite) -> None:
    toy.parameters = {"poses": {"leave_out": "gate"}}
    toy.write()
    assert codes(toy.run(code=3)["cameras"], "id")["gate"] == Cause.UNSOLVED


def test_a_function_that_is_wrong_is_told_from_one_that_refuses_its_input(toy: ToySite) -> None:
    toy.parameters = {"poses": {"worlds": 0}}  # divides by it
    toy.write()
    assert toy.run(code=1)["code"] == Cause.FAULT
    assert codes(told(toy), "task")["poses"] == Cause.FAULT


def test_no_reason_stands_without_its_code(toy: ToySite) -> None:
    toy.capture("roof").write_text("broken")
    toy.capture("crane").unlink()
    toy.parameters = {"poses": {"worlds": 2}}
    toy.write()
    record = toy.run(code=3)
    rows = [record, *record["cameras"], *record["pairs"], *(event for event in told(toy) if event["event"] == "task")]
    assert len([row for row in rows if row["reason"]]) > 5
    assert [row for row in rows if (row["reason"] is None) != (row["code"] is None)] == []
