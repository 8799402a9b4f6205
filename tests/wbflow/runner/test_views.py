"""A camera with several views is processed view by view, and reported as one camera."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import wbflow
from tests.helpers.toy_site import HELPERS, ToySite

LENS = {"fx": 204, "fy": 204, "cx": 319.5, "cy": 179.5, "width": 640, "height": 360}
WIDE = {"id": "wide", "model": "fisheye", "distortion": [0.01], "intrinsics": LENS}
VIEWS = ["wide@1", "wide@2", "wide@3"]


@pytest.fixture(autouse=True)
def toy_stages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(HELPERS))


def toy(folder: Path, **more: Any) -> ToySite:
    return ToySite(folder / "toy", ["gate", "wide", "roof"], keys={"cameras": ["gate", WIDE, "roof"]}, **more)


def latest(site: ToySite, name: str) -> Any:
    return json.loads((site.work / "runs" / "latest" / name).read_text())


def test_a_camera_with_views_is_processed_by_view_and_reported_as_one(tmp_path: Path) -> None:
    site = toy(tmp_path)
    record = site.run()
    assert [camera["id"] for camera in record["cameras"]] == ["gate", "wide", "roof"]
    assert {camera["outcome"] for camera in record["cameras"]} == {"ok"}
    assert [camera["keypoints"] for camera in record["cameras"]] == [1, 3, 1]
    assert list(latest(site, "cameras.json")) == ["gate", "wide", "roof"]
    pairs = {(pair["left"], pair["right"]) for pair in record["pairs"]}
    assert {view for pair in pairs for view in pair} == {"gate", "roof", *VIEWS}
    assert not any(left in VIEWS and right in VIEWS for left, right in pairs)
    assert record["poses"]["components"] == [["gate", "wide", "roof"]]
    assert {path.name for path in (site.work / "cache" / "frames").iterdir()} == {"gate", "roof", *VIEWS}
    assert "wide@" not in (site.work / "runs" / "latest" / "metrics.prom").read_text()


def test_artifacts_of_a_view_are_opened_by_its_name(tmp_path: Path) -> None:
    site = toy(tmp_path)
    site.run()
    run = wbflow.open_run(site.work / "runs" / "latest")
    assert run.artifact("frames wide@2").view.lens.camera == "wide"
    assert run.cameras["wide"].ok


def test_a_wide_camera_without_a_capture_is_reported_as_one_lost_camera(tmp_path: Path) -> None:
    site = toy(tmp_path)
    site.capture("wide").unlink()
    record = site.run(code=3)
    lost = [camera for camera in record["cameras"] if camera["outcome"] != "ok"]
    assert [(camera["id"], camera["down"]["nights"]) for camera in lost] == [("wide", 1)]
    assert [finding["subject"] for finding in record["verdict"]["findings"]] == [["wide"]]


@pytest.mark.parametrize(
    ("states", "state", "used"),
    [
        ("ok/obscured/ok", "ok", {"wide@1", "wide@3"}),
        ("shifted/ok/ok", "shifted", set(VIEWS)),
        ("obscured/obscured/obscured", "obscured", set()),
        ("obscured/ok/shifted", "shifted", {"wide@2", "wide@3"}),
    ],
)
def test_the_health_of_a_camera_is_that_of_its_unobscured_views(tmp_path: Path, states: str, state: str, used: set[str]) -> None:
    site = toy(tmp_path, watched=True, dated=True)
    site.night("2026-11-01")
    site.run("--date", "2026-11-01")
    site.night("2026-11-02", wide=states)
    record = site.run("--date", "2026-11-02", code=0 if state == "ok" else 3)
    assert [camera["health"]["state"] for camera in record["cameras"]] == ["ok", state, "ok"]
    there = {view for pair in record["pairs"] if pair["outcome"] == "ok" for view in (pair["left"], pair["right"])}
    assert there & set(VIEWS) == used


def test_forcing_a_camera_reruns_all_its_views(tmp_path: Path) -> None:
    site = toy(tmp_path, backend="threading")
    site.run("--until", "features")
    site.run("--until", "features", "--force", "frames wide")
    assert site.ran() == {f"frames {view}" for view in VIEWS}
    site.run("--until", "features", "--force", "frames wide@2")
    assert site.ran() == {"frames wide@2"}
