"""COLMAP's text model, yaw, pitch and roll, and look_at give the same cameras as K, R, C."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wbflow.site.calibration import read_calibration
from wbflow.site.calibration.calibrated import look_at, yaw_pitch_roll
from wbflow.site.yaml_document import SiteError


def colmap(folder: Path, camera: str, image: str) -> Path:
    (folder / "cameras.txt").write_text(f"# Camera list\n{camera}\n")
    (folder / "images.txt").write_text(f"# Image list\n{image}\n\n")
    return folder


def test_lens_and_pose_are_read_from_a_colmap_text_model(tmp_path: Path) -> None:
    """A quarter turn about z, a principal point that is shifted by half a pixel, and C = -R^T t."""
    half = 0.5**0.5
    model = colmap(
        tmp_path, "7 OPENCV 640 480 500 510 320 240 -0.1 0.02 0.001 0.002", f"1 {half} 0 0 {half} 1 2 3 7 gate/a b.jpg"
    )
    camera = read_calibration(model)["gate/a b.jpg"]
    assert camera.lens.K == [[500, 0, 319.5], [0, 510, 239.5], [0, 0, 1]]
    assert camera.lens.distortion == [-0.1, 0.02, 0.001, 0.002, 0.0]
    assert camera.placement.R is not None and camera.placement.C is not None
    assert np.allclose(camera.placement.R, [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert np.allclose(camera.placement.C, [-2, 1, -3])


@pytest.mark.parametrize(("key", "value"), [("rotation_sigma_deg", 0.3), ("position_sigma_m", "wide"), ("position_sigma_m", -1)])
def test_a_sigma_that_is_invalid_or_of_a_missing_rotation_is_refused(tmp_path: Path, key: str, value: object) -> None:
    entry = {"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "width": 640, "height": 480, "C": [1, 2, 3], key: value}
    (tmp_path / "cameras.json").write_text(json.dumps({"gate": entry}))
    with pytest.raises(SiteError, match=f"gate.{key}"):
        read_calibration(tmp_path / "cameras.json")


@pytest.mark.parametrize(
    ("camera", "image", "message"),
    [
        ("1 MIRROR 640 480 1 2 3 4", "1 1 0 0 0 0 0 0 1 a.jpg", "cameras.txt:2: camera model MIRROR"),
        ("1 PINHOLE 640 480 500 500 320 240", "1 1 0 0 0 0 0 a.jpg", "images.txt:2: not an image line"),
    ],
)
def test_an_unusable_colmap_model_is_refused_with_file_and_line(tmp_path: Path, camera: str, image: str, message: str) -> None:
    with pytest.raises(SiteError, match=message):
        read_calibration(colmap(tmp_path, camera, image))


angles = st.floats(-179, 179)


@given(angles, st.floats(-89, 89), angles)
def test_yaw_pitch_roll_gives_a_rotation_with_the_stated_pitch(yaw: float, pitch: float, roll: float) -> None:
    R = np.array(yaw_pitch_roll(yaw, pitch, roll))
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)
    assert R[2, 2] == pytest.approx(np.sin(np.radians(pitch)), abs=1e-12)


def test_yaw_is_a_compass_heading() -> None:
    assert np.allclose(yaw_pitch_roll(0, 0, 0), [[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    assert np.allclose(np.array(yaw_pitch_roll(90, 0, 0))[2], [1, 0, 0])


points = st.tuples(*[st.floats(-50, 50)] * 3)


@given(points, points)
def test_look_at_centres_the_target_and_keeps_the_camera_upright(position: tuple[float, ...], target: tuple[float, ...]) -> None:
    across = np.hypot(target[0] - position[0], target[1] - position[1])
    if across < 0.1:
        return
    R = np.array(look_at(list(position), list(target)))
    x = R @ (np.array(target) - position)
    assert np.allclose(x[:2], 0, atol=1e-9)
    assert x[2] > 0
    assert R[1, 2] < 0, "down in the image is down in the world"
    assert abs(R[0, 2]) < 1e-12, "the horizon is level"
