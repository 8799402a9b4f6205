"""Images of wide lenses become pinhole images that show as much of the field as a pinhole can."""

from __future__ import annotations

from math import atan, degrees
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from wbflow_stages.core.cameras import camera_of, project
from wbflow_stages.core.lenses import WIDEST_DEG, lens_pixels
from wbflow_stages.frames import clean_frame
from wbflow_stages.io.cameras import calibration
from wbflow_stages.orientation.world import _in_frame
from wbflow_stages.types import Capture, Float64s, Lens, Poses, Uint8s

WIDTH, HEIGHT = 480, 360
K = np.array([[165.0, 0.0, 236.0], [0.0, 165.0, 181.0], [0.0, 0.0, 1.0]])
NARROW = np.array([[330.0, 0.0, 236.0], [0.0, 330.0, 181.0], [0.0, 0.0, 1.0]])
FISHEYE = Lens(K, np.array([-0.02, 0.004, 0.0, 0.0]), None, WIDTH, HEIGHT, "fisheye")
DIRECTIONS = np.array([[x, y, 1.0] for x in (-1.1, -0.3, 0.4, 1.2) for y in (-0.8, 0.1, 0.7)])


def capture(image: npt.NDArray[Any]) -> Capture:
    levels = np.rint(image).astype(np.uint8)[..., ::-1]
    return Capture("gate.png", np.asarray(cv2.imencode(".png", levels)[1].ravel(), dtype=np.uint8))


RAMPS = np.stack([*np.meshgrid(np.arange(WIDTH) / 2, np.arange(HEIGHT) / 2), np.full((HEIGHT, WIDTH), 90.0)], axis=-1)
"""Red encodes the column of a pixel and green its row: one grey level for two pixels."""


def dots(x: Float64s) -> Uint8s:
    """Blobs at pixels x (n, 2)."""
    yy, xx = np.mgrid[0:HEIGHT, 0:WIDTH]
    image = 40 + 200 * sum(np.exp(-((xx - u) ** 2 + (yy - v) ** 2) / (2 * 2.0**2)) for u, v in x)
    return np.repeat(np.clip(image, 0, 255)[..., None], 3, axis=2).astype(np.uint8)


@pytest.mark.parametrize("resolution", [None, 240])
@pytest.mark.parametrize(
    "lens",
    [
        FISHEYE,
        Lens(K, np.array([-0.2]), None, WIDTH, HEIGHT, "division"),
        Lens(K, np.array([0.5, 0.1, 0.001, -0.001, 0.0, 0.9, 0.3, 0.02]), None, WIDTH, HEIGHT, "rational"),
    ],
    ids=["fisheye", "division", "rational"],
)
def test_wide_lens_images_agree_with_the_pinhole_of_their_frame(lens: Lens, resolution: int | None) -> None:
    frame = clean_frame([capture(RAMPS)], lens, None, resolution=resolution, overlays=False)
    view = frame.view
    assert view.K is not None and view.focal_known
    x, y = np.meshgrid(np.arange(view.width), np.arange(view.height))
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) @ np.linalg.inv(view.K).T
    came_from = lens_pixels(lens, rays).reshape(view.height, view.width, 2)
    error = (2.0 * frame.image[..., :2] - came_from)[frame.mask]
    assert np.percentile(np.abs(error), 99.9) < 2.5 and np.abs(error.mean(axis=0)).max() < 0.1, "grey levels are two pixels"


def test_a_frame_covers_the_widest_pinhole_field_and_masks_what_the_lens_misses() -> None:
    frame = clean_frame([capture(dots(lens_pixels(FISHEYE, DIRECTIONS)))], FISHEYE, None, resolution=None)
    assert frame.view.K is not None
    corners = np.array([[0, 0, 1], [frame.view.width - 1, frame.view.height - 1, 1]]) @ np.linalg.inv(frame.view.K).T
    across, down = np.rad2deg(np.arctan(corners[1, :2]) - np.arctan(corners[0, :2]))
    assert across == pytest.approx(WIDEST_DEG, abs=0.5), "the lens sees 165 degrees across"
    assert down == pytest.approx(WIDEST_DEG, abs=0.5)
    assert frame.mask.mean() > 0.95
    assert any("the lens sees 171 x 127 degrees; only the 110 x 110 in its middle" in note for note in frame.notes)
    narrow = Lens(NARROW, FISHEYE.distortion, None, WIDTH, HEIGHT, "fisheye")
    frame = clean_frame([capture(RAMPS)], narrow, None, resolution=None)
    middle = frame.mask[frame.view.height // 2]
    assert middle[120:-120].all() and not middle[0] and not middle[-1], "a pincushion: its corners reach farthest"


def test_a_brown_lens_keeps_its_own_frame_unless_its_whole_field_is_requested() -> None:
    lens = Lens(NARROW, np.array([-0.2, 0.03, 0.0, 0.0, 0.0]), None, WIDTH, HEIGHT)
    kept, whole = (clean_frame([capture(RAMPS)], lens, None, resolution=None, whole_field=asked) for asked in (False, True))
    assert kept.view.K is not None and np.array_equal(kept.view.K, NARROW)
    assert (kept.view.width, kept.view.height) == (WIDTH, HEIGHT)
    assert whole.view.K is not None and whole.view.lens is not None
    reaches = [degrees(atan((v.width - 1 - v.K[0, 2]) / v.K[0, 0])) for v in (kept.view, whole.view) if v.K is not None]
    assert reaches[1] > reaches[0] + 2
    assert np.array_equal(whole.view.lens.distortion, lens.distortion)


def test_the_published_camera_equals_the_stated_one() -> None:
    frame = clean_frame([capture(dots(lens_pixels(FISHEYE, DIRECTIONS)))], FISHEYE, None, resolution=240)
    assert frame.view.K is not None
    R = cv2.Rodrigues(np.array([0.2, -0.4, 0.1]))[0]
    camera = camera_of(frame.view, frame.view.K, np.asarray(R, dtype=np.float64), np.array([1.0, 2.0, 3.0]))
    entry = calibration(Poses({"gate": camera}, metric=True, source="calibration"))["gate"]
    assert entry["model"] == "fisheye" and entry["distortion"] == FISHEYE.distortion.tolist()
    assert np.allclose(entry["K"], K) and np.allclose(entry["R"], R) and (entry["width"], entry["height"]) == (WIDTH, HEIGHT)
    X = DIRECTIONS @ R + camera.C  # control points marked in the capture are moved to their pixels of the frame
    assert np.abs(_in_frame(lens_pixels(FISHEYE, DIRECTIONS), frame.view, camera) - project(camera, X)[0]).max() < 1e-9
