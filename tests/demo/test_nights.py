"""The demo nights: the pictures show what truth/nights.json states."""

from __future__ import annotations

import io
import json
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest

from tests.helpers.images import decoded
from wbflow_demo import files
from wbflow_demo.files import Points
from wbflow_demo.script import date_of, event_of, turned_axes
from wbflow_stages.core.cameras import project
from wbflow_stages.types import Camera

NIGHTS = 7


@cache
def rendered() -> dict[str, bytes | Points]:
    """Seven nights of 4 cameras, two frames of 96 x 54 pixels."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "NIGHT_SMALL", (96, 54))
        return dict(files.demo_nights(NIGHTS, frames=2, small=True).files)


def file(name: str) -> bytes:
    content = rendered()[name]
    assert isinstance(content, bytes)
    return content


def nights() -> list[dict[str, Any]]:
    truth: list[dict[str, Any]] = json.loads(file("truth/nights.json"))["nights"]
    return truth


def frames(camera: str, night: int) -> list[bytes]:
    return [file(name) for name in sorted(rendered()) if name.startswith(f"captures/{camera}/{date_of(night)}")]


def depth(folder: str, camera: str) -> np.ndarray:
    with np.load(io.BytesIO(file(f"{folder}/{camera}.npz"))) as arrays:
        return np.asarray(arrays["depth"])


def test_every_camera_has_its_frames_every_night() -> None:
    cameras = ["crane-1", "mast-2", "mast-3", "crane-2"]
    assert [list(night["cameras"]) for night in nights()] == [cameras] * NIGHTS
    assert {len(frames(camera, night)) for camera in cameras for night in range(1, NIGHTS + 1)} == {2}


def test_only_the_frozen_camera_repeats_a_picture_of_the_night_before() -> None:
    every = {(c, n): frames(c, n) for n in range(1, NIGHTS + 1) for c in nights()[n - 1]["cameras"]}
    for (camera, night), found in every.items():
        frozen = nights()[night - 1]["cameras"][camera]["event"] == "frozen"
        assert frozen == ((camera, night) == ("mast-3", 3))
        assert (len(set(found)) == 1) == frozen
        if frozen:
            assert found[0] == every[camera, night - 1][-1]
    assert len({data for found in every.values() for data in found}) == len(every) * 2 - 2


def test_one_night_is_at_dusk_and_one_in_rain() -> None:
    mean = [np.mean([decoded(f).mean() for f in frames("crane-1", n)]) for n in range(1, NIGHTS + 1)]
    assert nights()[3]["light"] == "dusk"
    assert mean[3] < 0.8 * mean[0]
    assert [night["rain"] for night in nights()].index(True) == 5


@pytest.mark.parametrize(("night", "camera"), [(3, "crane-2"), (5, "mast-2")])
def test_the_pictures_of_a_turned_camera_are_shifted_as_its_pose_says(night: int, camera: str) -> None:
    truth, stated = nights()[night - 1]["cameras"][camera], json.loads(file("cameras.json"))[camera]
    R, K = np.array(truth["R"]), np.array(stated["K"])
    assert np.allclose(R @ np.array(stated["R"]).T, turned_axes(event_of(night, camera), K[0, 0]))
    angle = np.degrees(np.linalg.norm(cv2.Rodrigues(R @ np.array(stated["R"]).T)[0]))
    assert angle == pytest.approx(truth["angle_deg"], abs=1e-5)
    before, now = (Camera(K, r, np.array(stated["C"]), 96, 54) for r in (np.array(stated["R"]), R))
    ahead = (before.C + 10 * before.R[2])[None]
    moved = project(now, ahead)[0] - project(before, ahead)[0]
    assert np.allclose(moved[0], truth["shift_px"], atol=1e-3)
    assert np.linalg.norm(moved) == pytest.approx(3.0, abs=0.01) or truth["angle_deg"] == pytest.approx(0.5, abs=1e-5)
    if camera == "mast-2":  # same light as on the second night, so the shift can be measured in the pictures, too
        first, second = (np.median([decoded(f).mean(axis=2) for f in frames(camera, n)], axis=0) for n in (2, 5))
        window = cv2.createHanningWindow((96, 44), cv2.CV_32F)
        first, second = (cv2.Laplacian(image[10:].astype(np.float32), cv2.CV_32F) for image in (first, second))
        shift, _ = cv2.phaseCorrelate(first, second, window)
        assert np.hypot(*(np.array(shift) - truth["shift_px"])) < 0.8


def test_changes_are_where_the_depth_has_changed() -> None:
    assert [night["changes"] for night in nights()[:6]] == [[]] * 6
    changes = {change["name"]: change for change in nights()[6]["changes"]}
    assert {name: change["kind"] for name, change in changes.items()} == {
        "container": "appeared",
        "vehicle": "appeared",
        "stack": "vanished",
    }
    assert changes["stack"]["volume_m3"] == pytest.approx(2.4 * 1.6 * 1.95, rel=0.01)
    stated = json.loads(file("cameras.json"))["crane-2"]
    camera = Camera(np.array(stated["K"]), np.array(stated["R"]), np.array(stated["C"]), 96, 54)
    before, after = depth("truth/depth", "crane-2"), depth("truth/depth-from-7", "crane-2")
    for change, nearer in ((changes["vehicle"]["to"], after), (changes["stack"]["from"], before)):
        top = np.array([*change["position"][:2], 2 * change["position"][2] - 0.2])
        (u, v), distance = (value[0] for value in project(camera, top[None]))
        other = before if nearer is after else after
        assert nearer[round(v), round(u)] < other[round(v), round(u)] - 0.5
        assert nearer[round(v), round(u)] == pytest.approx(distance, abs=2.0)


def test_impossible_nights_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one night"):
        files.demo_nights(0, small=True)
    with pytest.raises(ValueError, match="1 to 8 cameras"):
        files.demo_nights(2, small=True, cameras=9)
