"""run.json: its keys are a contract, and keys that a later version adds are ignored."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from wbflow.errors import ExitCode
from wbflow.pipeline.summaries import CameraFigures, PairFigures, PosesSummary
from wbflow.records.findings import Baseline, Down, Finding, Verdict
from wbflow.records.record import CameraRecord, CloudRecord, PairRecord, RunRecord, Seconds, StageSeconds, TaskCounts
from wbflow_stages.contracts.camera_figures import Health


def some_record() -> RunRecord:
    return RunRecord(
        "20261120T031500Z",
        "yard",
        "0.1.0",
        "2026-11-19",
        "2026-11-20T03:15:00Z",
        "2026-11-20T03:16:01Z",
        ExitCode.DEGRADED,
        TaskCounts(ran=7, failed=1),
        Seconds(61.2345, 110.5, {"features": StageSeconds(7.123456, 13.9, 11)}),
        812,
        (
            CameraRecord("gate", "ok", figures=CameraFigures(keypoints=4000)),
            CameraRecord("roof", "failed", "is dark", "too-dark"),
        ),
        (PairRecord("gate", "roof", "skipped", "why", figures=PairFigures(epipolar_px=0.412345), stage="geometry"),),
        cloud=CloudRecord(1843201, ((0.0, 0.0, 0.0), (1.0, 2.0, 3.123456)), path="cloud.ply"),
        poses=PosesSummary(reprojection_px=0.512345),
    )


def test_the_record_has_the_keys_of_the_contract() -> None:
    data = json.loads(json.dumps(some_record().to_json()))
    head = ["run", "site", "version", "date", "started", "finished", "exit_code", "tasks", "seconds", "peak_rss_mb", "cameras"]
    assert list(data)[: len(head) + 6] == [*head, "pairs", "cloud", "other_clouds", "poses", "reason", "code"]
    assert data["exit_code"] == 3
    assert data["tasks"] == {"cached": 0, "ran": 7, "rejected": 0, "failed": 1, "skipped": 0}
    assert data["seconds"] == {"wall": 61.23, "cpu": 110.5, "stages": {"features": {"wall": 7.12, "cpu": 13.9, "tasks": 11}}}
    gate, nothing = data["cameras"][0], dict.fromkeys(("reason", "code", "health", "down", "brightness", "points", "pose"))
    assert {"id": "gate", "outcome": "ok", "keypoints": 4000, "notes": [], **nothing}.items() <= gate.items()
    assert data["cameras"][1]["code"] == "too-dark"
    assert data["pairs"][0]["epipolar_px"] == 0.4123
    assert data["pairs"][0]["stage"] == "geometry"
    assert data["cloud"]["bounds"] == [[0.0, 0.0, 0.0], [1.0, 2.0, 3.123456]]
    assert data["poses"]["reprojection_px"] == 0.5123


def test_a_record_that_is_read_is_written_unchanged() -> None:
    data = json.loads(json.dumps(some_record().to_json()))
    assert json.loads(json.dumps(RunRecord.from_json(data).to_json())) == data


def test_keys_of_later_versions_are_ignored() -> None:
    data = json.loads(json.dumps(some_record().to_json()))
    data["weather"] = {"wind": "strong"}
    data["cameras"][0] |= {"sharpness": 0.7, "fog": "some"}
    data["pairs"][0]["inliers"] = "a lot"
    data["tasks"]["postponed"] = 3
    record = RunRecord.from_json(data)
    assert record.cameras[0].figures.sharpness == 0.7
    assert (record.pairs[0].outcome, record.pairs[0].figures.inliers) == ("skipped", None)
    assert record.tasks.ran == 7


@pytest.mark.parametrize("key", ["run", "tasks", "cameras", "seconds"])
def test_a_record_without_a_required_key_is_refused(key: str) -> None:
    data = some_record().to_json()
    del data[key]
    with pytest.raises(ValueError, match=key):
        RunRecord.from_json(data)


def test_records_have_a_short_repr() -> None:
    record = some_record()
    assert repr(record) == "RunRecord('20261120T031500Z', site 'yard', exit 3, 1,843,201 points)"
    assert repr(record.cameras[1]) == "CameraRecord('roof', failed: is dark)"
    assert repr(record.pairs[0]) == "PairRecord('gate--roof', skipped: why)"


def with_verdict() -> RunRecord:
    figures, expected = {"shared": 0.0212345}, {"shared": 0.6}
    finding = Finding("camera-wrong-scene", ("quay",), "shows another place", figures, expected, "look where it points")
    health = Health("wrong-scene", "shows another place", figures, expected, "look where it points")
    quay = CameraRecord("quay", "ok", health=health, down=Down("2026-11-17", 3))
    usual = Baseline(5, {"points": 1_900_000.0}, {"quay": {"brightness": 101.5}})
    verdict = Verdict("degraded", (finding,))
    return replace(some_record(), verdict=verdict, cameras=(quay,), usual=usual, settings="abc")


def test_the_verdict_has_the_keys_of_the_contract() -> None:
    data = json.loads(json.dumps(with_verdict().to_json()))
    details = {"figures": {"shared": 0.0212}, "expected": {"shared": 0.6}, "remedy": "look where it points"}
    finding = {"kind": "camera-wrong-scene", "subject": ["quay"], "text": "shows another place", **details}
    finding["alias"] = "camera-foreign"
    assert data["verdict"] == {"level": "degraded", "findings": [finding]}
    assert data["cameras"][0]["health"] == {"state": "wrong-scene", "text": "shows another place", **details}
    assert json.loads(json.dumps(RunRecord.from_json(data).to_json())) == data


def test_a_run_of_an_earlier_version_has_no_verdict() -> None:
    data = some_record().to_json()
    del data["verdict"], data["cameras"][0]["health"]
    record = RunRecord.from_json(data)
    assert record.verdict is None
    assert record.cameras[0].health is None


@pytest.mark.parametrize("verdict", [{"level": "superb"}, {"level": "good", "findings": [{"kind": "odd"}]}])
def test_an_invalid_verdict_is_refused(verdict: dict[str, Any]) -> None:
    with pytest.raises((KeyError, ValueError)):
        RunRecord.from_json(some_record().to_json() | {"verdict": verdict})


def test_a_finding_is_printed_as_one_line() -> None:
    finding = Finding("camera-lost", ("quay",), "is dark")
    assert str(finding) == "quay: is dark"
    assert str(replace(finding, subject=())) == "is dark"
